// SPDX-License-Identifier: BSD-3-Clause
// The only place that decides which edges of a graph are odometry.
#include <algorithm>
#include <map>

#include <Eigen/QR>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {
namespace {

/// Consecutive nodes of a robot have keys that differ by less than this step. A change of the label above the
/// index changes the key by 2^48 minus at most the length of a path.
constexpr Key kLabelStep = Key{1} << (kKeyLabelShift - 1);

/// Quantile 0.9999 of chi-squared with the degrees of freedom of the graph's poses.
double largest_distance(const PoseGraph& graph) {
  return graph.planar() ? 21.11 : 27.86;
}

std::pair<Key, Key> ends_of(const Edge& edge) {
  return std::minmax(edge.from, edge.to);
}

std::string pair_name(Key a, Key b) {
  return key_name(a) + " and " + key_name(b);
}

/// r of the second measurement against the first.
Vector6d difference(const Edge& first, const Edge& second) {
  const Eigen::Isometry3d T = second.from == first.from ? second.T_from_to : second.T_from_to.inverse();
  return se3::log(first.T_from_to.inverse() * T);
}

/// Whether the noise of both explains their difference.
bool agree(const Edge& first, const Edge& second, double largest) {
  const Matrix6d& A = first.information;
  const Matrix6d B = second.from == first.from ? second.information : reversed(second).information;
  const Vector6d r = difference(first, second);
  // Both are upper bounds of the distance below. Repeated edges pass this cheaper test.
  if (std::min(r.dot(A * r), r.dot(B * r)) <= largest) return true;
  // (A⁻¹ + B⁻¹)⁻¹ = A (A + B)⁺ B holds for singular A or B as well.
  const Matrix6d both = A + B;
  return r.dot(A * both.completeOrthogonalDecomposition().solve(B * r)) <= largest;
}

/// Whether the noise explains the difference between the measurement and the nodes' poses.
bool fits_poses(const PoseGraph& graph, const Edge& edge) {
  const Vector6d r =
      se3::log(edge.T_from_to.inverse() * graph.node(edge.from).pose.inverse() * graph.node(edge.to).pose);
  return r.dot(edge.information * r) <= largest_distance(graph);
}

/// Marks odometry among the edges between two nodes. Tries them in the order of the file, but first those
/// that fit the nodes' poses, because most programs chain the poses along the odometry. An edge becomes
/// odometry if it agrees with all odometry edges before it. Agreement with one of them is not enough: an edge
/// of low information agrees with any other.
void mark_chain(PoseGraph& graph, std::vector<std::size_t> edges, Problems& problems) {
  const auto edge = [&](std::size_t e) -> const Edge& { return graph.edges()[e]; };
  const double largest = largest_distance(graph);
  if (edges.size() > 1) {
    std::stable_partition(edges.begin(), edges.end(),
                          [&](std::size_t e) { return fits_poses(graph, edge(e)); });
  }
  std::vector<std::size_t> odometry;
  for (const std::size_t e : edges) {
    const auto contradicted = std::find_if(odometry.begin(), odometry.end(),
                                           [&](std::size_t o) { return !agree(edge(o), edge(e), largest); });
    if (contradicted == odometry.end()) {
      odometry.push_back(e);
      graph.set_kind(e, EdgeKind::kOdometry);
      continue;
    }
    const Vector6d r = difference(edge(*contradicted), edge(e));
    problems.add("edge that contradicts the odometry, treated as a loop closure",
                 "between " + pair_name(edge(e).from, edge(e).to) + ", " +
                     std::to_string(r.head<3>().norm()) + " m and " + std::to_string(r.tail<3>().norm()) +
                     " rad from the odometry");
  }
}

/// Reports consecutive nodes of a robot that odometry does not connect, not even over other nodes.
void check_chains(const PoseGraph& graph, const Robots& robots, Problems& problems) {
  DisjointSets chained(graph.nodes().size());
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    if (graph.edges()[e].kind == EdgeKind::kOdometry) chained.join(graph.ends(e).from, graph.ends(e).to);
  }
  const std::vector<std::vector<Key>> paths = robot_paths(graph, robots);
  for (std::size_t robot = 0; robot < paths.size(); ++robot) {
    for (std::size_t i = 1; i < paths[robot].size(); ++i) {
      const Key a = paths[robot][i - 1], b = paths[robot][i];
      if (!chained.join(graph.index_of(a), graph.index_of(b)))
        continue;  // join() closes the gap, so that each is counted once
      const std::string where = "robot " + robots[robot].name + ", between nodes " + pair_name(a, b);
      if (b - a >= kLabelStep) {
        problems.add("robot whose keys have a jump of 2^47 or more",
                     where + ": if these are two robots, list their keys with the option robots");
      } else {
        problems.add("odometry chain broken", where);
      }
    }
  }
}

/// `joins(a, b)`: whether edges between these nodes are odometry, provided that they agree with each
/// other.
template <class Joins>
Problems classify(PoseGraph& graph, const Robots& robots, Joins&& joins) {
  std::map<std::pair<Key, Key>, std::vector<std::size_t>> chains;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    const bool sighting = robots.is_landmark(edge.from) || robots.is_landmark(edge.to);
    graph.set_kind(e, sighting ? EdgeKind::kLandmark : EdgeKind::kLoopClosure);
    if (!sighting && joins(edge.from, edge.to)) chains[ends_of(edge)].push_back(e);
  }
  Problems problems;
  for (const auto& [ends, edges] : chains) mark_chain(graph, edges, problems);
  check_chains(graph, robots, problems);
  return problems;
}

}  // namespace

std::vector<std::vector<Key>> robot_paths(const PoseGraph& graph, const Robots& robots) {
  std::vector<std::vector<Key>> paths(robots.size());
  for (const Node& node : graph.nodes()) {
    const auto robot = robots.find(node.key);
    if (robot && !robots[*robot].landmarks) paths[*robot].push_back(node.key);
  }
  for (auto& path : paths) std::sort(path.begin(), path.end());
  return paths;
}

Neighbours::Neighbours(const PoseGraph& graph, const Robots& robots) {
  for (const std::vector<Key>& path : robot_paths(graph, robots)) {
    for (std::size_t i = 1; i < path.size(); ++i) {
      if (path[i] - path[i - 1] < kLabelStep) next_.emplace(path[i - 1], path[i]);
    }
  }
}

bool Neighbours::operator()(Key a, Key b) const {
  const auto next = next_.find(std::min(a, b));
  return next != next_.end() && next->second == std::max(a, b);
}

Edge reversed(const Edge& edge) {
  Edge out = edge;
  std::swap(out.from, out.to);
  out.T_from_to = edge.T_from_to.inverse();
  // The error sits on the right of the other end: Ω' = Ad(T⁻¹)ᵀ Ω Ad(T⁻¹).
  const Matrix6d ad = se3::adjoint(out.T_from_to);
  const Matrix6d moved = ad.transpose() * edge.information * ad;
  out.information = 0.5 * (moved + moved.transpose());
  return out;
}

Problems classify_edges(PoseGraph& graph, const Robots& robots) {
  return classify(graph, robots, Neighbours(graph, robots));
}

Problems classify_edges(PoseGraph& graph, const Robots& robots, const KeyPairs& odometry) {
  KeyPairs missing;
  for (const auto& [a, b] : odometry) missing.insert(std::minmax(a, b));
  const KeyPairs listed = missing;
  for (const Edge& edge : graph.edges()) missing.erase(ends_of(edge));
  for (const auto& [a, b] : listed) {
    for (const Key key : {a, b}) {
      if (robots.is_landmark(key))
        throw InputError("no odometry between " + pair_name(a, b) + ": " + key_name(key) + " is a landmark");
    }
  }
  if (!missing.empty()) {
    throw InputError("the graph has no edge between " +
                     pair_name(missing.begin()->first, missing.begin()->second));
  }
  return classify(graph, robots, [&](Key a, Key b) { return listed.count(std::minmax(a, b)) != 0; });
}

}  // namespace loopwise
