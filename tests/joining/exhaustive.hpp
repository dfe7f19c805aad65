// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A reference for frames between two sources: registers all pairs of key frames instead of the proposed
/// ones.
#pragma once

#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/Dense>

#include <loopwise/core/error.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/optimization/pcm.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>
#include <loopwise/replay/read_team.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise::testing {

/// The frame of the second of two components by exhaustive registration.
struct ExhaustiveFrame {
  std::size_t pairs = 0;     ///< Of key frames of the two components.
  std::size_t computed = 0;  ///< Of these, registered without a guess.
  std::size_t verified = 0;  ///< By the registration alone.
  std::size_t compared = 0;  ///< Of these, compared with each other.
  std::size_t agreeing = 0;  ///< The largest set in which every two agree.
  double scatter_m = 0.0;    ///< Root mean square distance of their ends from one rigid motion.
  Eigen::Isometry3d T_a_b = Eigen::Isometry3d::Identity();  ///< The rigid motion that fits the ends best.
};

/// Closures from every `stride`-th pair of key frames, registered without a guess in the submaps of joining.
inline std::vector<LoopClosure> closures_of_pairs(const Mission& mission,
                                                  const std::vector<JoinComponent>& components,
                                                  const Config& config, std::size_t stride,
                                                  ThreadPool& threads, const ProgressCallback& progress,
                                                  ExhaustiveFrame& counts) {
  const Registration registration = make_registration(config.replay.registration, mission.scans->loader());
  TaskOptions options;
  options.use_guess = false;
  options.source_neighbours = options.target_neighbours = static_cast<int>(config.joining.neighbours);
  std::vector<std::pair<Key, Key>> pairs;
  const std::vector<Key>&of_a = components[0].keys, &of_b = components[1].keys;
  for (std::size_t i = 0; i < of_a.size(); ++i) {
    for (std::size_t j = 0; j < of_b.size(); ++j) {
      if ((i + j) % stride == 0) pairs.emplace_back(of_b[j], of_a[i]);
    }
  }
  counts.pairs = of_a.size() * of_b.size();
  std::vector<LoopClosure> closures;
  constexpr std::size_t kBatch = 512;
  for (std::size_t begin = 0; begin < pairs.size(); begin += kBatch) {
    std::vector<RegistrationTask> tasks;
    for (std::size_t i = begin; i < std::min(pairs.size(), begin + kBatch); ++i) {
      LoopCandidate candidate;
      candidate.from = pairs[i].first;
      candidate.to = pairs[i].second;
      candidate.source = CandidateSource::kUser;
      tasks.push_back(make_task(mission.graph, mission.robots, candidate, options, /*seed=*/1,
                                [&](Key key) { return mission.scans->has(key); }));
    }
    for (const auto& result : compute_batch(*registration.registrar, tasks, threads)) {
      if (result && result->verified()) closures.push_back(*result->closure);
    }
    if (progress) {
      progress({"registering all pairs", begin + tasks.size(), pairs.size(),
                std::to_string(closures.size()) + " verified"});
    }
  }
  counts.computed = pairs.size();
  counts.verified = closures.size();
  return closures;
}

/// The two paths, with odometry as uncertain as joining takes it to be.
inline PoseGraph paths_with_drift(const Mission& mission, const JoinOptions& options) {
  constexpr double kPath_m = 50.0;  // of JoinOptions::drift_m
  PoseGraph graph;
  for (const Node& node : mission.graph.nodes()) graph.add_node(node);
  for (Edge edge : mission.graph.edges()) {
    if (edge.kind != EdgeKind::kOdometry) continue;
    const double share = edge.T_from_to.translation().norm() / kPath_m;
    Matrix6d covariance = options.odometry_margin * options.odometry_margin * edge.information.inverse();
    covariance.diagonal().head<3>().array() += options.drift_m * options.drift_m * share;
    covariance.diagonal().tail<3>().array() += options.drift_rad * options.drift_rad * share;
    edge.information = covariance.inverse();
    edge.information = 0.5 * (edge.information + edge.information.transpose()).eval();
    graph.add_edge(edge);
  }
  return graph;
}

/// The mean rotation, and the translation between the mean positions, that move the poses of b to where
/// closures with poses of a put them.
inline void fit_frame(const PoseGraph& graph, const std::vector<LoopClosure>& closures,
                      ExhaustiveFrame& frame) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  Eigen::Vector3d mean_own = Eigen::Vector3d::Zero(), mean_put = mean_own;
  std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>> ends;
  for (const LoopClosure& closure : closures) {
    const Eigen::Isometry3d& own = graph.node(closure.from).pose;
    const Eigen::Isometry3d put = graph.node(closure.to).pose * closure.T_from_to.inverse();
    const Eigen::Quaterniond turn(Eigen::Matrix3d(put.linear() * own.linear().transpose()));
    sum += turn.coeffs() * turn.coeffs().transpose();
    ends.emplace_back(own.translation(), put.translation());
    mean_own += own.translation();
    mean_put += put.translation();
  }
  const auto count = static_cast<double>(ends.size());
  Eigen::Quaterniond mean;
  mean.coeffs() = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(sum).eigenvectors().col(3);
  frame.T_a_b.linear() = mean.normalized().toRotationMatrix();
  frame.T_a_b.translation() = mean_put / count - frame.T_a_b.linear() * (mean_own / count);
  double squares = 0.0;
  for (const auto& [own, put] : ends) squares += (frame.T_a_b * own - put).squaredNorm();
  frame.scatter_m = std::sqrt(squares / count);
}

/// Registers every `stride`-th pair of key frames of the two components of a mission without a guess, takes
/// the largest set of closures in which every two agree over both odometries (pairwise_consistent()), and
/// fits one rigid motion to their ends. It shares the registration with find_frames(), but neither the choice
/// of pairs nor the search of closures that agree. \throws InputError if no two closures agree \param
/// most_compared of more verified closures, evenly chosen ones are compared: memory and time are quadratic
inline ExhaustiveFrame exhaustive_frame(const Mission& mission, const Config& config, std::size_t stride,
                                        std::size_t most_compared, ThreadPool& threads,
                                        const ProgressCallback& progress) {
  const std::vector<JoinComponent> components = frames_to_find(mission);
  if (components.size() != 2) throw InputError("an exhaustive reference needs two sources");
  ExhaustiveFrame frame;
  const std::vector<LoopClosure> closures =
      closures_of_pairs(mission, components, config, stride, threads, progress, frame);
  PoseGraph graph = paths_with_drift(mission, config.joining);
  const std::size_t odometry_edges = graph.edges().size();
  frame.compared = std::min(closures.size(), most_compared);
  std::vector<LoopClosure> compared;
  for (std::size_t i = 0; i < frame.compared; ++i) {
    compared.push_back(closures[i * closures.size() / frame.compared]);
    graph.add_closure(compared.back());
  }
  if (progress) progress({"comparing closures", 0, frame.compared, ""});
  PcmOptions pcm;
  pcm.inlier_probability = config.joining.inlier_probability;
  pcm.max_group = std::max<std::size_t>(2, frame.compared);
  const PcmResult agreed = pairwise_consistent(graph, pcm);
  std::vector<LoopClosure> kept;
  for (std::size_t i = 0; i < compared.size(); ++i) {
    if (agreed.kept[odometry_edges + i]) kept.push_back(compared[i]);
  }
  frame.agreeing = kept.size();
  if (kept.size() < 2) throw InputError("no two closures of all pairs agree");
  fit_frame(mission.graph, kept, frame);
  return frame;
}

}  // namespace loopwise::testing
