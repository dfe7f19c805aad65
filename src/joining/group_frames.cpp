// SPDX-License-Identifier: BSD-3-Clause
#include "group_frames.hpp"

#include <algorithm>
#include <map>
#include <utility>

#include <Eigen/Dense>

#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>

namespace loopwise::joining {
namespace {

/// Relative pose of two nodes of a component, with the uncertainty of the drift between them.
Edge path_edge(const ComponentPaths& paths, std::size_t from, std::size_t to) {
  constexpr double kLeast_m2 = 1e-4, kLeast_rad2 = 1e-6;
  Drift drift = paths.between(from, to);
  drift.translation_m2 += kLeast_m2;
  drift.rotation_rad2 += kLeast_rad2;
  Edge edge;
  edge.from = paths[from].key;
  edge.to = paths[to].key;
  edge.T_from_to = paths[from].pose.inverse() * paths[to].pose;
  edge.information = drift.covariance().inverse();
  edge.kind = EdgeKind::kOdometry;
  return edge;
}

/// Adds errors that closures at one place share and that their covariances do not contain.
Edge closure_edge(const LoopClosure& closure) {
  constexpr double kShared_m2 = 0.05 * 0.05, kShared_rad2 = 0.005 * 0.005;
  LoopClosure wider = closure;
  wider.covariance += Drift{kShared_m2, kShared_rad2}.covariance();
  Edge edge;
  edge.from = wider.from;
  edge.to = wider.to;
  edge.T_from_to = wider.T_from_to;
  edge.information = wider.covariance.inverse();
  edge.information = 0.5 * (edge.information + edge.information.transpose()).eval();
  return edge;
}

/// Graph of the paths without closures. Paths of one map are connected as by straight odometry between them.
PoseGraph graph_of(const ComponentPaths& paths, const std::vector<std::size_t>& members) {
  PoseGraph graph;
  for (const std::size_t member : members) {
    for (std::size_t s = paths.begin(member); s < paths.end(member); ++s) {
      Node node;
      node.key = paths[s].key;
      node.pose = paths[s].pose;
      graph.add_node(node);
      if (s == paths.begin(member)) continue;
      const bool continues_path = paths[s - 1].path == paths[s].path;
      graph.add_edge(path_edge(paths, continues_path ? s - 1 : paths.begin(member), s));
    }
  }
  constexpr double kAnchor = 1e8;  // 0.1 mm and 0.1 mrad
  PriorFactor anchor;
  anchor.key = paths[paths.begin(members.front())].key;
  anchor.pose = paths[paths.begin(members.front())].pose;
  anchor.information = kAnchor * Matrix6d::Identity();
  graph.add_prior(anchor);
  return graph;
}

/// A pose in its component's own frame, and the same pose in the common frame.
using Placed = std::pair<Eigen::Isometry3d, Eigen::Isometry3d>;

/// The rigid transform that moves poses of a component to their common frame on average. The optimisation
/// bends the path, so no rigid transform fits all poses exactly.
Eigen::Isometry3d mean_move(const std::vector<Placed>& ends) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  Eigen::Vector3d from = Eigen::Vector3d::Zero(), to = Eigen::Vector3d::Zero();
  for (const auto& [own, place] : ends) {
    const Eigen::Quaterniond q(Eigen::Matrix3d(place.linear() * own.linear().transpose()));
    sum += q.coeffs() * q.coeffs().transpose();
    from += own.translation();
    to += place.translation();
  }
  const auto n = static_cast<double>(ends.size());
  Eigen::Quaterniond mean;
  mean.coeffs() = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(sum).eigenvectors().col(3);
  Eigen::Isometry3d move = Eigen::Isometry3d::Identity();
  move.linear() = mean.normalized().toRotationMatrix();
  move.translation() = to / n - move.linear() * (from / n);
  return move;
}

/// Frames of the members from the optimised relative poses of the kept closures. Starts with the first member
/// and always adds the member with the most closures to the members added so far.
std::vector<Eigen::Isometry3d> frames_of(const ComponentPaths& paths, const PoseGraph& graph,
                                         const std::vector<std::size_t>& members,
                                         const std::vector<std::size_t>& kept) {
  std::map<std::size_t, Eigen::Isometry3d> frames{{members.front(), Eigen::Isometry3d::Identity()}};
  while (frames.size() < members.size()) {
    std::map<std::size_t, std::vector<Placed>> ends;
    for (const std::size_t e : kept) {
      const Edge& edge = graph.edges()[e];
      std::size_t x = paths.of(edge.from), y = paths.of(edge.to);
      if (frames.count(paths[y].component) != 0) std::swap(x, y);
      if (frames.count(paths[x].component) == 0 || frames.count(paths[y].component) != 0) continue;
      const Eigen::Isometry3d T_x_y = graph.node(paths[x].key).pose.inverse() * graph.node(paths[y].key).pose;
      ends[paths[y].component].emplace_back(paths[y].pose,
                                            frames.at(paths[x].component) * paths[x].pose * T_x_y);
    }
    if (ends.empty()) break;
    const auto most = std::max_element(ends.begin(), ends.end(), [](const auto& p, const auto& q) {
      return p.second.size() < q.second.size();
    });
    frames[most->first] = mean_move(most->second);
  }
  std::vector<Eigen::Isometry3d> out;
  for (const std::size_t member : members) {
    const auto found = frames.find(member);
    out.push_back(found == frames.end() ? Eigen::Isometry3d::Identity() : found->second);
  }
  return out;
}

}  // namespace

GroupFrames optimize_group(const ComponentPaths& paths, const std::vector<std::size_t>& members,
                           const std::vector<const Tie*>& ties, const StopToken& stop) {
  PoseGraph graph = graph_of(paths, members);
  const std::size_t first_closure = graph.edges().size();
  std::vector<std::size_t> tie_of;
  for (std::size_t t = 0; t < ties.size(); ++t) {
    for (const LoopClosure& closure : ties[t]->closures) {
      graph.add_edge(closure_edge(closure));
      tie_of.push_back(t);
    }
  }
  // Each member is in its own frame, so the graph's poses are not an initial estimate.
  OptimizerOptions optimizer;
  optimizer.initialization = Initialization::kOdometry;
  const GncResult result = optimize_gnc(graph, optimizer, {}, stop);
  graph.set_poses(result.optimization.poses);

  GroupFrames out;
  out.kept.assign(ties.size(), 0.0);
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < tie_of.size(); ++i) {
    const std::size_t e = first_closure + i;
    graph.set_weight(e, result.weights[e]);
    if (result.weights[e] < 0.5) continue;
    out.kept[tie_of[i]] += 1.0;
    kept.push_back(e);
  }
  for (std::size_t t = 0; t < ties.size(); ++t) {
    if (!ties[t]->closures.empty()) out.kept[t] /= static_cast<double>(ties[t]->closures.size());
  }
  out.frames = frames_of(paths, graph, members, kept);
  const Marginals uncertain = marginals(graph);
  for (const std::size_t member : members) {
    const bool reference = member == members.front();
    const std::size_t first = graph.index_of(paths[paths.begin(member)].key);
    out.covariances.push_back(reference ? Matrix6d(Matrix6d::Zero()) : uncertain.covariances[first]);
  }
  return out;
}

}  // namespace loopwise::joining
