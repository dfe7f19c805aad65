// SPDX-License-Identifier: BSD-3-Clause
#include <fstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/replay/trace.hpp>

#include "console.hpp"
#include "replay_command.hpp"
#include "run_text.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

/// Reads the first line of a trace.
TraceHeader trace_header(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string line;
  if (!in || !std::getline(in, line)) throw IoError(file.string(), "cannot be read");
  try {
    return parse_trace_header(line);
  } catch (const Error& error) {
    throw ParseError(file.string(), 1, error.what());
  }
}

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
  const TraceHeader header = trace_header(options.trace);
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
  remove_former_results(folder);
  for (const char* name : {"journal.jsonl", "outcomes.jsonl"})
    remove_former(folder / name);  // it has neither
  ReplayHooks hooks;
  RunHistory history(mission);
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.progress = console.progress_callback();
  hooks.stop = interrupt.token();
  ReplayResult result = replay_trace(options.trace, hooks);
  const RunEvaluation evaluation = evaluate_run(mission, result);
  const StitchedMap map = stitch_map(result.graph, *mission.scans, options.map_voxel_m, hooks.stop,
                                     console.progress_callback(), header.options.features.max_range_m);
  result.problems.add(map.problems);
  add_scan_problems(result, *mission.scans);
  console.warn(result.problems);
  if (options.map_ply && !map.cloud.empty() && !interrupt.interrupted())
    write_ply(folder / "map.ply", map.cloud);
  write_run_folder(folder, mission, recorded, result, evaluation, history.rows(), map.cloud);
  print_results(
      options.common, parse_json(run_summary_json(mission, recorded, result, evaluation), "summary"),
      results_text(mission.robots, recorded, result, evaluation, /*threads=*/0, /*virtual_clock=*/false) +
          "results      " + folder.string() + "\n");
  return interrupt.interrupted() ? kInterrupted : kDone;
}

}  // namespace loopwise::cli
