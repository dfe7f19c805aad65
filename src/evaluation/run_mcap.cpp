// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/run_mcap.hpp>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <set>
#include <sstream>
#include <system_error>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/version.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "mcap_writer.hpp"
#include "report_arrays.hpp"
#include "report_paths.hpp"
#include "ros2_messages.hpp"
#include "run_closures.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

/// A file that gets its name only when it is complete.
class WholeFile {
 public:
  explicit WholeFile(fs::path path)
      : path_(std::move(path)), part_(path_.string() + ".part"), out_(part_, std::ios::binary) {
    if (!out_) throw IoError(part_.string(), "cannot be written");
  }
  ~WholeFile() {
    std::error_code ignored;
    if (!is_done_) fs::remove(part_, ignored);
  }
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;

  [[nodiscard]] std::ostream& out() { return out_; }
  void finish() {
    out_.close();
    if (!out_) throw IoError(part_.string(), "cannot be written: is the disk full?");
    flush_file(part_);
    fs::rename(part_, path_);
    is_done_ = true;
  }

 private:
  fs::path path_, part_;
  std::ofstream out_;
  bool is_done_ = false;
};

/// An event: a key frame of a robot, or a closure.
struct Moment {
  std::int64_t time_ns;
  std::size_t robot;  // of closures: the number of robots
  std::size_t index;
  bool operator<(const Moment& other) const {
    return std::tie(time_ns, robot, index) < std::tie(other.time_ns, other.robot, other.index);
  }
};

class RunRecording {
 public:
  RunRecording(const fs::path& run, const Mission& mission, const McapOptions& options)
      : mission_(mission), options_(options), graph_(read_g2o(run / "graph.g2o").graph) {
    for (const Node& node : graph_.nodes()) {
      if (!mission.graph.contains(node.key)) {
        throw InputError(run.string() + ": node " + key_name(node.key) + " is not of mission " +
                         mission.path.string() + "; give the mission that was replayed");
      }
    }
    origin_ = map_origin(graph_);
    for (RobotPath& path : robot_paths(run, graph_)) add_robot(std::move(path));
    if (fs::exists(run / "closures.csv")) {
      for (const RunClosure& closure : read_run_closures(run / "closures.csv")) {
        if (closure.verified && graph_.contains(closure.from) && graph_.contains(closure.to))
          closures_.push_back(closure);
      }
    } else {
      result_.notes.emplace_back("no closures.csv: no closures");
    }
    if (!origin_.isZero(0.0)) {
      std::ostringstream where;
      where << std::fixed << std::setprecision(0) << origin_.transpose();
      result_.notes.push_back("positions are relative to " + where.str() + " m");
    }
  }

  McapResult write(std::ostream& out, const ProgressCallback& progress) {
    McapWriter file(out, "loopwise " + std::string(version()));
    for (Robot& robot : robots_) {
      robot.scan = file.channel(robot.topic + "/scan", ros2::point_cloud_type().name,
                                ros2::point_cloud_type().definition);
      robot.path = file.channel(robot.topic + "/path", ros2::path_type().name, ros2::path_type().definition);
      if (robot.path_of.odometry.empty()) continue;
      robot.odometry =
          file.channel(robot.topic + "/odometry", ros2::path_type().name, ros2::path_type().definition);
    }
    const std::uint16_t closures =
        file.channel("/closures", ros2::marker_array_type().name, ros2::marker_array_type().definition);
    const std::vector<Moment> moments = all_moments();
    for (std::size_t i = 0; i < moments.size(); ++i) {
      const Moment& moment = moments[i];
      if (moment.robot < robots_.size()) {
        write_key_frame(file, robots_[moment.robot], moment.index, moment.time_ns);
      } else {
        file.add(closures, moment.time_ns, closure_message(moment));
        ++result_.closures;
      }
      if (progress && i % 64 == 0) progress({"writing messages", i, moments.size(), ""});
    }
    file.finish();
    result_.messages = file.messages();
    if (missing_scans_ > 0) {
      result_.notes.push_back(std::to_string(missing_scans_) + " key frames have no scan that can be read");
    }
    return std::move(result_);
  }

 private:
  struct Robot {
    RobotPath path_of;
    std::string topic;
    std::uint16_t scan = 0, path = 0, odometry = 0;
    std::vector<StampedPose> so_far, odometry_so_far;
  };

  void add_robot(RobotPath path) {
    std::string name = path.name;
    if (const auto known = mission_.robots.find(path.keys.front())) name = mission_.robots[*known].name;
    std::string topic = "/" + plain_file_name(name);
    std::replace(topic.begin(), topic.end(), '-', '_');
    if (!topics_.insert(topic).second) topic += "_" + std::to_string(robots_.size());
    Robot robot;
    robot.path_of = std::move(path);
    robot.topic = std::move(topic);
    robots_.push_back(std::move(robot));
  }

  [[nodiscard]] std::vector<Moment> all_moments() const {
    std::vector<Moment> moments;
    std::int64_t last_ns = mission_.start_ns;
    for (std::size_t r = 0; r < robots_.size(); ++r) {
      const std::vector<Key>& keys = robots_[r].path_of.keys;
      for (std::size_t i = 0; i < keys.size(); ++i) {
        moments.push_back({mission_.graph.node(keys[i]).stamp_ns, r, i});
        last_ns = std::max(last_ns, moments.back().time_ns);
      }
    }
    for (std::size_t c = 0; c < closures_.size(); ++c) {
      const double time_s = closures_[c].time_s;
      const std::int64_t time_ns =
          std::isfinite(time_s) ? mission_.start_ns + std::llround(time_s * 1e9) : last_ns;
      moments.push_back({time_ns, robots_.size(), c});
    }
    std::sort(moments.begin(), moments.end());
    return moments;
  }

  [[nodiscard]] Eigen::Isometry3d shown(Eigen::Isometry3d pose) const {
    pose.translation() -= origin_;
    return pose;
  }

  void write_key_frame(McapWriter& file, Robot& robot, std::size_t index, std::int64_t time_ns) {
    const RobotPath& path = robot.path_of;
    const Key key = path.keys[index];
    const Eigen::Isometry3d pose = shown(graph_.node(key).pose);
    const ros2::Header header{time_ns, mission_.frame};
    write_scan(file, robot.scan, key, pose, header);
    robot.so_far.push_back({time_ns, pose});
    if (!path.odometry.empty()) robot.odometry_so_far.push_back({time_ns, shown(path.odometry[index])});
    const std::size_t stride =
        std::max<std::size_t>(1, path.keys.size() / static_cast<std::size_t>(options_.paths));
    if (index % stride != 0 && index + 1 != path.keys.size()) return;
    file.add(robot.path, time_ns, ros2::path(header, robot.so_far));
    if (!path.odometry.empty()) file.add(robot.odometry, time_ns, ros2::path(header, robot.odometry_so_far));
  }

  void write_scan(McapWriter& file, std::uint16_t channel, Key key, const Eigen::Isometry3d& pose,
                  const ros2::Header& header) {
    std::shared_ptr<const PointCloud> cloud;
    try {
      if (mission_.scans->has(key)) cloud = mission_.scans->load(key);
    } catch (const Error&) {  // the store has counted the problem
    }
    if (!cloud) {
      ++missing_scans_;
      return;
    }
    std::vector<Eigen::Vector3f> points;
    const Eigen::Isometry3f T = pose.cast<float>();
    for (const std::size_t i :
         drawn(cloud->size(), options_.scan_points, combine_seeds(options_.seed, key))) {
      points.push_back(T * cloud->points[i]);
    }
    file.add(channel, header.stamp_ns, ros2::point_cloud(header, points));
    ++result_.scans;
  }

  [[nodiscard]] std::string closure_message(const Moment& moment) const {
    const RunClosure& closure = closures_[moment.index];
    const bool kept = closure.weight > ClosureClassOptions().gnc_inlier_weight;
    ros2::LineList line;
    line.name = kept ? "kept" : "left_out";
    line.id = static_cast<std::int32_t>(moment.index);
    line.points = {shown(graph_.node(closure.from).pose).translation(),
                   shown(graph_.node(closure.to).pose).translation()};
    line.colour = kept ? std::array<float, 4>{0.48F, 0.25F, 0.63F, 0.8F}
                       : std::array<float, 4>{0.82F, 0.28F, 0.04F, 0.9F};
    return ros2::marker_array({moment.time_ns, mission_.frame}, {line});
  }

  const Mission& mission_;
  const McapOptions& options_;
  PoseGraph graph_;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();
  std::vector<Robot> robots_;
  std::set<std::string> topics_;
  std::vector<RunClosure> closures_;
  std::size_t missing_scans_ = 0;
  McapResult result_;
};

}  // namespace

McapResult write_run_mcap(const fs::path& file, const fs::path& run, const Mission& mission,
                          const McapOptions& options, const ProgressCallback& progress) {
  validate(options);
  RunRecording recording(run, mission, options);
  WholeFile out(file);
  McapResult result = recording.write(out.out(), progress);
  out.finish();
  return result;
}

}  // namespace loopwise
