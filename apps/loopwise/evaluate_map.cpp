// SPDX-License-Identifier: BSD-3-Clause
// How well maps agree with themselves, where no truth is known.
#include <cmath>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/evaluation/surface_agreement.hpp>
#include <loopwise/io/mission.hpp>

#include "evaluate_map.hpp"

namespace loopwise::cli {
namespace {

PosesByKey poses_of(const Mission& mission) {
  PosesByKey poses;
  for (const Node& node : mission.graph.nodes()) poses[node.key] = node.pose;
  return poses;
}

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json();
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
  // Both maps are judged at the same revisits: those of nodes that both have.
  const PosesByKey after = poses_of(run);
  PosesByKey before;
  for (const auto& [key, pose] : poses_of(mission)) {
    if (after.count(key) != 0) before.emplace(key, pose);
  }
  if (before.empty()) throw InputError(estimate + ": has no node of " + recording);
  const Revisits revisits = find_revisits(mission, before);
  if (revisits.empty()) {
    throw InputError(recording + ": no revisits by its own poses (nodes with scans that " + estimate +
                     " has too, within 3 m, 20 m of path apart): the map cannot be judged without truth");
  }
  const SurfaceAgreement own = surface_agreement(mission, before, revisits, {}, interrupt.token());
  const SurfaceAgreement its = surface_agreement(mission, after, revisits, {}, interrupt.token());
  if (interrupt.interrupted()) return kInterrupted;
  console.warn(mission.scans->problems());
  const std::vector<std::size_t> groups = revisit_groups(mission, before, revisits);
  const PairedComparison c = compare_paired(its.shares, own.shares, groups);
  if (c.count == 0)
    throw InputError(recording + ": no revisit of which both scans can be read and have points");
  const std::size_t stretches = std::set<std::size_t>(groups.begin(), groups.end()).size();
  const Json json = {{"revisits", revisits.size()},
                     {"compared", c.count},
                     {"stretches", stretches},
                     {"share_on_surfaces", {{"recording", number(own.mean)}, {"estimate", number(its.mean)}}},
                     {"difference", number(c.mean_difference)},
                     {"difference_interval_95", {number(c.difference.low), number(c.difference.high)}}};
  const std::string interval = std::isnan(c.difference.low)
                                   ? ""
                                   : ", 95 % interval " + fixed(100.0 * c.difference.low, 1) + " to " +
                                         fixed(100.0 * c.difference.high, 1);
  const std::string text =
      "revisits     " + std::to_string(revisits.size()) + " by the recording's poses, at " +
      std::to_string(stretches) + " pairs of stretches of path, " + std::to_string(c.count) +
      " compared\non surfaces  " + fixed(100.0 * own.mean, 1) +
      " % of points within 0.12 m of the other scan by the recording's poses, " + fixed(100.0 * its.mean, 1) +
      " % by the estimate's (difference " + fixed(100.0 * c.mean_difference, 1) + interval + ")\n";
  print_results(common, json, text);
  return kDone;
}

}  // namespace loopwise::cli
