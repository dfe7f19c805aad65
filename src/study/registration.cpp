// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/study/registration.hpp>

#include <algorithm>
#include <memory>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/optimization/odometry_covariances.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/replay/rank.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise::study {
namespace {

/// Share of the source's points with a point of the target within 0.5 m under T_to_from. Both are as in
/// the registrars: downsampled, the target with the neighbours that they would merge.
double true_overlap(FeatureCache& features, const RegistrationTask& task,
                    const Eigen::Isometry3d& T_to_from) {
  const auto source = features.get(task.candidate.from);
  std::vector<Eigen::Vector3f> target;
  for (const SubmapMember& member : task.target) {
    if (task.enough_points > 0 && target.size() >= task.enough_points) break;
    const auto scan = features.get(member.key);
    if (!scan) continue;
    const Eigen::Isometry3f T = member.T_center_member.cast<float>();
    for (const Eigen::Vector3f& p : scan->cloud.points) target.push_back(T * p);
  }
  if (!source || source->cloud.empty() || target.empty()) return 0.0;
  const KdTree tree(target);
  const Eigen::Isometry3f T = T_to_from.cast<float>();
  std::size_t near = 0;
  for (const Eigen::Vector3f& p : source->cloud.points) {
    if (tree.nearest(T * p, 0.5F)) ++near;
  }
  return static_cast<double>(near) / static_cast<double>(source->cloud.size());
}

/// Pairs with the input of the registrars.
struct Sample {
  std::vector<StudyPair> pairs;
  std::vector<RegistrationTask> tasks;
  std::vector<Eigen::Isometry3d> truths;
};

std::vector<LoopCandidate> draw(const Mission& mission, std::vector<LoopCandidate> candidates,
                                const RegistrationStudyOptions& options) {
  const auto known = [&](Key key) { return mission.ground_truth.count(key) > 0 && mission.scans->has(key); };
  candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                  [&](const LoopCandidate& c) { return !known(c.from) || !known(c.to); }),
                   candidates.end());
  Rng(options.seed).shuffle(candidates);
  if (options.count > 0 && candidates.size() > options.count) candidates.resize(options.count);
  return candidates;
}

Sample measure(const Mission& mission, const std::vector<LoopCandidate>& candidates,
               const ReplayOptions& replay, const RegistrationStudyOptions& options, ThreadPool& threads) {
  FeatureCache features(mission.scans->loader(), replay.registration.features);
  Sample out;
  out.pairs.resize(candidates.size());
  out.tasks.resize(candidates.size());
  out.truths.resize(candidates.size());
  OdometryCovariances covariances;
  covariances.update(mission.graph);
  threads.for_each(candidates.size(), [&](std::size_t i) {
    const LoopCandidate& c = candidates[i];
    const Eigen::Isometry3d truth = mission.ground_truth.at(c.from).inverse() * mission.ground_truth.at(c.to);
    out.tasks[i] = make_task(mission.graph, mission.robots, c, replay.engine.task, options.seed,
                             [&](Key key) { return mission.scans->has(key); });
    if (options.true_guess) out.tasks[i].guess_from_to = truth;
    if (out.tasks[i].guess_from_to) {
      out.tasks[i].guess_covariance =
          covariances.between(mission.graph.index_of(c.from), mission.graph.index_of(c.to));
    }
    StudyPair& pair = out.pairs[i];
    pair.candidate = c;
    pair.distance_m = truth.translation().norm();
    pair.overlap = true_overlap(features, out.tasks[i], truth.inverse());
    const auto from = features.get(c.from), to = features.get(c.to);
    pair.observability =
        std::min(from->observability.min_eigenvalue_lamp, to->observability.min_eigenvalue_lamp);
    out.truths[i] = truth;
  });
  return out;
}

}  // namespace

std::optional<RegistrationStudy> study_registration(const Mission& mission, const ReplayOptions& replay,
                                                    const RegistrationStudyOptions& options,
                                                    const StopToken& stop, const ProgressCallback& progress) {
  RegistrationStudy study;
  const std::vector<LoopCandidate> candidates = all_candidates(mission, replay);
  study.generated = candidates.size();
  ThreadPool threads(resolve_threads(options.threads));
  Sample sample = measure(mission, draw(mission, candidates, options), replay, options, threads);
  study.pairs = std::move(sample.pairs);
  for (const RegistrarKind kind : options.registrars) {
    RegistrationOptions of_kind = replay.registration;
    of_kind.registrar = kind;
    const auto registrar = make_registration(of_kind, mission.scans->loader()).registrar;
    std::vector<RegistrationTask> own = sample.tasks;
    if (kind == RegistrarKind::kPcl && options.pcl_count > 0 && own.size() > options.pcl_count) {
      own.resize(options.pcl_count);
    }
    RegistrarOutcomes out;
    out.registrar = kind;
    const Stopwatch watch;
    const auto results = compute_batch(*registrar, own, threads, stop, progress);
    out.seconds = watch.seconds();
    if (stop.stop_requested()) return std::nullopt;
    for (std::size_t i = 0; i < own.size(); ++i) {
      out.outcomes.push_back(judge(*results[i], sample.truths[i]));
      if (!out.outcomes.back().accepted) ++out.rejected[enum_name(out.outcomes.back().reason)];
    }
    study.registrars.push_back(std::move(out));
  }
  return study;
}

}  // namespace loopwise::study
