// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The two forms of ROS 2 bags. Private to io.
#pragma once

#include "bag_storage.hpp"

namespace loopwise::bags {

/// An MCAP file, chunked or not; messages of ROS 2, or of ROS 1. The file is walked from its first byte to
/// its last: every record lies within the file or its chunk, chunks decompress to the size and checksum that
/// they claim, and every message has its channel. The index is made from the messages; the
/// one in the file is not used. Memory: a chunk, compressed and not, and 24 bytes for each message of a known
/// type. Counted: "messages missing from the summary". \throws IoError; InputError naming the byte;
/// StoppedError
[[nodiscard]] std::unique_ptr<Storage> open_mcap(const NumberedFile& file, const Opening& opening);

/// An SQLite database with the tables of rosbag2. SQLite's own quick check comes first. Counted: "message of
/// an unknown topic left out". \throws IoError; InputError; StoppedError
[[nodiscard]] std::unique_ptr<Storage> open_db3(const NumberedFile& file, const Opening& opening);

/// A connection of rosbag2: its definition from the file, where that has it in the form of .msg files, else
/// the known one.
[[nodiscard]] Connection rosbag2_connection(std::size_t bag, const std::string& topic,
                                            const std::string& type, const std::string& encoding,
                                            const std::string& schema_encoding,
                                            const std::string& definition);

/// The bytes of a message that rosbag2 may have compressed by itself. \throws InputError
[[nodiscard]] std::string unpacked_message(std::string bytes);

}  // namespace loopwise::bags
