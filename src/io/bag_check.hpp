// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Checks the records of a ROS 1 bag before the library reads them, because the library trusts lengths and
/// positions in a file. Private to io.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise::bags {

/// Largest size of a chunk. Recorders make chunks of less than a megabyte.
inline constexpr std::size_t kLargestChunk = std::size_t{1} << 30;

/// Checks a bag of version 2.0 from its first byte to its last. Every record is within its chunk and the
/// file, and its header has the fields of its kind. Chunks decompress to their stated size. The index lists
/// every message once, at its position, with its connection and time. So no entry of the index points outside
/// the file. Memory: one chunk, compressed and decompressed. Progress is in megabytes.
///
/// `name` stands for the file in errors. Counts "message at time 0 left out" (the reader leaves it out) and
/// "bag altered in a part that is not read" (space that is not blank, or times of a chunk that differ from
/// those of its messages). \throws IoError; InputError naming the byte, with a remedy for a bag that was
/// never closed, has an older version, or is encrypted; StoppedError
void check_bag(const std::filesystem::path& file, const std::string& name, Problems& problems,
               const ProgressCallback& progress = {}, const StopToken& stop = {});

/// Decompresses a chunk to `size` bytes. `compression` is "none", "bz2" or "lz4". Memory grows with the
/// output, not with the stated size. \throws InputError if the data are damaged, have another size, or are of
/// another kind
[[nodiscard]] std::string inflate_chunk(std::string_view compression, std::string_view data,
                                        std::size_t size);

}  // namespace loopwise::bags
