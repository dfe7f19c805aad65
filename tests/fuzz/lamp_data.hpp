// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Source of seeds: definitions and bytes of the messages from which missions are read, and bags and archives
/// around them. Sizes and offsets are valid; a caller may alter the bytes afterwards.
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
  std::uint32_t second = 0;  ///< At which it was recorded.
};
/// The time of second 0, in seconds since 1970.
inline constexpr std::uint32_t kBagStart = 1600000000;

/// What a bag says of the messages of a type.
struct BagConnection {
  std::string name, topic, definition;
};
/// message_types().
[[nodiscard]] const std::vector<BagConnection>& bag_connections();

/// A small mission of one robot: a graph with two nodes and every kind of edge, scans, beacons, radio, truth.
[[nodiscard]] std::vector<TypedMessage> lamp_messages();

struct BagLayout {
  std::string compression = "none";      ///< Or, with the ROS library, "bz2" and "lz4".
  std::size_t messages_per_chunk = 100;  ///< At least 1.
};
/// A bag with these messages, closed and indexed. Types count in `types`, each of which is a connection.
[[nodiscard]] std::string bag(const std::vector<TypedMessage>& messages, const BagLayout& layout = {},
                              const std::vector<BagConnection>& types = bag_connections());

/// Compresses bytes by "none", "bz2" or "lz4". \throws std::runtime_error if the method is not available
[[nodiscard]] std::string compressed(const std::string& how, const std::string& bytes);

/// A zip archive of files that are stored as they are.
[[nodiscard]] std::string zip(const std::vector<std::pair<std::string, std::string>>& files);

}  // namespace loopwise::fuzz
