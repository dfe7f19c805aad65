// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Assigns topics of a bag to robots, as their odometry, clouds and truth. Private to io.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "bag_recording.hpp"

namespace loopwise::bags {

/// Use of a type of messages for key frames.
enum class StreamKind {
  kOther,
  kOdometry,    ///< nav_msgs/Odometry
  kPose,        ///< geometry_msgs/PoseStamped, geometry_msgs/PoseWithCovarianceStamped
  kCloud,       ///< sensor_msgs/PointCloud2
  kTransforms,  ///< tf2_msgs/TFMessage
};
[[nodiscard]] StreamKind stream_kind(const std::string& type);

/// A topic in the files of one recorder.
struct StreamTopic {
  std::string name;
  StreamKind kind = StreamKind::kOther;
  std::size_t recorder = 0;
  std::size_t messages = 0;
  std::vector<std::size_t> connections;  ///< One per file.
};

/// A robot and the topics that it is read from.
struct RobotTopics {
  std::string name;
  StreamTopic poses;
  StreamTopic clouds;
};

struct ChosenTopics {
  std::vector<RobotTopics> robots;
  std::vector<StreamTopic> truth;
};

/// Chooses the robots and their topics. Robots are the namespaces of topics if at least two of them have
/// poses and clouds, otherwise the recorders. Of several topics of a kind, the options name one. Without an
/// option, odometry precedes poses, then the topic with the most messages counts, then the first by name.
/// Such a choice is counted as "several topics of poses, one is used" or "several topics of clouds, one is
/// taken". The truth is options.truth_topic, or else topics with "ground_truth" or "gt" in their names.
/// \throws InputError if an option names no topic of its kind, or no robot has both
[[nodiscard]] ChosenTopics choose_topics(const std::vector<StreamTopic>& topics, const Recording& recording,
                                         const MissionOptions& options, const std::string& name,
                                         const std::string& available_topics, Problems& problems);

}  // namespace loopwise::bags
