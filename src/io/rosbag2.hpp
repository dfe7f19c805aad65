// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The two forms of ROS 2 bags. Private to io.
#pragma once

#include "bag_storage.hpp"

namespace loopwise::bags {

/// An MCAP file, chunked or not, with messages of ROS 2 or ROS 1. The file is checked from its first byte to
/// its last: every record is within the file or its chunk, chunks have their stated size and checksum, and
/// every message has its channel. The index is made from the messages, and the index in the file is not used.
/// Memory: a chunk, compressed and decompressed, and 24 bytes for each message of a known type. Counts
/// "messages missing from the summary". \throws IoError; InputError naming the byte; StoppedError
[[nodiscard]] std::unique_ptr<Storage> open_mcap(const NumberedFile& file, const Opening& opening);

/// An SQLite database with the tables of rosbag2. SQLite's own quick check comes first. Counted: "message of
/// an unknown topic left out". \throws IoError; InputError; StoppedError
[[nodiscard]] std::unique_ptr<Storage> open_db3(const NumberedFile& file, const Opening& opening);

/// A connection of rosbag2. Its definition is that of the file if it has the form of .msg files, otherwise
/// the known definition.
[[nodiscard]] Connection rosbag2_connection(std::size_t bag, const std::string& topic,
                                            const std::string& type, const std::string& encoding,
                                            const std::string& schema_encoding,
                                            const std::string& definition);

/// Decompresses a message that rosbag2 may have compressed individually. \throws InputError
[[nodiscard]] std::string unpacked_message(std::string bytes);

}  // namespace loopwise::bags
