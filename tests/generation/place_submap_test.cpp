// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/place_submap.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/features/place.hpp>

#include "testing.hpp"

namespace loopwise::place_submap_test {
namespace {

Eigen::Isometry3d pose(double x, double yaw, double roll = 0.0) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp({0.0, 0.0, yaw}) * se3::so3_exp({roll, 0.0, 0.0});
  T.translation().x() = x;
  return T;
}

/// A robot that drives along x in steps of 0.5 m, and sees a pole 10 m to the left of the origin from every
/// node. A second robot sees something else.
struct Drive {
  PoseGraph graph;
  Robots robots{{{"a", 0, 99}, {"b", 100, 199}}};
  std::vector<Key> asked;

  Drive() {
    for (Key key = 0; key < 40; ++key) {
      Node node;
      node.key = key;
      node.pose = pose(0.5 * static_cast<double>(key), 0.1 * static_cast<double>(key), 0.05);
      graph.add_node(node);
      if (key > 0) {
        Edge edge;
        edge.from = key - 1;
        edge.to = key;
        edge.kind = EdgeKind::kOdometry;
        edge.T_from_to = graph.node(key - 1).pose.inverse() * node.pose;
        graph.add_edge(edge);
      }
    }
  }
  [[nodiscard]] PlaceSubmap submap(Key key, const PlaceSubmapOptions& options) {
    return place_submap(
        graph, robots, key,
        [this](Key of) -> std::shared_ptr<const PointCloud> {
          asked.push_back(of);
          if (of == 18) return nullptr;
          auto cloud = std::make_shared<PointCloud>();
          const Eigen::Vector3d pole(0.0, 10.0, 2.0);
          cloud->points.push_back((graph.node(of).pose.inverse() * pole).cast<float>());
          return cloud;
        },
        options);
  }
};

}  // namespace

TEST_CASE("place submap: neighbours along the odometry meet in the level frame", "[generation][place]") {
  Drive drive;
  PlaceSubmapOptions options;
  options.path_m = 3.1;
  options.spacing_m = 0.9;
  const PlaceSubmap submap = drive.submap(20, options);
  // Every second node within 3 m; 18 has no scan, and 17 takes its place.
  REQUIRE(drive.asked == std::vector<Key>{20, 18, 17, 15, 22, 24, 26});
  REQUIRE(submap.level.size() == 6);
  const Eigen::Isometry3d& centre = drive.graph.node(20).pose;
  const Eigen::Vector3d seen = submap.rotation * (centre.inverse() * Eigen::Vector3d(0.0, 10.0, 2.0));
  for (const Eigen::Vector3f& point : submap.level.points) {
    REQUIRE((point.cast<double>() - seen).norm() < 1e-5);
    REQUIRE(point.z() == Approx(2.0F));  // upright
  }
}

TEST_CASE("place submap: empty without a scan of the node", "[generation][place]") {
  Drive drive;
  REQUIRE(drive.submap(18, {}).level.empty());
  REQUIRE_THROWS_AS(drive.submap(77, {}), UnknownKeyError);
}

}  // namespace loopwise::place_submap_test
