// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/task.hpp>

#include <array>
#include <vector>

#include <loopwise/core/odometry_walk.hpp>
#include <loopwise/core/random.hpp>

namespace loopwise {
namespace {

/// Nearest to the centre first: 0, −1, +1, −2, +2, …
std::vector<SubmapMember> submap(const PoseGraph& graph, const Robots& robots, Key centre, Key other_end,
                                 int neighbours, const std::function<bool(Key)>& has_scan) {
  std::vector<SubmapMember> members{{centre, Eigen::Isometry3d::Identity()}};
  std::array<OdometryWalk, 2> walks{OdometryWalk(graph, robots, centre, false),
                                    OdometryWalk(graph, robots, centre, true)};
  for (int i = 0; i < neighbours; ++i) {
    for (OdometryWalk& walk : walks) {
      const auto place = walk.next();
      if (!place) continue;
      const Key key = graph.nodes()[place->node].key;
      if (key != other_end && (!has_scan || has_scan(key))) members.push_back({key, place->T_start_here});
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
  if (task.guess_covariance) {
    // Rounded, because the covariance may come from another order of sums.
    for (Eigen::Index i = 0; i < 36; ++i) {
      hasher.number(static_cast<double>(static_cast<float>(task.guess_covariance->data()[i])));
    }
  }
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
