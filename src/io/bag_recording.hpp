// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the readers of bags share: which files belong together, and their messages by the definitions.
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
  /// Of each file: files of one recorder have the same number, and those of another folder another.
  std::vector<std::size_t> recorders;
  std::vector<std::string> names;  ///< Of the recorders: of a folder or a file.
  std::size_t own = 0;             ///< How many files are its own.
  std::filesystem::path truth;     ///< A g2o file, if the truth is one.
};

/// Files, and the bags of folders. \throws InputError naming a file that is no bag
[[nodiscard]] Recording recording_of(const std::vector<std::filesystem::path>& paths, Problems& problems);

[[nodiscard]] std::vector<BagFile> bag_files(const std::vector<std::filesystem::path>& paths);

/// Whether any reader takes messages of the type.
[[nodiscard]] bool is_known_type(const std::string& type);

/// The messages of connections by their definitions, each of which is read when its first message comes.
class Decoder {
 public:
  explicit Decoder(std::vector<Connection> connections);

  [[nodiscard]] const Connection& connection(std::size_t number) const { return connections_[number]; }
  /// Whether the messages can be read; counts "topic of unknown encoding left out" and "topic without message
  /// definition left out" if not.
  [[nodiscard]] bool can_read(std::size_t number, const std::string& bag, Problems& problems) const;
  /// Valid until the next call, and as long as the bytes. \throws InputError
  [[nodiscard]] ros1::Value message(std::size_t number, std::string_view bytes);

 private:
  [[nodiscard]] const ros1::Schema& schema(std::size_t number);

  std::vector<Connection> connections_;
  std::vector<std::unique_ptr<const ros1::Schema>> schemas_;
  std::string buffer_;
};

/// Names, types and counts of the topics, those of several files once, and the use of each
/// connection.
[[nodiscard]] std::vector<RecordedTopic> recorded_topics(const std::vector<Connection>& connections,
                                                         const std::map<std::size_t, std::string>& uses);

/// "/imu (sensor_msgs/Imu, 400 messages), ...", the first of them, for errors.
[[nodiscard]] std::string topics_text(const std::vector<Connection>& connections);

/// Key frames from odometry and clouds, of bags without graphs. \throws as make_key_frame_mission();
/// InputError if no robot has both, naming the topics that there are
[[nodiscard]] Mission read_key_frames(BagSet bags, const Recording& recording, const MissionOptions& options,
                                      const parts::Work& work);

}  // namespace loopwise::bags
