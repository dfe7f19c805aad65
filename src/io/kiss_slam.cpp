// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "saved_maps.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

/// The program writes the identity as the information of every edge, which is not a measured value.
void mark_without_information(G2oFile& file, const std::string& name) {
  std::vector<std::size_t> bare;
  for (std::size_t e = 0; e < file.graph.edges().size(); ++e) {
    const Edge& edge = file.graph.edges()[e];
    if (!edge.information.isApprox(Matrix6d::Identity(), 1e-9)) continue;
    bare.push_back(e);
    file.problems.add_altered("edge with the identity as information, replaced by that of the options",
                              name + ": " + std::to_string(edge.from) + " to " + std::to_string(edge.to));
  }
  file.without_information.insert(file.without_information.end(), bare.begin(), bare.end());
}

constexpr double kFar_m = 300.0;  // largest distance of a cloud from its sensor

/// Moves a cloud from world coordinates to the frame of its node. \throws InputError naming the file if the
/// cloud is not around the node
CloudFile moved_to_node(CloudFile file, const Eigen::Isometry3d& T_world_node, const std::string& name) {
  PointCloud& cloud = file.cloud;
  const Eigen::Isometry3d T = T_world_node.inverse();
  const Eigen::Matrix3f R = T.linear().cast<float>();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (Eigen::Vector3f& point : cloud.points) {
    const Eigen::Vector3d moved = T * (cloud.origin + point.cast<double>());
    sum += moved;
    point = moved.cast<float>();
  }
  const double away_m = sum.norm() / static_cast<double>(std::max<std::size_t>(cloud.size(), 1));
  if (!(away_m < kFar_m)) {
    throw InputError(name + ": the centre of its points is " + std::to_string(away_m) +
                     " m from its node: local maps of KISS-SLAM must be in the coordinates of their graph");
  }
  for (Eigen::Vector3f& normal : cloud.normals) normal = R * normal;
  cloud.origin.setZero();
  return file;
}

}  // namespace

Mission read_kiss_slam(const fs::path& folder, const MissionOptions& options) {
  const fs::path place = fs::is_directory(folder / "local_maps") ? folder / "local_maps" : folder;
  const fs::path file = place / "local_map_graph.g2o";
  G2oFile g2o = read_g2o(file);
  mark_without_information(g2o, file.string());
  Mission mission;
  mission.kind = MissionKind::kKissSlam;
  mission.path = folder;
  mission.name = name_of(folder);
  mission.problems = std::move(g2o.problems);
  mission.robots = robots_of(g2o.graph, options, Robots::from_keys(g2o.graph.keys()));
  mission.problems.add("no stamps given", file.string());
  const Stamps stamps = regular_stamps(g2o.graph, mission.robots, options);
  std::vector<PriorFactor> priors = g2o.graph.priors();
  complete_priors(g2o.graph, mission.robots, options, file.string(), priors, mission.problems);
  mission.graph =
      assemble(g2o.graph, stamps, priors, mission.robots, options, mission.problems, g2o.without_information);
  check_stamps(mission);
  const std::map<Key, fs::path> clouds = numbered_clouds(place / "plys", mission.problems);
  std::vector<Key> keys;
  std::map<Key, Eigen::Isometry3d> poses;
  for (const auto& [key, cloud] : clouds) {
    keys.push_back(key);
    if (mission.graph.contains(key)) poses.emplace(key, mission.graph.node(key).pose);
  }
  set_scans(
      mission, keys,
      [clouds, poses, layout = options.bin_layout](Key key) {
        const auto pose = poses.find(key);
        if (pose == poses.end()) throw InputError(clouds.at(key).string() + ": has no node");
        return moved_to_node(read_cloud(clouds.at(key), layout), pose->second, clouds.at(key).string());
      },
      [&](Key key) { return clouds.at(key).string(); }, options);
  mission.provenance_json = provenance_of(mission.kind, {file.filename().string()});
  return mission;
}

}  // namespace loopwise::parts
