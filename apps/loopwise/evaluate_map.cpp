// SPDX-License-Identifier: BSD-3-Clause
// Consistency of maps without ground truth.
#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/graph_source.hpp>
#include <loopwise/io/mission.hpp>

#include "common/console.hpp"
#include "evaluate_map.hpp"

namespace loopwise::cli {
namespace {

/// Warns if the figures are unreliable or indicate a wrong map.
void warn_of_weakness(const MapQuality& q, Console& console) {
  if (!q.revisits.empty() && !q.enough()) console.warn("not meaningful: " + q.not_meaningful());
  if (const std::string warning = map_quality_warning(q); !warning.empty()) console.warn(warning);
}

/// Warns if the run started from other odometry than that of the recording.
void warn_of_noise(const std::string& estimate, const std::string& recording, Console& console) {
  if (graph_of_run(estimate).empty()) return;
  const Json summary = read_json_file(std::filesystem::path(estimate) / "summary.json");
  for (const char* name : {"odometry_noise_m_per_m", "odometry_noise_rad_per_m"}) {
    const Json::json_pointer path(std::string("/options/replay/") + name);
    if (!summary.contains(path) || !summary.at(path).is_number() || summary.at(path) == 0.0) continue;
    console.warn("the run added noise to the odometry of " + recording +
                 ": the recording's figures are without it");
    return;
  }
}

/// Adds the quality to the summary of a run, where reports find it.
void keep(const std::string& estimate, const Mission& mission, const MapQuality& quality, Console& console) {
  if (graph_of_run(estimate).empty()) return;
  const std::filesystem::path file = std::filesystem::path(estimate) / "summary.json";
  try {
    const Json summary = read_json_file(file);
    const std::string name = summary.is_object() && summary.value("mission", Json()).is_string()
                                 ? summary["mission"].get<std::string>()
                                 : "";
    if (name != mission.name) {
      console.warn(file.string() + ": the quality is not added, because the run is of the mission \"" + name +
                   "\", not of \"" + mission.name + "\"");
      return;
    }
    keep_map_quality(estimate, quality);
    console.note("kept as map_quality in " + file.string() + ", for loopwise report");
  } catch (const Error& error) {
    console.warn(std::string("not kept for loopwise report: ") + error.what());
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
  const PosesByKey after = poses_by_key(run.graph);
  PosesByKey before;
  for (const auto& [key, pose] : poses_by_key(mission.graph)) {
    if (after.count(key) != 0) before.emplace(key, pose);
  }
  if (before.empty()) throw InputError(estimate + ": has no node of " + recording);
  ThreadPool pool(thread_count(common));
  const MapQuality quality = map_quality(mission, before, after, closure_pairs(run.graph), config.replay,
                                         pool, interrupt.token(), console.progress_callback());
  if (interrupt.interrupted()) return kInterrupted;
  console.warn(mission.scans->problems());
  print_results(common, parse_json(map_quality_json(quality), "map quality"), map_quality_text(quality));
  warn_of_weakness(quality, console);
  warn_of_noise(estimate, recording, console);
  keep(estimate, mission, quality, console);
  if (config.mission.strict) require_unaltered(mission.scans->problems());
  return kDone;
}

}  // namespace loopwise::cli
