// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/task.hpp>

#include <array>
#include <optional>
#include <vector>

#include <loopwise/core/random.hpp>

namespace loopwise {
namespace {

/// A step along the odometry away from a node.
struct Step {
  std::size_t node;
  Eigen::Isometry3d T_here_there;
};

/// The odometry neighbour of `node` with the next higher (or lower) key within its robot, if there is one.
std::optional<Step> odometry_step(const PoseGraph& graph, const Robots& robots, std::size_t node,
                                  bool forward) {
  const Key here = graph.nodes()[node].key;
  const std::optional<std::size_t> robot = robots.find(here);
  std::optional<Step> best;
  for (const std::size_t number : graph.edges_of(node)) {
    const Edge& edge = graph.edges()[number];
    if (edge.kind != EdgeKind::kOdometry) continue;
    const PoseGraph::Ends ends = graph.ends(number);
    const bool outgoing = ends.from == node;
    const std::size_t other = outgoing ? ends.to : ends.from;
    const Key there = graph.nodes()[other].key;
    if ((there > here) != forward || robots.find(there) != robot) continue;
    if (best) {
      const Key known = graph.nodes()[best->node].key;
      if (forward ? known <= there : known >= there) continue;
    }
    best = Step{other, outgoing ? edge.T_from_to : edge.T_from_to.inverse()};
  }
  return best;
}

/// Nearest to the centre first: 0, −1, +1, −2, +2, …
std::vector<SubmapMember> submap(const PoseGraph& graph, const Robots& robots, Key centre, Key other_end,
                                 int neighbours, const std::function<bool(Key)>& has_scan) {
  std::vector<SubmapMember> members{{centre, Eigen::Isometry3d::Identity()}};
  struct Walk {
    bool forward;
    std::optional<Step> at;  // pose in the centre's frame
  };
  const Step start{graph.index_of(centre), Eigen::Isometry3d::Identity()};
  std::array<Walk, 2> walks{Walk{false, start}, Walk{true, start}};
  for (int i = 0; i < neighbours; ++i) {
    for (Walk& walk : walks) {
      if (!walk.at) continue;
      const Eigen::Isometry3d T_center_here = walk.at->T_here_there;
      walk.at = odometry_step(graph, robots, walk.at->node, walk.forward);
      if (!walk.at) continue;
      walk.at->T_here_there = T_center_here * walk.at->T_here_there;
      const Key key = graph.nodes()[walk.at->node].key;
      if (key != other_end && (!has_scan || has_scan(key))) members.push_back({key, walk.at->T_here_there});
    }
  }
  return members;
}

}  // namespace

RegistrationTask make_task(const PoseGraph& graph, const Robots& robots, const LoopCandidate& candidate,
                           const TaskOptions& options, std::uint64_t seed,
                           const std::function<bool(Key)>& has_scan) {
  RegistrationTask task;
  task.candidate = candidate;
  task.source = submap(graph, robots, candidate.from, candidate.to, options.source_neighbours, has_scan);
  task.target = submap(graph, robots, candidate.to, candidate.from, options.target_neighbours, has_scan);
  if (options.use_guess) {
    task.guess_from_to = graph.node(candidate.from).pose.inverse() * graph.node(candidate.to).pose;
  }
  task.enough_points = static_cast<std::size_t>(options.enough_points);
  task.seed = pair_seed(seed, candidate.from, candidate.to);
  task.time_limit_s = options.time_limit_s;
  return task;
}

ContentHash hash_of(const RegistrationTask& task) {
  ContentHasher hasher;
  const auto add_pose = [&hasher](const Eigen::Isometry3d& T) {
    for (Eigen::Index i = 0; i < 3; ++i) {
      for (Eigen::Index j = 0; j < 4; ++j) hasher.number(T(i, j));
    }
  };
  hasher.integer(task.candidate.from).integer(task.candidate.to);
  hasher.integer(task.seed).integer(task.enough_points);
  hasher.integer(task.guess_from_to ? 1 : 0);
  if (task.guess_from_to) add_pose(*task.guess_from_to);
  for (const std::vector<SubmapMember>* members : {&task.source, &task.target}) {
    hasher.integer(members->size());
    for (const SubmapMember& member : *members) {
      hasher.integer(member.key);
      add_pose(member.T_center_member);
    }
  }
  return hasher.finish();
}

}  // namespace loopwise
