// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Common parts of the readers of bags: files that belong together, and messages by their definitions.
/// Private to io.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/io/mission.hpp>

#include "bag.hpp"
#include "mission_parts.hpp"
#include "ros_message.hpp"

namespace loopwise::bags {

/// The bags of a recording: its own, then those of its truth.
struct Recording {
  std::vector<std::filesystem::path> files;
  /// Number of the recorder of each file. Files of one folder have the same recorder.
  std::vector<std::size_t> recorders;
  std::vector<std::string> names;  ///< Of the recorders: of a folder or a file.
  std::size_t own = 0;             ///< Number of files of the recording itself.
  std::filesystem::path truth;     ///< The g2o file of the truth; empty if there is no such file.
};

/// The recording of files, and of the bags in folders. \throws InputError naming a file that is no bag
[[nodiscard]] Recording recording_of(const std::vector<std::filesystem::path>& paths, Problems& problems);

[[nodiscard]] std::vector<BagFile> bag_files(const std::vector<std::filesystem::path>& paths);

/// Whether any reader uses messages of the type.
[[nodiscard]] bool is_known_type(const std::string& type);

/// Decodes messages by the definitions of their connections. A definition is parsed at the first message.
class Decoder {
 public:
  explicit Decoder(std::vector<Connection> connections);

  [[nodiscard]] const Connection& connection(std::size_t number) const { return connections_[number]; }
  /// Whether the messages can be read. If not, counts "topic of unknown encoding left out" or "topic without
  /// message definition left out".
  [[nodiscard]] bool can_read(std::size_t number, const std::string& bag, Problems& problems) const;
  /// The value is valid until the next call, and while the bytes exist. \throws InputError
  [[nodiscard]] ros1::Value message(std::size_t number, std::string_view bytes);

 private:
  [[nodiscard]] const ros1::Schema& schema(std::size_t number);

  std::vector<Connection> connections_;
  std::vector<std::unique_ptr<const ros1::Schema>> schemas_;
  std::string buffer_;
};

/// Names, types and counts of the topics, with the use of each connection. A topic of several files is listed
/// once.
[[nodiscard]] std::vector<RecordedTopic> recorded_topics(const std::vector<Connection>& connections,
                                                         const std::map<std::size_t, std::string>& uses);

/// The first topics as "/imu (sensor_msgs/Imu, 400 messages), ...", for errors.
[[nodiscard]] std::string topics_text(const std::vector<Connection>& connections);

/// Makes key frames from odometry and clouds of bags without graphs. \throws as make_key_frame_mission();
/// InputError naming the topics if no robot has both
[[nodiscard]] Mission read_key_frames(BagSet bags, const Recording& recording, const MissionOptions& options,
                                      const parts::Work& work);

}  // namespace loopwise::bags
