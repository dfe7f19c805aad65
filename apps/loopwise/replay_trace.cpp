// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_text.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/replay/trace.hpp>

#include "replay_command.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

/// The mission of a trace alone: nodes without scans and ground truth.
Mission mission_of(const TraceHeader& header, const fs::path& file) {
  Mission mission;
  mission.name = file.stem().string();
  mission.robots = header.robots;
  return mission;
}

}  // namespace

int run_trace(const ReplayCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = configured(options);
  const TraceHeader header = read_trace_header(options.trace);
  ReplayOptions recorded;
  recorded.engine = header.options.engine;
  recorded.prioritization = header.options.prioritization;
  recorded.back_end = header.options.back_end;
  Mission mission = mission_of(header, options.trace);
  if (!options.missions.empty()) {
    const std::vector<fs::path> paths(options.missions.begin(), options.missions.end());
    mission = read_missions(paths, config.mission, console.progress_callback(), interrupt.token());
    set_truth(mission, options.truth, config.mission);
    console.warn(mission.problems);
  } else if (!options.truth.empty()) {
    throw OptionError("--truth needs the MISSION whose nodes it is of");
  }
  const fs::path folder(options.output);
  std::vector<std::string> sources = options.missions;
  sources.push_back(options.trace);
  refuse_recording(folder, sources);
  prepare_output_folder(folder, options.overwrite, "; --overwrite replaces it");
  remove_run_results(folder);
  for (const char* name : {"journal.jsonl", "outcomes.jsonl"})
    remove_former(folder / name);  // it has neither
  ReplayHooks hooks;
  RunHistory history(mission);
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.progress = console.progress_callback();
  hooks.stop = interrupt.token();
  ReplayResult result = replay_trace(options.trace, hooks);
  const RunEvaluation evaluation = evaluate_run(mission, result);
  const PointCloud map = map_of_run(mission, result, options.map_voxel_m, hooks.stop,
                                    console.progress_callback(), header.options.features.max_range_m);
  console.warn(result.problems);
  if (options.map_ply && !map.empty() && !interrupt.interrupted()) write_ply(folder / "map.ply", map);
  write_run_folder(folder, mission, recorded, result, evaluation, history.rows(), map);
  print_results(options.common,
                parse_json(run_summary_json(mission, recorded, result, evaluation), "summary"),
                run_results_text(mission.robots, recorded, result, evaluation,
                                 {/*threads=*/0, /*virtual_clock=*/false}) +
                    "results      " + folder.string() + "\n");
  if (config.mission.strict) require_unaltered(result.problems);
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace loopwise::cli
