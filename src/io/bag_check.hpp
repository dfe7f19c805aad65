// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Looks over the records of a ROS 1 bag before the library that reads them gets to see it: that library
/// takes lengths and places in a file as they stand. Private to io.
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

/// A chunk holds at most as much; recorders make chunks of less than a megabyte.
inline constexpr std::size_t kLargestChunk = std::size_t{1} << 30;

/// Walks a bag of version 2.0 from its first byte to its last: every record lies within its chunk and the
/// file, its header has the fields of its kind, chunks decompress to the size that they claim, and the index
/// lists every message once, at its place, with its connection and time. Then nothing that the index says
/// leads out of the file. Memory: one chunk, compressed and not. Progress is in megabytes.
///
/// `name` stands for the file in errors. Counted: "message at time 0 left out" (reading leaves it out), "bag
/// altered in a place that is not read" (room that is not blank, times of a chunk that are not its
/// messages'). \throws IoError; InputError naming the byte and saying what to do about a bag that was never
/// closed, is of an older version, or is encrypted; StoppedError
void check_bag(const std::filesystem::path& file, const std::string& name, Problems& problems,
               const ProgressCallback& progress = {}, const StopToken& stop = {});

/// The contents of a chunk of `size` bytes that is "none", "bz2" or "lz4". Memory grows with what comes out,
/// not with the stated sizes. \throws InputError if the data are damaged, of another size, or of another
/// kind.
[[nodiscard]] std::string inflate_chunk(std::string_view compression, std::string_view data,
                                        std::size_t size);

}  // namespace loopwise::bags
