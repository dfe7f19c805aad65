// SPDX-License-Identifier: BSD-3-Clause
// Consistency of maps without ground truth.
#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/io/mission.hpp>

#include "evaluate_map.hpp"

namespace loopwise::cli {
namespace {

PosesByKey poses_of(const Mission& mission) {
  PosesByKey poses;
  for (const Node& node : mission.graph.nodes()) poses[node.key] = node.pose;
  return poses;
}

Revisits closures_of(const Mission& run) {
  Revisits closures;
  for (const Edge& edge : run.graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) closures.emplace_back(edge.from, edge.to);
  }
  return closures;
}

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json();
}

/// Formats a number; a rounded zero has no sign.
std::string signed_text(double value, int digits) {
  const std::string text = fixed(value, digits);
  const bool is_zero = text.find_first_not_of("-0.") == std::string::npos;
  return is_zero ? fixed(0.0, digits) : text;
}

Json json_of(const Displacement& d) {
  return {
      {"mean", number(d.mean_m)}, {"median", number(d.median_m)}, {"worst_tenth", number(d.worst_tenth_m)}};
}
Json json_of(const NearPairs& near) {
  return {{"pairs", near.pairs}, {"proven", near.proven}, {"median_m", number(near.median_m)}};
}

Json json_of(const MapQuality& q) {
  const bool enough = q.enough();
  return {{"pairs", q.pairs},
          {"revisits", q.revisits.size()},
          {"stretches", q.stretches},
          {"enough_for_interval", enough},
          {"displacement_m", {{"recording", json_of(q.before)}, {"estimate", json_of(q.after)}}},
          {"difference_m", number(q.difference.mean_difference)},
          {"difference_interval_95",
           {enough ? number(q.difference.difference.low) : Json(),
            enough ? number(q.difference.difference.high) : Json()}},
          {"share_on_surfaces",
           {{"recording", number(q.share_before)},
            {"estimate", number(q.share_after)},
            {"registered", number(q.share_registered)}}},
          {"near_by_estimate", json_of(q.near)},
          {"near_by_estimate_between_robots", json_of(q.near_between_robots)}};
}

std::string line_of(const char* what, const Displacement& d) {
  return std::string(what) + fixed(d.mean_m, 3) + " m in the mean, median " + fixed(d.median_m, 3) +
         ", worst tenth above " + fixed(d.worst_tenth_m, 3) + "\n";
}

std::string text_of(const MapQuality& q) {
  std::string text = "revisits     " + std::to_string(q.revisits.size()) + " of " + std::to_string(q.pairs) +
                     " pairs of nodes, proven by registration, at " + std::to_string(q.stretches) +
                     " pairs of stretches of path\ndisplacement of the poses from the registrations:\n";
  text += line_of("  recording  ", q.before) + line_of("  estimate   ", q.after);
  text += "difference   " + signed_text(q.difference.mean_difference, 3) + " m";
  if (q.enough()) {
    text += ", 95 % interval " + signed_text(q.difference.difference.low, 3) + " to " +
            signed_text(q.difference.difference.high, 3);
  }
  text += "\non surfaces  " + fixed(100.0 * q.share_before, 1) +
          " % of points within 0.12 m of the other scan by the recording's poses, " +
          fixed(100.0 * q.share_after, 1) + " % by the estimate's; " + fixed(100.0 * q.share_registered, 1) +
          " % by the registrations, an upper bound\n";
  const auto near = [](const NearPairs& n) {
    return std::to_string(n.proven) + " of " + std::to_string(n.pairs) +
           (n.proven > 0 ? ", " + fixed(n.median_m, 3) + " m off in the median" : "");
  };
  text += "near         pairs that the estimate puts within 3 m and that are proven: " + near(q.near);
  if (q.near_between_robots.pairs > 0) text += "; of two robots " + near(q.near_between_robots);
  return text + "\n";
}

/// Warns if the figures are unreliable or indicate a wrong map.
void warn_of_weakness(const MapQuality& q, Console& console) {
  if (!q.enough()) {
    console.warn("revisits at " + std::to_string(q.stretches) + " pairs of stretches of path, fewer than " +
                 std::to_string(kLeastStretches) +
                 ": too few for a confidence interval; the figures hold for these places only");
  }
  // In a correct map most pairs are proven, with a median distance of centimetres.
  constexpr std::size_t kSome = 10;
  constexpr double kFewProven = 0.2, kFar_m = 1.0;
  const auto is_wrong = [](const NearPairs& near) {
    const bool few = static_cast<double>(near.proven) < kFewProven * static_cast<double>(near.pairs);
    return near.pairs >= kSome && (few || near.median_m > kFar_m);
  };
  if (is_wrong(q.near_between_robots)) {
    console.warn(
        "registrations contradict the estimate at places that several robots visit: the frames of the robots "
        "may be wrong");
  } else if (is_wrong(q.near)) {
    console.warn(
        "registrations contradict the estimate at places that are visited twice: its poses may be wrong");
  }
}

}  // namespace

int evaluate_map(const CommonOptions& common, const std::string& estimate, const std::string& recording,
                 const std::string& robots) {
  Console console(common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(common);
  if (!robots.empty()) config.mission.robots = robots;
  const Mission mission =
      read_mission(recording, config.mission, console.progress_callback(), interrupt.token());
  const Mission run = read_mission(estimate, config.mission, console.progress_callback(), interrupt.token());
  console.warn(mission.problems);
  // Both maps are judged at the same revisits, i.e. those between common nodes.
  const PosesByKey after = poses_of(run);
  PosesByKey before;
  for (const auto& [key, pose] : poses_of(mission)) {
    if (after.count(key) != 0) before.emplace(key, pose);
  }
  if (before.empty()) throw InputError(estimate + ": has no node of " + recording);
  ThreadPool pool(thread_count(common));
  const MapQuality quality = map_quality(mission, before, after, closures_of(run), config.replay, pool,
                                         interrupt.token(), console.progress_callback());
  if (interrupt.interrupted()) return kInterrupted;
  console.warn(mission.scans->problems());
  if (quality.revisits.empty()) {
    throw InputError(
        recording + ": of " + std::to_string(quality.pairs) +
        " pairs of nodes that may have seen one place at different times (both with scans, 20 m of "
        "path between them), registration proves no pair: the map cannot be judged without truth");
  }
  print_results(common, json_of(quality), text_of(quality));
  warn_of_weakness(quality, console);
  return kDone;
}

}  // namespace loopwise::cli
