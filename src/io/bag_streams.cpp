// SPDX-License-Identifier: BSD-3-Clause
#include "bag_streams.hpp"

#include <algorithm>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>

#include "lamp_messages.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

using Topics = std::vector<StreamTopic>;

bool is_pose(const StreamTopic& topic) {
  return topic.kind == StreamKind::kOdometry || topic.kind == StreamKind::kPose;
}

bool is_cloud(const StreamTopic& topic) {
  return topic.kind == StreamKind::kCloud;
}

template <class Is>
Topics topics_where(const Topics& topics, Is&& is) {
  Topics out;
  std::copy_if(topics.begin(), topics.end(), std::back_inserter(out), is);
  return out;
}

/// Whether the topic has the wanted name, with or without a robot's namespace.
bool is_named(const StreamTopic& topic, const std::string& wanted) {
  const std::string tail = "/" + wanted.substr(std::min(wanted.find_first_not_of('/'), wanted.size()));
  const std::string name =
      "/" + topic.name.substr(std::min(topic.name.find_first_not_of('/'), topic.name.size()));
  return name.size() >= tail.size() && name.compare(name.size() - tail.size(), tail.size(), tail) == 0;
}

bool has_truth_name(const std::string& name) {
  std::string word;
  std::set<std::string> words;
  for (const char c : name + "/") {
    if (c == '/' || c == '_') {
      words.insert(word);
      word.clear();
    } else {
      word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    }
  }
  return words.count("gt") + words.count("truth") + words.count("groundtruth") > 0;
}

/// Among the topics for which `is` is true, keeps only those with the wanted name.
template <class Is>
void keep_named(Topics& topics, const std::string& wanted, const char* option, Is&& is,
                const std::string& name, const std::string& available_topics) {
  if (wanted.empty()) return;
  const auto other = [&](const StreamTopic& topic) { return is(topic) && !is_named(topic, wanted); };
  topics.erase(std::remove_if(topics.begin(), topics.end(), other), topics.end());
  if (std::none_of(topics.begin(), topics.end(), is)) {
    throw InputError(name + ": no topic for mission." + option + " = " + text::quoted(wanted) +
                     " of a type that it takes; the recording has " + available_topics);
  }
}

/// The preferred topic. If there are several, the choice is counted as a guess.
StreamTopic best_of(Topics topics, const std::string& robot, const char* kind, const char* option,
                    Problems& problems) {
  std::stable_sort(topics.begin(), topics.end(), [](const StreamTopic& a, const StreamTopic& b) {
    if (a.kind != b.kind) return a.kind < b.kind;
    return a.messages != b.messages ? a.messages > b.messages : a.name < b.name;
  });
  if (topics.size() > 1) {
    std::string others;
    for (std::size_t i = 1; i < topics.size(); ++i) others += (i > 1 ? ", " : "") + topics[i].name;
    problems.add(std::string("several topics of ") + kind + ", one is used",
                 robot + ": " + topics[0].name + ", not " + others + "; " + option + " chooses");
  }
  return topics.front();
}

/// Topics of one namespace or recorder. It is a robot if poses and clouds are among them.
struct Group {
  std::string name;
  Topics topics;
  [[nodiscard]] bool is_robot() const {
    return std::any_of(topics.begin(), topics.end(), is_pose) &&
           std::any_of(topics.begin(), topics.end(), is_cloud);
  }
};

template <class Key, class KeyOf, class NameOf>
std::vector<Group> grouped(const Topics& topics, KeyOf&& key_of, NameOf&& name_of) {
  std::map<Key, Group> groups;
  for (const StreamTopic& topic : topics) {
    Group& group = groups[key_of(topic)];
    group.name = name_of(topic);
    group.topics.push_back(topic);
  }
  std::vector<Group> out;
  for (auto& [key, group] : groups) {
    if (group.is_robot()) out.push_back(std::move(group));
  }
  return out;
}

std::vector<Group> robots_among(const Topics& topics, const Recording& recording) {
  using Space = std::pair<std::string, std::size_t>;
  const auto space = [](const StreamTopic& topic) {
    return Space(lamp::first_word(topic.name), topic.recorder);
  };
  auto groups = grouped<Space>(topics, space, [](const StreamTopic& t) { return lamp::first_word(t.name); });
  std::set<std::string> words;
  for (const Group& group : groups) words.insert(group.name);
  if (words.size() > 1) return groups;
  const std::string only = words.size() == 1 ? *words.begin() : "";
  groups = grouped<std::size_t>(
      topics, [](const StreamTopic& topic) { return topic.recorder; },
      [&](const StreamTopic& topic) { return recording.names[topic.recorder]; });
  if (groups.size() == 1 && !only.empty()) groups.front().name = only;
  if (!groups.empty()) return groups;
  // Poses and clouds may be in files of different recorders.
  const Group all{recording.names.front(), topics};
  return all.is_robot() ? std::vector<Group>{all} : groups;
}

}  // namespace

StreamKind stream_kind(const std::string& type) {
  if (type == "nav_msgs/Odometry") return StreamKind::kOdometry;
  if (type == "geometry_msgs/PoseStamped" || type == "geometry_msgs/PoseWithCovarianceStamped")
    return StreamKind::kPose;
  if (type == "sensor_msgs/PointCloud2") return StreamKind::kCloud;
  if (type == "tf2_msgs/TFMessage" || type == "tf/tfMessage") return StreamKind::kTransforms;
  return StreamKind::kOther;
}

ChosenTopics choose_topics(const Topics& topics, const Recording& recording, const MissionOptions& options,
                           const std::string& name, const std::string& available_topics, Problems& problems) {
  const auto is_truth = [&](const StreamTopic& topic) {
    return is_pose(topic) &&
           (options.truth_topic.empty() ? has_truth_name(topic.name) : is_named(topic, options.truth_topic));
  };
  ChosenTopics chosen;
  chosen.truth = topics_where(topics, is_truth);
  if (chosen.truth.empty() && !options.truth_topic.empty()) {
    throw InputError(name + ": no topic of poses for mission.truth_topic = " +
                     text::quoted(options.truth_topic) + "; the recording has " + available_topics);
  }
  Topics rest = topics_where(topics, [&](const StreamTopic& topic) { return !is_truth(topic); });
  keep_named(rest, options.odometry_topic, "odometry_topic", is_pose, name, available_topics);
  keep_named(rest, options.cloud_topic, "cloud_topic", is_cloud, name, available_topics);

  std::set<std::string> names;
  for (const Group& group : robots_among(rest, recording)) {
    RobotTopics robot;
    robot.name = group.name.empty() ? "robot" : group.name;
    for (int n = 2; !names.insert(robot.name).second; ++n) robot.name = group.name + "_" + std::to_string(n);
    robot.poses =
        best_of(topics_where(group.topics, is_pose), robot.name, "poses", "--odometry-topic", problems);
    robot.clouds =
        best_of(topics_where(group.topics, is_cloud), robot.name, "clouds", "--cloud-topic", problems);
    chosen.robots.push_back(std::move(robot));
  }
  if (chosen.robots.empty()) {
    throw InputError(
        name +
        ": no mission in it: expected pose_graph_msgs/PoseGraph and KeyedScan, or nav_msgs/Odometry "
        "or geometry_msgs/PoseStamped with sensor_msgs/PointCloud2; the recording has " +
        available_topics +
        (chosen.truth.empty() ? "" : "; " + chosen.truth.front().name + " is taken as the truth"));
  }
  return chosen;
}

}  // namespace loopwise::bags
