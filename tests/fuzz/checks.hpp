// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Invariants of the data that readers return.
#pragma once

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>

#include "target.hpp"

namespace loopwise::fuzz {

inline void check_pose(const Eigen::Isometry3d& pose) {
  expect(finite(pose.matrix()), "a pose is finite");
  const Eigen::Matrix3d R = pose.linear();
  expect(finite(R) && (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-6 &&
             R.determinant() > 0.0,
         "a pose is rigid");
}

inline void check_graph(const PoseGraph& graph) {
  for (const Node& node : graph.nodes()) check_pose(node.pose);
  for (const Edge& edge : graph.edges()) {
    expect(graph.contains(edge.from) && graph.contains(edge.to), "an edge has its nodes");
    check_pose(edge.T_from_to);
    expect(check_information(edge.information) == nullptr, "information is semi-definite");
  }
  for (const PriorFactor& prior : graph.priors()) {
    expect(graph.contains(prior.key), "a prior has its node");
    check_pose(prior.pose);
    expect(check_information(prior.information) == nullptr, "information is semi-definite");
  }
}

inline void check_problems(const Problems& problems) {
  for (const Problem& problem : problems.all()) {
    expect(problem.count > 0 && !problem.kind.empty() && !to_string(problem).empty(), "problems are counted");
  }
}

inline void check_cloud(const PointCloud& cloud) {
  for (const Eigen::Vector3f& point : cloud.points) {
    expect(finite(point) && point.cwiseAbs().maxCoeff() <= 1e7f, "points are finite and in range");
  }
  expect(cloud.normals.empty() || cloud.normals.size() == cloud.size(), "a normal for every point or none");
  for (const Eigen::Vector3f& normal : cloud.normals) {
    expect(std::abs(normal.norm() - 1.0f) < 1e-3f, "normals are of unit length");
  }
  expect(cloud.intensities.empty() || cloud.intensities.size() == cloud.size(),
         "an intensity for every point or none");
  for (const float intensity : cloud.intensities) expect(std::isfinite(intensity), "intensities are finite");
}

/// A mission, with its scans read.
inline void check_mission(const Mission& mission) {
  check_graph(mission.graph);
  check_problems(mission.problems);
  expect(!mission.graph.empty(), "a mission has a node");
  expect(mission.scans != nullptr, "a mission has a store of scans");
  for (const Node& node : mission.graph.nodes()) {
    expect(mission.robots.find(node.key).has_value(), "every node has its robot");
    expect(std::isfinite(mission.time_s(node.stamp_ns)), "times are finite");
  }
  for (const auto& entry : mission.reference) {
    expect(mission.graph.contains(entry.first), "the reference is of nodes");
  }
  for (const auto& [key, pose] : mission.ground_truth) {
    expect(mission.graph.contains(key), "the truth is of nodes");
    check_pose(pose);
  }
  for (const CommunicationGap& gap : mission.gaps) {
    expect(gap.robot < mission.robots.size() && gap.begin_s < gap.end_s,
           "gaps are of robots, and have a length");
  }
  for (const BeaconDrop& drop : mission.beacons) {
    expect(drop.robot < mission.robots.size() && mission.graph.contains(drop.drop_key),
           "beacons lie at nodes");
  }
  for (const RadioReading& reading : mission.radio) {
    expect(mission.graph.contains(reading.key), "readings are of nodes");
  }
  for (const Key key : mission.scans->keys()) {
    const auto scan = attempt([&] { return mission.scans->load(key); });
    if (!scan) continue;
    expect(*scan != nullptr, "a scan that the store has is there");
    check_cloud(**scan);
  }
}

}  // namespace loopwise::fuzz
