// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// zstd and lz4 as recordings of ROS 2 have them. Memory grows with the output, not with the stated size.
/// Private to io.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include <loopwise/core/stop_token.hpp>

namespace loopwise::bags {

/// Whether it begins as zstd frames do.
[[nodiscard]] bool is_zstd(std::string_view bytes);

/// What whole frames of zstd hold. \throws InputError if they are damaged, cut short, need a window of more
/// than 64 MiB, or hold more than `most` bytes
[[nodiscard]] std::string inflate_zstd(std::string_view data, std::size_t most);

/// The same of one frame of lz4.
[[nodiscard]] std::string inflate_lz4(std::string_view data, std::size_t most);

/// Unpacks a file of zstd frames. \throws InputError naming `name` if it is damaged, or becomes a thousand
/// times as large or larger than the disk has room for; IoError; StoppedError
void inflate_zstd_file(const std::filesystem::path& from, const std::string& name,
                       const std::filesystem::path& to, const StopToken& stop);

}  // namespace loopwise::bags
