// SPDX-License-Identifier: BSD-3-Clause
#include "report_paths.hpp"

#include <algorithm>
#include <set>

#include <loopwise/core/robots.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise {

namespace fs = std::filesystem;

std::vector<RobotPath> robot_paths(const fs::path& folder, const PoseGraph& graph) {
  std::vector<Key> keys = graph.keys();
  std::sort(keys.begin(), keys.end());

  struct File {
    std::string name;
    std::vector<StampedPose> poses;
    std::vector<StampedPose> odometry;
  };
  std::vector<File> files;
  if (fs::is_directory(folder / "trajectories")) {
    std::vector<fs::path> paths;
    for (const auto& entry : fs::directory_iterator(folder / "trajectories")) paths.push_back(entry.path());
    std::sort(paths.begin(), paths.end());
    for (const fs::path& path : paths) {
      const fs::path odometry = path.parent_path() / (path.stem().string() + "_odometry.tum");
      if (path.extension() != ".tum" || !fs::exists(odometry)) continue;
      files.push_back({path.stem().string(), read_tum(path), read_tum(odometry)});
    }
  }
  const auto goes_through = [&](const File& file, std::size_t from) {
    if (file.poses.empty() || file.poses.size() > keys.size() - from) return false;
    for (std::size_t i = 0; i < file.poses.size(); ++i) {
      const Eigen::Vector3d& p = graph.node(keys[from + i]).pose.translation();
      if ((p - file.poses[i].pose.translation()).norm() > 1e-4) return false;
    }
    return true;
  };

  std::vector<RobotPath> robots;
  std::vector<Key> unnamed;
  std::set<std::size_t> used;
  for (std::size_t at = 0; at < keys.size();) {
    std::size_t found = files.size();
    for (std::size_t f = 0; f < files.size() && found == files.size(); ++f) {
      if (used.count(f) == 0 && goes_through(files[f], at)) found = f;
    }
    if (found == files.size()) {
      unnamed.push_back(keys[at++]);
      continue;
    }
    used.insert(found);
    RobotPath robot;
    robot.name = files[found].name;
    for (const StampedPose& pose : files[found].poses) {
      robot.keys.push_back(keys[at++]);
      robot.stamps_ns.push_back(pose.stamp_ns);
    }
    for (const StampedPose& pose : files[found].odometry) robot.odometry.push_back(pose.pose);
    if (robot.odometry.size() != robot.keys.size()) robot.odometry.clear();
    robots.push_back(std::move(robot));
  }
  const Robots by_character = Robots::from_keys(unnamed);
  for (const Robot& robot : by_character.all()) {
    RobotPath path;
    path.name = robot.name;
    for (const Key key : unnamed) {
      if (robot.first <= key && key <= robot.last) path.keys.push_back(key);
    }
    robots.push_back(std::move(path));
  }
  return robots;
}

std::vector<std::string> labels_of(const std::vector<fs::path>& folders) {
  std::vector<std::vector<std::string>> words;
  for (const fs::path& folder : folders) {
    std::vector<std::string> parts;
    for (const fs::path& part : fs::absolute(folder).lexically_normal()) {
      if (!part.empty() && part != "/") parts.push_back(part.string());
    }
    words.push_back(parts);
  }
  std::vector<std::string> labels;
  for (std::size_t length = 1; length < 16; ++length) {
    labels.clear();
    for (const auto& parts : words) {
      std::string label;
      for (std::size_t i = parts.size() - std::min(length, parts.size()); i < parts.size(); ++i)
        label += (label.empty() ? "" : "/") + parts[i];
      labels.push_back(label);
    }
    if (std::set<std::string>(labels.begin(), labels.end()).size() == labels.size()) break;
  }
  return labels;
}

}  // namespace loopwise
