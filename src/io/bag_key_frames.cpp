// SPDX-License-Identifier: BSD-3-Clause
// Bags of odometry and clouds as missions.
#include <algorithm>
#include <optional>
#include <set>

#include <Eigen/Geometry>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/key_frames.hpp>

#include "bag_streams.hpp"
#include "lamp_messages.hpp"
#include "point_cloud2.hpp"

namespace loopwise::bags {
namespace {

std::string frame_name(std::string_view text) {
  return std::string(text.substr(std::min(text.find_first_not_of('/'), text.size())));
}

/// Static transforms, by the child frame.
class StaticTransforms {
 public:
  void add(const ros1::Value& message) {
    message.at("transforms").for_each([&](const ros1::Value& transform) {
      const std::string parent = frame_name(transform.at("header").at("frame_id").text());
      const std::string child = frame_name(transform.at("child_frame_id").text());
      const ros1::Value t = transform.at("transform");
      const auto pose = lamp::pose_of(t.at("translation"), t.at("rotation"));
      if (pose) parents_[child] = {parent, *pose};
    });
  }

  /// T_a_b, if both frames have a common ancestor.
  [[nodiscard]] std::optional<Eigen::Isometry3d> between(const std::string& a, const std::string& b) const {
    const auto above_a = above(a), above_b = above(b);
    for (const auto& [frame, T_frame_a] : above_a) {
      for (const auto& [other, T_other_b] : above_b) {
        if (frame == other) return se3::normalized(T_frame_a.inverse() * T_other_b);
      }
    }
    return std::nullopt;
  }

 private:
  struct Parent {
    std::string name;
    Eigen::Isometry3d T_parent_child;
  };
  /// The frame and its ancestors, each with the frame's pose in it.
  [[nodiscard]] std::vector<std::pair<std::string, Eigen::Isometry3d>> above(std::string frame) const {
    std::vector<std::pair<std::string, Eigen::Isometry3d>> out{{frame, Eigen::Isometry3d::Identity()}};
    constexpr std::size_t kDeepest = 32;  // a file may contain a cycle of frames
    for (auto at = parents_.find(frame); at != parents_.end() && out.size() < kDeepest;
         at = parents_.find(out.back().first)) {
      out.emplace_back(at->second.name, at->second.T_parent_child * out.back().second);
    }
    return out;
  }

  std::map<std::string, Parent> parents_;
};

/// Source of the sweeps of a robot.
struct SweepSource {
  std::string where;  // bag and topic of the clouds
  std::vector<std::size_t> kept;
  std::vector<Eigen::Isometry3d> T_body_world;  // of each sweep, if the clouds are in the frame of the map
};

/// Data of a robot while its messages are read.
struct Recorded {
  RobotStream stream;
  SweepSource source;
  std::string world, body, sensor;  // frames of the first messages; empty if not stated
};

void move_cloud(const Eigen::Isometry3d& T, PointCloud& cloud) {
  for (Eigen::Vector3f& point : cloud.points)
    point = (T * (cloud.origin + point.cast<double>())).cast<float>();
  const Eigen::Matrix3f R = T.linear().cast<float>();
  for (Eigen::Vector3f& normal : cloud.normals) normal = R * normal;
  cloud.origin.setZero();
}

/// Reads the sweeps of all robots; copies of the bags share their files.
class Sweeps {
 public:
  Sweeps(BagSet bags, std::vector<SweepSource> sources)
      : bags_(std::move(bags)), sources_(std::move(sources)) {}

  CloudFile read(std::size_t robot, std::size_t sweep) const {
    const SweepSource& source = sources_[robot];
    const BagSet::Kept kept = bags_.fetch(source.kept[sweep]);
    const std::string name = source.where + ": cloud " + std::to_string(sweep);
    try {
      Decoder decoder({bags_.connections()[kept.connection]});
      CloudFile file = ros1::read_point_cloud2(name, decoder.message(0, kept.bytes));
      if (!source.T_body_world.empty()) move_cloud(source.T_body_world[sweep], file.cloud);
      return file;
    } catch (const InputError& error) {
      const std::string why = error.what();
      throw InputError(why.rfind(name, 0) == 0 ? why : name + ": " + why);
    }
  }

 private:
  BagSet bags_;
  std::vector<SweepSource> sources_;
};

class KeyFrameReader {
 public:
  KeyFrameReader(BagSet bags, const Recording& recording, const MissionOptions& options,
                 const parts::Work& work)
      : bags_(std::move(bags)),
        recording_(recording),
        options_(options),
        work_(work),
        decoder_(bags_.connections()),
        truth_(options, problems_) {}

  Mission run(const std::string& name) {
    choose(name);
    gather();
    for (Recorded& robot : robots_) settle_frames(robot);
    std::vector<RobotStream> streams;
    std::vector<SweepSource> sources;
    for (Recorded& robot : robots_) {
      streams.push_back(std::move(robot.stream));
      sources.push_back(std::move(robot.source));
    }
    const auto sweeps = std::make_shared<const Sweeps>(bags_, std::move(sources));
    Mission mission = make_key_frame_mission(
        streams, [sweeps](std::size_t robot, std::size_t sweep) { return sweeps->read(robot, sweep); },
        options_);
    add_truth(mission);
    Problems all = std::move(problems_);
    all.add(mission.problems);
    mission.problems = std::move(all);
    mission.topics = recorded_topics(bags_.connections(), uses_);
    return mission;
  }

 private:
  [[nodiscard]] std::string bag_of(std::size_t connection) const {
    return recording_.files[decoder_.connection(connection).bag].string();
  }
  [[nodiscard]] std::string where(std::size_t connection) const {
    return bag_of(connection) + ": " + decoder_.connection(connection).topic;
  }

  void choose(const std::string& name) {
    std::map<std::pair<std::size_t, std::string>, StreamTopic> topics;
    for (std::size_t i = 0; i < bags_.connections().size(); ++i) {
      const Connection& connection = bags_.connections()[i];
      const StreamKind kind = stream_kind(connection.type);
      if (kind == StreamKind::kOther || connection.messages == 0) continue;
      if (!decoder_.can_read(i, recording_.files[connection.bag].string(), problems_)) continue;
      const std::string last_word = connection.topic.substr(connection.topic.rfind('/') + 1);
      if (kind == StreamKind::kTransforms) {
        if (last_word == "tf_static") uses_[i] = "poses of sensors";
      } else if (connection.bag >= recording_.own) {
        if (kind != StreamKind::kCloud) uses_[i] = "true poses";
      } else {
        StreamTopic& topic = topics[{recording_.recorders[connection.bag], connection.topic}];
        topic.name = connection.topic;
        topic.kind = kind;
        topic.recorder = recording_.recorders[connection.bag];
        topic.messages += connection.messages;
        topic.connections.push_back(i);
      }
    }
    std::vector<StreamTopic> all;
    for (auto& entry : topics) all.push_back(std::move(entry.second));
    const ChosenTopics chosen =
        choose_topics(all, recording_, options_, name, topics_text(bags_.connections()), problems_);
    for (const StreamTopic& topic : chosen.truth) {
      for (const std::size_t i : topic.connections) uses_[i] = "true poses";
    }
    for (const RobotTopics& robot : chosen.robots) {
      for (const std::size_t i : robot.poses.connections) use(i, "odometry of " + robot.name);
      for (const std::size_t i : robot.clouds.connections) use(i, "clouds of " + robot.name);
      Recorded recorded;
      recorded.stream.name = robot.name;
      recorded.stream.source = where(robot.poses.connections.front());
      recorded.source.where = where(robot.clouds.connections.front());
      robots_.push_back(std::move(recorded));
    }
  }

  void use(std::size_t connection, const std::string& purpose) {
    uses_[connection] = purpose;
    robot_of_[connection] = robots_.size();
  }

  void gather() {
    std::size_t kept = 0;
    bags_.for_each([&](std::size_t connection) { return uses_.count(connection) != 0; },
                   [&](const Message& message) {
                     try {
                       if (!add_message(message)) return false;
                       robots_[robot_of_.at(message.connection)].source.kept.push_back(kept++);
                       return true;
                     } catch (const InputError& error) {
                       problems_.add_altered("message cannot be read",
                                             where(message.connection) + ": " + error.what());
                       return false;
                     }
                   },
                   work_.progress, work_.stop);
  }

  /// Takes a message. Returns whether it is a sweep, which has to be fetched later.
  bool add_message(const Message& recorded) {
    const std::size_t i = recorded.connection;
    const Connection& connection = decoder_.connection(i);
    const ros1::Value message = decoder_.message(i, recorded.bytes);
    const StreamKind kind = stream_kind(connection.type);
    if (kind == StreamKind::kTransforms) {
      transforms_.add(message);
      return false;
    }
    const auto robot = robot_of_.find(i);
    if (robot == robot_of_.end()) {
      truth_.add_truth({connection.topic, recording_.files[connection.bag].filename().string()}, message,
                       recorded.stamp_ns);
      if (truth_source_.empty()) truth_source_ = where(i);
      return false;
    }
    Recorded& of = robots_[robot->second];
    if (message.at("header").at("stamp").time_ns() == 0)
      problems_.add("message without stamp, the time of its record is used", where(i));
    const std::int64_t stamp = lamp::stamp_of(message, recorded.stamp_ns);
    const std::string frame = frame_name(message.at("header").at("frame_id").text());
    if (kind == StreamKind::kCloud) return add_cloud(of, message, frame, stamp, where(i));
    if (of.stream.odometry.empty()) {
      of.world = frame;
      if (kind == StreamKind::kOdometry) of.body = frame_name(message.at("child_frame_id").text());
    }
    if (const auto pose = lamp::pose_of_message(message)) {
      of.stream.odometry.push_back({stamp, *pose});
    } else {
      problems_.add_altered("odometry pose unusable", where(i));
    }
    return false;
  }

  bool add_cloud(Recorded& of, const ros1::Value& message, const std::string& frame, std::int64_t stamp,
                 const std::string& where) {
    ros1::check_point_cloud2("cloud", message);
    if (message.at("width").unsigned_integer() * message.at("height").unsigned_integer() == 0) {
      problems_.add("empty cloud left out", where);
      return false;
    }
    if (of.source.kept.empty()) of.sensor = frame;
    if (frame != of.sensor)
      problems_.add_altered("frame of clouds changes, the first is used",
                            where + ": \"" + of.sensor + "\" and \"" + frame + "\"");
    of.stream.sweep_stamps_ns.push_back(stamp);
    return true;
  }

  /// Brings odometry and clouds to one frame: converts the odometry to the sensor, or the clouds to the body.
  void settle_frames(Recorded& robot) {
    const std::string frames = robot.source.where + ": clouds in \"" + robot.sensor + "\", odometry of \"" +
                               robot.body + "\" in \"" + robot.world + "\"";
    if (robot.sensor == robot.body && !robot.sensor.empty()) return;
    if (!robot.sensor.empty() && robot.sensor == robot.world) {
      problems_.add("clouds in the frame of the odometry, transformed to the frame of the robot", frames);
      std::vector<StampedPose> poses = robot.stream.odometry;
      std::stable_sort(poses.begin(), poses.end(),
                       [](const StampedPose& a, const StampedPose& b) { return a.stamp_ns < b.stamp_ns; });
      for (const std::int64_t stamp : robot.stream.sweep_stamps_ns)
        robot.source.T_body_world.push_back(pose_near(poses, stamp).inverse());
      return;
    }
    const auto T_body_sensor =
        robot.body.empty() ? std::nullopt : transforms_.between(robot.body, robot.sensor);
    if (T_body_sensor) {
      for (StampedPose& pose : robot.stream.odometry) pose.pose = se3::normalized(pose.pose * *T_body_sensor);
      return;
    }
    problems_.add("clouds assumed to be in the frame whose poses are recorded",
                  frames + ": /tf_static has no transform between them");
  }

  /// The pose at a stamp, interpolated if there are poses before and after it, otherwise the nearest one.
  static Eigen::Isometry3d pose_near(const std::vector<StampedPose>& poses, std::int64_t stamp) {
    if (poses.empty()) return Eigen::Isometry3d::Identity();
    const auto after =
        std::lower_bound(poses.begin(), poses.end(), stamp,
                         [](const StampedPose& pose, std::int64_t at) { return pose.stamp_ns < at; });
    if (after == poses.end()) return poses.back().pose;
    if (after == poses.begin() || after->stamp_ns == stamp) return after->pose;
    const StampedPose& before = *std::prev(after);
    const double share =
        static_cast<double>(stamp - before.stamp_ns) / static_cast<double>(after->stamp_ns - before.stamp_ns);
    const Vector6d step = se3::log(before.pose.inverse() * after->pose);
    return se3::normalized(before.pose * se3::exp(share * step));
  }

  void add_truth(Mission& mission) {
    if (!recording_.truth.empty()) {
      parts::set_ground_truth(mission, parts::read_truth(recording_.truth, problems_));
      return;
    }
    truth_.add_truth_to(mission);
    if (!mission.ground_truth.empty()) parts::align_truth_to_nodes(mission, truth_source_);
  }

  BagSet bags_;
  const Recording& recording_;
  const MissionOptions& options_;
  const parts::Work& work_;
  Problems problems_;
  Decoder decoder_;
  lamp::Gatherer truth_;
  std::string truth_source_;  // of its first message
  StaticTransforms transforms_;
  std::vector<Recorded> robots_;
  std::map<std::size_t, std::string> uses_;      // by connection
  std::map<std::size_t, std::size_t> robot_of_;  // by connection
};

}  // namespace

Mission read_key_frames(BagSet bags, const Recording& recording, const MissionOptions& options,
                        const parts::Work& work) {
  return KeyFrameReader(std::move(bags), recording, options, work).run(recording.files.front().string());
}

}  // namespace loopwise::bags
