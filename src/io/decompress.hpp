// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Decompression of zstd and lz4 for recordings of ROS 2. Memory grows with the output, not with the stated
/// size. Private to io.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include <loopwise/core/stop_token.hpp>

namespace loopwise::bags {

/// Whether the bytes begin as a zstd frame does.
[[nodiscard]] bool is_zstd(std::string_view bytes);

/// Decompresses whole frames of zstd. \throws InputError if they are damaged, cut short, need a window of
/// more than 64 MiB, or hold more than `most` bytes
[[nodiscard]] std::string inflate_zstd(std::string_view data, std::size_t most);

/// The same for one frame of lz4.
[[nodiscard]] std::string inflate_lz4(std::string_view data, std::size_t most);

/// Decompresses a file of zstd frames. \throws InputError naming `name` if it is damaged, expands more than a
/// thousand times, or expands beyond the free space of the disk; IoError; StoppedError
void inflate_zstd_file(const std::filesystem::path& from, const std::string& name,
                       const std::filesystem::path& to, const StopToken& stop);

}  // namespace loopwise::bags
