// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/map_quality.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <set>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>
#include <loopwise/replay/registration.hpp>

#include "../core/constants.hpp"

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

/// The pose of the older node of a revisit in the frame of the newer one, by a map.
std::optional<Eigen::Isometry3d> T_from_to(const PosesByKey& poses, const ProvenRevisit& revisit) {
  const auto from = poses.find(revisit.from), to = poses.find(revisit.to);
  if (from == poses.end() || to == poses.end()) return std::nullopt;
  return from->second.inverse() * to->second;
}

/// `pose_of(revisit)` is the pose of its older node from the newer one, if known.
template <class PoseOf>
MeanThickness mean_thickness(const std::vector<std::vector<SharedPlane>>& planes,
                             const std::vector<ProvenRevisit>& revisits, PoseOf&& pose_of) {
  MeanThickness out;
  double sum = 0.0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < revisits.size(); ++i) {
    out.each_m.push_back(kNan);
    const std::optional<Eigen::Isometry3d> pose = pose_of(revisits[i]);
    if (!pose || planes[i].empty()) continue;
    double of_revisit = 0.0;
    for (const SharedPlane& plane : planes[i]) of_revisit += plane.thickness_m(*pose);
    out.each_m.back() = of_revisit / static_cast<double>(planes[i].size());
    sum += out.each_m.back();
    ++count;
  }
  if (count > 0) out.mean_m = sum / static_cast<double>(count);
  return out;
}

void compare_thickness(MapQuality& quality, const Mission& mission, const PosesByKey& before,
                       const PosesByKey& after, const std::vector<std::size_t>& groups,
                       const StopToken& stop) {
  const auto planes = shared_planes(mission, quality.revisits, stop);
  std::set<std::size_t> stretches;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    quality.planes += planes[i].size();
    if (!planes[i].empty()) stretches.insert(groups[i]);
  }
  quality.plane_stretches = stretches.size();
  const auto by = [&](auto&& pose_of) { return mean_thickness(planes, quality.revisits, pose_of); };
  quality.thickness_before = by([&](const ProvenRevisit& r) { return T_from_to(before, r); });
  quality.thickness_after = by([&](const ProvenRevisit& r) { return T_from_to(after, r); });
  quality.thickness_registered = by([](const ProvenRevisit& r) { return std::optional(r.T_from_to); });
  quality.thickness_difference =
      compare_paired(quality.thickness_after.each_m, quality.thickness_before.each_m, groups);
}

/// Results of registering pairs that the estimate alone puts near each other.
void judge_near_pairs(MapQuality& quality, const Mission& mission, const PosesByKey& after,
                      const Revisits& pairs, const std::vector<ProvenRevisit>& proven) {
  const auto between_robots = [&](Key a, Key b) { return mission.robots.of(a) != mission.robots.of(b); };
  std::vector<ProvenRevisit> proven_between;
  std::copy_if(proven.begin(), proven.end(), std::back_inserter(proven_between),
               [&](const ProvenRevisit& revisit) { return between_robots(revisit.from, revisit.to); });
  const auto pairs_between = static_cast<std::size_t>(std::count_if(
      pairs.begin(), pairs.end(), [&](const auto& pair) { return between_robots(pair.first, pair.second); }));
  quality.near = {pairs.size(), proven.size(), displacement(after, proven).median_m};
  quality.near_between_robots = {pairs_between, proven_between.size(),
                                 displacement(after, proven_between).median_m};
}

Json json_of(const Displacement& d) {
  return {{"mean", number_or_null(d.mean_m)},
          {"median", number_or_null(d.median_m)},
          {"worst_tenth", number_or_null(d.worst_tenth_m)}};
}
Json json_of(const NearPairs& near) {
  return {{"pairs", near.pairs}, {"proven", near.proven}, {"median_m", number_or_null(near.median_m)}};
}
/// Without enough independent revisits the quality is unknown.
Json interval_json(bool enough, const Interval& interval) {
  return {enough ? number_or_null(interval.low) : Json(), enough ? number_or_null(interval.high) : Json()};
}

Json to_json(const MapQuality& q) {
  const std::string reason = q.not_meaningful();
  return {{"not_meaningful", reason.empty() ? Json() : Json(reason)},
          {"pairs", q.pairs},
          {"revisits", q.revisits.size()},
          {"stretches", q.stretches},
          {"coverage", number_or_null(q.coverage)},
          {"enough_for_interval", q.enough()},
          {"displacement_m", {{"recording", json_of(q.before)}, {"estimate", json_of(q.after)}}},
          {"difference_m", number_or_null(q.difference.mean_difference)},
          {"difference_interval_95", interval_json(q.enough(), q.difference.difference)},
          {"planes", q.planes},
          {"thickness_m",
           {{"recording", number_or_null(q.thickness_before.mean_m)},
            {"estimate", number_or_null(q.thickness_after.mean_m)},
            {"registered", number_or_null(q.thickness_registered.mean_m)}}},
          {"thickness_difference_interval_95",
           interval_json(q.enough_planes(), q.thickness_difference.difference)},
          {"share_on_surfaces",
           {{"recording", number_or_null(q.share_before)},
            {"estimate", number_or_null(q.share_after)},
            {"registered", number_or_null(q.share_registered)}}},
          {"near_by_estimate", json_of(q.near)},
          {"near_by_estimate_between_robots", json_of(q.near_between_robots)}};
}

}  // namespace

std::string MapQuality::not_meaningful() const {
  if (revisits.empty()) {
    return "of " + std::to_string(pairs) +
           " pairs of nodes that may have seen one place at different times (both with scans, 20 m of path "
           "between them) no registration proves one: the map cannot be judged without truth";
  }
  if (enough()) return "";
  return "revisits at " + std::to_string(stretches) + " pairs of stretches of path, fewer than " +
         std::to_string(kLeastStretches) +
         ": too few for a confidence interval; the figures hold for these places only";
}

SurfaceAgreementOptions map_quality_options() {
  SurfaceAgreementOptions options;
  options.drift = 0.02;
  return options;
}

std::vector<ProvenRevisit> prove_revisits(const Mission& mission, const Revisits& pairs,
                                          const ReplayOptions& options, ThreadPool& pool,
                                          const StopToken& stop, const ProgressCallback& progress,
                                          const Registrar* registrar) {
  Registration own;
  if (registrar == nullptr) {
    own = make_registration(options.registration, mission.scans->loader());
    registrar = own.registrar.get();
  }
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
  const auto results = compute_batch(*registrar, tasks, pool, stop, progress);
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
    const std::optional<Eigen::Isometry3d> pose = T_from_to(poses, revisit);
    if (!pose) continue;
    out.each_m.back() = (pose->translation() - revisit.T_from_to.translation()).norm();
    known.push_back(out.each_m.back());
    sum += known.back();
  }
  out.mean_m =
      known.empty() ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(known.size());
  out.median_m = quantile(known, 0.5);
  out.worst_tenth_m = quantile(known, 0.9);
  return out;
}

Revisits closure_pairs(const PoseGraph& graph) {
  Revisits pairs;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) pairs.emplace_back(edge.from, edge.to);
  }
  return pairs;
}

MapQuality map_quality(const Mission& mission, const PosesByKey& before, const PosesByKey& after,
                       const Revisits& used, const ReplayOptions& options, ThreadPool& pool,
                       const StopToken& stop, const ProgressCallback& progress, const Registrar* registrar) {
  const SurfaceAgreementOptions wide = map_quality_options();
  SurfaceAgreementOptions narrow;
  narrow.pairs = wide.pairs / 4;
  Registration own;
  if (registrar == nullptr) {  // one for both lists, which share scans
    own = make_registration(options.registration, mission.scans->loader());
    registrar = own.registrar.get();
  }
  MapQuality quality;
  // Those by the recording's poses are the same for every estimate. Pairs that the estimate alone puts near
  // each other and that no registration proves show it to be wrong; those that are revisits by both maps
  // would hide them.
  const Revisits by_recording = without(find_revisits(mission, before, wide), used);
  const Revisits by_estimate = without(find_new_revisits(mission, after, narrow, before, wide), used);
  quality.revisits = prove_revisits(mission, by_recording, options, pool, stop, progress, registrar);
  quality.pairs = by_recording.size();
  judge_near_pairs(quality, mission, after, by_estimate,
                   prove_revisits(mission, by_estimate, options, pool, stop, progress, registrar));

  Revisits proven;
  for (const ProvenRevisit& revisit : quality.revisits) proven.emplace_back(revisit.from, revisit.to);
  const std::vector<std::size_t> groups = revisit_groups(mission, before, proven);
  quality.stretches = std::set<std::size_t>(groups.begin(), groups.end()).size();
  quality.coverage = revisited_share(mission, before, proven);
  quality.before = displacement(before, quality.revisits);
  quality.after = displacement(after, quality.revisits);
  quality.difference = compare_paired(quality.after.each_m, quality.before.each_m, groups);
  compare_thickness(quality, mission, before, after, groups, stop);
  quality.share_before = surface_agreement(mission, before, proven, wide, stop).mean;
  quality.share_after = surface_agreement(mission, after, proven, wide, stop).mean;
  quality.share_registered = share_where_registered(mission, quality.revisits, wide, stop);
  return quality;
}

std::string map_quality_json(const MapQuality& quality) {
  return json_text(to_json(quality));
}

void keep_map_quality(const std::filesystem::path& run_folder, const MapQuality& quality) {
  const std::filesystem::path file = run_folder / "summary.json";
  Json summary = read_json_file(file);
  if (!summary.is_object()) throw InputError(file.string() + ": not an object");
  summary["map_quality"] = to_json(quality);
  write_file(file, json_text(summary, 2) + "\n");
}

}  // namespace loopwise
