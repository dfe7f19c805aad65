// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Definitions of the messages that missions are read from, bytes of such messages, and bags and archives
/// around them: what seeds are made of. Sizes and places are as the formats want them; a caller may alter the
/// bytes afterwards.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace loopwise::fuzz {

struct MessageType {
  const char* name;
  const char* topic;
  const char* definition;
};
/// KeyedScan, PoseGraph, CommNodeStatus, SilvusStreamscape, Odometry, in this order.
[[nodiscard]] const std::vector<MessageType>& message_types();

struct TypedMessage {
  std::size_t type = 0;  ///< In message_types().
  std::string bytes;
};
/// A small mission of one robot: a graph with two nodes and every kind of edge, scans, beacons, radio, truth.
[[nodiscard]] std::vector<TypedMessage> lamp_messages();

/// A bag with these messages in one chunk, closed and indexed. `compress` turns the chunk's bytes into what
/// `compression` says they are.
[[nodiscard]] std::string bag(const std::vector<TypedMessage>& messages,
                              const std::string& compression = "none",
                              const std::string& compressed_chunk = {});
/// The contents of that bag's chunk.
[[nodiscard]] std::string bag_chunk(const std::vector<TypedMessage>& messages);

/// A zip archive of files that are stored as they are.
[[nodiscard]] std::string zip(const std::vector<std::pair<std::string, std::string>>& files);

}  // namespace loopwise::fuzz
