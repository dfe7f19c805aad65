// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/task.hpp>

#include <array>
#include <vector>

#include <Eigen/Cholesky>

#include <loopwise/core/odometry_walk.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {
namespace {

/// Largest standard deviations of a step of the odometry, m and rad. A submap with larger errors would not
/// pass the tests of a closure, and odometry without information has no finite covariance.
constexpr double kLargestStepM = 0.5, kLargestStepRad = 0.1;

/// What a step of the odometry adds to the covariance of its end, in the frame where the walk began. The
/// error of an edge is on the right of its `to` end.
Matrix6d covariance_of_step(const PoseGraph& graph, const OdometryWalk::Place& before,
                            const OdometryWalk::Place& after) {
  const bool forward = graph.ends(after.edge).to == after.node;
  const Matrix6d ad = se3::adjoint(forward ? after.T_start_here : before.T_start_here);
  Matrix6d information = graph.edges()[after.edge].information;
  information.diagonal().head<3>().array() += 1.0 / (kLargestStepM * kLargestStepM);
  information.diagonal().tail<3>().array() += 1.0 / (kLargestStepRad * kLargestStepRad);
  return ad * information.ldlt().solve(Matrix6d(ad.transpose()));
}

/// A walk along the odometry from the centre of a submap, with the covariance of the way so far.
struct Way {
  OdometryWalk walk;
  OdometryWalk::Place here;
  Matrix6d covariance = Matrix6d::Zero();

  /// Moves to the next node; false at the end of the chain.
  bool step(const PoseGraph& graph) {
    const auto next = walk.next();
    if (!next) return false;
    covariance += covariance_of_step(graph, here, *next);
    here = *next;
    return true;
  }
};

/// Nearest to the centre first: 0, −1, +1, −2, +2, …
std::vector<SubmapMember> submap(const PoseGraph& graph, const Robots& robots, Key centre, Key other_end,
                                 int neighbours, const std::function<bool(Key)>& has_scan) {
  std::vector<SubmapMember> members{{centre}};
  std::array<Way, 2> ways{Way{OdometryWalk(graph, robots, centre, false), {}},
                          Way{OdometryWalk(graph, robots, centre, true), {}}};
  for (int i = 0; i < neighbours; ++i) {
    for (Way& way : ways) {
      if (!way.step(graph)) continue;
      const Key key = graph.nodes()[way.here.node].key;
      if (key != other_end && (!has_scan || has_scan(key)))
        members.push_back({key, way.here.T_start_here, way.covariance});
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
  const auto add_covariance = [&hasher](const Matrix6d& covariance) {
    // Rounded, because the covariance may come from another order of sums.
    for (Eigen::Index i = 0; i < 36; ++i) {
      hasher.number(static_cast<double>(static_cast<float>(covariance.data()[i])));
    }
  };
  hasher.integer(task.candidate.from).integer(task.candidate.to);
  hasher.integer(task.seed).integer(task.enough_points);
  hasher.integer(task.guess_from_to ? 1 : 0);
  if (task.guess_from_to) add_pose(*task.guess_from_to);
  if (task.guess_covariance) add_covariance(*task.guess_covariance);
  for (const std::vector<SubmapMember>* members : {&task.source, &task.target}) {
    hasher.integer(members->size());
    for (const SubmapMember& member : *members) {
      hasher.integer(member.key);
      add_pose(member.T_center_member);
      add_covariance(member.covariance);
    }
  }
  return hasher.finish();
}

}  // namespace loopwise
