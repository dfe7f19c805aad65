// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/map_quality.hpp>

#include <algorithm>
#include <iterator>
#include <limits>
#include <set>
#include <utility>

#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise {
namespace {

std::pair<Key, Key> unordered(Key a, Key b) {
  return std::minmax(a, b);
}

/// The pairs without those of `used`, each once.
Revisits without(const Revisits& pairs, const Revisits& used) {
  std::set<std::pair<Key, Key>> left_out;
  for (const auto& [from, to] : used) left_out.insert(unordered(from, to));
  Revisits out;
  for (const auto& [from, to] : pairs) {
    if (left_out.insert(unordered(from, to)).second) out.emplace_back(from, to);
  }
  return out;
}

/// Mean share of points on the other scan's surfaces where the registrations put them.
double share_where_registered(const Mission& mission, const std::vector<ProvenRevisit>& revisits,
                              const SurfaceAgreementOptions& options, const StopToken& stop) {
  double sum = 0.0;
  std::size_t count = 0;
  for (const ProvenRevisit& revisit : revisits) {
    const PosesByKey poses = {{revisit.from, Eigen::Isometry3d::Identity()}, {revisit.to, revisit.T_from_to}};
    const SurfaceAgreement one =
        surface_agreement(mission, poses, {{revisit.from, revisit.to}}, options, stop);
    if (one.revisits == 0) continue;
    sum += one.mean;
    ++count;
  }
  return count == 0 ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(count);
}

}  // namespace

SurfaceAgreementOptions map_quality_options() {
  SurfaceAgreementOptions options;
  options.drift = 0.02;
  return options;
}

std::vector<ProvenRevisit> prove_revisits(const Mission& mission, const Revisits& pairs,
                                          const ReplayOptions& options, ThreadPool& pool,
                                          const StopToken& stop, const ProgressCallback& progress) {
  const Registration registration = make_registration(options.registration, mission.scans->loader());
  TaskOptions of_tasks = options.engine.task;
  of_tasks.use_guess = false;
  const auto has_scan = [&](Key key) { return mission.scans->has(key); };
  std::vector<RegistrationTask> tasks;
  for (const auto& [from, to] : pairs) {
    LoopCandidate candidate;
    candidate.from = from;
    candidate.to = to;
    tasks.push_back(
        make_task(mission.graph, mission.robots, candidate, of_tasks, options.engine.seed, has_scan));
  }
  std::vector<ProvenRevisit> proven;
  const auto results = compute_batch(*registration.registrar, tasks, pool, stop, progress);
  for (std::size_t i = 0; i < results.size(); ++i) {
    if (!results[i] || !results[i]->verified()) continue;
    proven.push_back({pairs[i].first, pairs[i].second, results[i]->closure->T_from_to});
  }
  return proven;
}

Displacement displacement(const PosesByKey& poses, const std::vector<ProvenRevisit>& revisits) {
  Displacement out;
  std::vector<double> known;
  double sum = 0.0;
  for (const ProvenRevisit& revisit : revisits) {
    out.each_m.push_back(std::numeric_limits<double>::quiet_NaN());
    const auto from = poses.find(revisit.from), to = poses.find(revisit.to);
    if (from == poses.end() || to == poses.end()) continue;
    const Eigen::Vector3d t = from->second.inverse() * to->second.translation();
    out.each_m.back() = (t - revisit.T_from_to.translation()).norm();
    known.push_back(out.each_m.back());
    sum += known.back();
  }
  out.mean_m =
      known.empty() ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(known.size());
  out.median_m = quantile(known, 0.5);
  out.worst_tenth_m = quantile(known, 0.9);
  return out;
}

MapQuality map_quality(const Mission& mission, const PosesByKey& before, const PosesByKey& after,
                       const Revisits& used, const ReplayOptions& options, ThreadPool& pool,
                       const StopToken& stop, const ProgressCallback& progress) {
  const SurfaceAgreementOptions wide = map_quality_options();
  SurfaceAgreementOptions narrow;
  narrow.pairs = wide.pairs / 4;
  MapQuality quality;
  // Those by the recording's poses are the same for every estimate. Pairs that are near by the
  // estimate and that no registration proves show it to be wrong.
  const Revisits by_recording = without(find_revisits(mission, before, wide), used);
  const Revisits by_estimate = without(find_revisits(mission, after, narrow), used);
  quality.revisits = prove_revisits(mission, by_recording, options, pool, stop, progress);
  const std::vector<ProvenRevisit> near = prove_revisits(mission, by_estimate, options, pool, stop, progress);
  quality.pairs = by_recording.size();
  const auto between_robots = [&](Key a, Key b) { return mission.robots.of(a) != mission.robots.of(b); };
  std::size_t pairs_between = 0;
  for (const auto& [from, to] : by_estimate) pairs_between += between_robots(from, to) ? 1 : 0;
  std::vector<ProvenRevisit> near_between;
  std::copy_if(near.begin(), near.end(), std::back_inserter(near_between),
               [&](const ProvenRevisit& revisit) { return between_robots(revisit.from, revisit.to); });
  quality.near = {by_estimate.size(), near.size(), displacement(after, near).median_m};
  quality.near_between_robots = {pairs_between, near_between.size(),
                                 displacement(after, near_between).median_m};

  Revisits proven;
  for (const ProvenRevisit& revisit : quality.revisits) proven.emplace_back(revisit.from, revisit.to);
  const std::vector<std::size_t> groups = revisit_groups(mission, before, proven);
  quality.stretches = std::set<std::size_t>(groups.begin(), groups.end()).size();
  quality.before = displacement(before, quality.revisits);
  quality.after = displacement(after, quality.revisits);
  quality.difference = compare_paired(quality.after.each_m, quality.before.each_m, groups);
  quality.share_before = surface_agreement(mission, before, proven, wide, stop).mean;
  quality.share_after = surface_agreement(mission, after, proven, wide, stop).mean;
  quality.share_registered = share_where_registered(mission, quality.revisits, wide, stop);
  return quality;
}

}  // namespace loopwise
