// SPDX-License-Identifier: BSD-3-Clause
#include <system_error>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/replay/code_version.hpp>

#include "replay_command.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

ContentHash hash_of(const PoseGraph& graph) {
  ContentHasher hasher;
  const auto add_pose = [&hasher](const Eigen::Isometry3d& pose) {
    for (const double value : pose.matrix().reshaped()) hasher.number(value);
  };
  for (const Node& node : graph.nodes()) {
    hasher.integer(node.key).integer(static_cast<std::uint64_t>(node.stamp_ns));
    add_pose(node.pose);
  }
  for (const Edge& edge : graph.edges()) {
    hasher.integer(edge.from).integer(edge.to);
    add_pose(edge.T_from_to);
  }
  return hasher.finish();
}

/// Trajectories of an earlier run in the folder, which may have had other robots.
std::vector<fs::path> former_trajectories(const fs::path& folder) {
  std::vector<fs::path> files;
  if (!fs::is_directory(folder / "trajectories")) return files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "trajectories")) {
    if (entry.path().extension() == ".tum") files.push_back("trajectories" / entry.path().filename());
  }
  return files;
}

}  // namespace

std::string fingerprint(const Mission& mission, const Config& config) {
  Json json = Json::object();
  json["mission"] = mission.name;
  json["graph"] = to_string(hash_of(mission.graph));
  json["scans"] = mission.scans->size();
  json["options"] = parse_json(config_json(config), "options");
  json["content"] = to_string(ContentHasher().text(config_key(config)).finish());
  json["code"] = replay_code_version();
  return json_text(json);
}

void remove_former(const fs::path& file) {
  std::error_code failure;
  fs::remove(file, failure);
  if (failure) throw IoError(file.string(), "cannot be removed: " + failure.message());
}

void remove_former_results(const fs::path& folder) {
  for (const char* name : {"summary.json", "odometry.csv", "map.pcd", "map.ply", "picture.svg"})
    remove_former(folder / name);
  for (const fs::path& file : former_trajectories(folder)) remove_former(folder / file);
}

std::shared_ptr<OutcomeStore> open_store(const ReplayArguments& arguments) {
  if (arguments.outcomes.empty()) return nullptr;
  return std::make_shared<OutcomeStore>(arguments.outcomes, arguments.outcomes_bound);
}

}  // namespace loopwise::cli
