// SPDX-License-Identifier: BSD-3-Clause
#include "component_paths.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/Dense>

#include <loopwise/core/error.hpp>

namespace loopwise::joining {
namespace {

constexpr double kDriftPath_m = 50.0;  // JoinOptions::drift_m is the drift of odometry over this path

/// Mean variances that the odometry edge between two nodes states; empty if there is no such edge.
std::optional<Drift> stated(const PoseGraph& graph, std::size_t a, std::size_t b) {
  for (const std::size_t number : graph.edges_of(a)) {
    const Edge& edge = graph.edges()[number];
    const PoseGraph::Ends ends = graph.ends(number);
    if (edge.kind != EdgeKind::kOdometry || (ends.from == a ? ends.to : ends.from) != b) continue;
    const Eigen::Vector3d m = edge.information.diagonal().head<3>(),
                          rad = edge.information.diagonal().tail<3>();
    const auto variance = [](const Eigen::Vector3d& information) {
      return information.minCoeff() > 1e-12 ? information.cwiseInverse().mean() : 1e12;
    };
    return Drift{variance(m), variance(rad)};
  }
  return std::nullopt;
}

}  // namespace

ComponentPaths::ComponentPaths(const PoseGraph& graph, const std::vector<JoinComponent>& components,
                               const JoinOptions& options)
    : drift_m2_per_m_(options.drift_m * options.drift_m / kDriftPath_m),
      drift_rad2_per_m_(options.drift_rad * options.drift_rad / kDriftPath_m) {
  if (graph.planar()) throw InputError("a 2D graph: only components of 3D graphs can be joined");
  const double margin2 = options.odometry_margin * options.odometry_margin;
  std::size_t path = 0;
  for (std::size_t c = 0; c < components.size(); ++c) {
    const std::size_t first = nodes_.size();
    for (const Key key : components[c].keys) {
      const std::size_t node = graph.index_of(key);
      PathNode here;
      here.key = key;
      here.component = c;
      here.pose = graph.nodes()[node].pose;
      const bool at_start = nodes_.size() == first;
      const std::optional<Drift> step =
          at_start ? std::nullopt : stated(graph, graph.index_of(nodes_.back().key), node);
      if (step) {
        const PathNode& last = nodes_.back();
        const double length = (here.pose.translation() - last.pose.translation()).norm();
        here.path = last.path;
        here.path_length_m = last.path_length_m + length;
        here.since_start = {
            last.since_start.translation_m2 + margin2 * step->translation_m2 + drift_m2_per_m_ * length,
            last.since_start.rotation_rad2 + margin2 * step->rotation_rad2 + drift_rad2_per_m_ * length};
      } else {
        here.path = path++;
      }
      if (!number_.emplace(key, nodes_.size()).second)
        throw InputError("key " + key_name(key) + " belongs to two components");
      nodes_.push_back(here);
    }
    ranges_.emplace_back(first, nodes_.size());
  }
}

std::size_t ComponentPaths::of(Key key) const {
  const auto found = number_.find(key);
  if (found == number_.end()) throw UnknownKeyError("key " + key_name(key) + " belongs to no component");
  return found->second;
}

Drift ComponentPaths::between(std::size_t a, std::size_t b) const {
  const PathNode &x = nodes_[a], &y = nodes_[b];
  const double distance = (x.pose.translation() - y.pose.translation()).norm();
  Drift out;
  if (x.path == y.path) {
    out.translation_m2 = std::abs(x.since_start.translation_m2 - y.since_start.translation_m2);
    out.rotation_rad2 = std::abs(x.since_start.rotation_rad2 - y.since_start.rotation_rad2);
  } else {  // two paths of one map: as if odometry led straight from one pose to the other
    out = {drift_m2_per_m_ * distance, drift_rad2_per_m_ * distance};
  }
  // Rotation error that builds up evenly adds a third of its variance times the squared distance.
  out.translation_m2 += out.rotation_rad2 * distance * distance / 3.0;
  return out;
}

}  // namespace loopwise::joining
