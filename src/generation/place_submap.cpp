// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/place_submap.hpp>

#include <loopwise/core/odometry_walk.hpp>
#include <loopwise/features/place.hpp>

namespace loopwise {
namespace {

void merge(PointCloud& all, const PointCloud& cloud, const Eigen::Isometry3d& T) {
  const Eigen::Matrix3f R = T.linear().cast<float>();
  const Eigen::Vector3f t = (T * cloud.origin).cast<float>();
  all.points.reserve(all.points.size() + cloud.size());
  for (const Eigen::Vector3f& point : cloud.points) all.points.emplace_back(R * point + t);
}

}  // namespace

PlaceSubmap place_submap(const PoseGraph& graph, const Robots& robots, Key centre, const ScanLoader& scans,
                         const PlaceSubmapOptions& options) {
  PlaceSubmap submap;
  submap.rotation = level_rotation(graph.node(centre).pose);
  const auto own = scans(centre);
  if (!own) return submap;
  Eigen::Isometry3d level = Eigen::Isometry3d::Identity();
  level.linear() = submap.rotation;
  merge(submap.level, *own, level);
  for (const bool forward : {false, true}) {
    OdometryWalk walk(graph, robots, centre, forward);
    double path_m = 0.0, merged_m = 0.0;
    Eigen::Vector3d before = Eigen::Vector3d::Zero();
    while (const auto place = walk.next()) {
      path_m += (place->T_start_here.translation() - before).norm();
      before = place->T_start_here.translation();
      if (!(path_m <= options.path_m)) break;
      if (path_m - merged_m < options.spacing_m) continue;
      const auto scan = scans(graph.nodes()[place->node].key);
      if (!scan) continue;
      merged_m = path_m;
      merge(submap.level, *scan, level * place->T_start_here);
    }
  }
  return submap;
}

}  // namespace loopwise
