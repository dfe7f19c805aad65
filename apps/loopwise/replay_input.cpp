// SPDX-License-Identifier: BSD-3-Clause
#include "replay_input.hpp"

#include <algorithm>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/output_folder.hpp>

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

void warn_about(const Team& team, const ReplayCommand& options, const Config& config, Console& console) {
  const Mission& mission = team.mission;
  const ReplayOptions& replay = config.replay;
  Problems problems;
  for (const Problem& problem : mission.problems.all()) {
    const bool settled = replay.odometry_noise_m_per_m + replay.odometry_noise_rad_per_m > 0.0 &&
                         problem.kind == "odometry taken from the optimised poses";
    if (!settled) problems.add(problem.kind, problem.example, problem.count);
  }
  console.warn(problems);
  if (options.missions.size() > 1 && mission.robots.size() > 1 && !team.frames &&
      config.mission.frames.empty()) {
    console.note(
        "frames: the poses of all sources count as poses in one frame; --frames auto finds the frames from "
        "the scans");
  }
  const auto& edges = mission.graph.edges();
  const auto recorded = static_cast<std::size_t>(std::count_if(
      edges.begin(), edges.end(), [](const Edge& edge) { return edge.kind == EdgeKind::kLoopClosure; }));
  if (recorded > 0) {
    console.note(
        counted(recorded, "closure") +
        " of the mission left out: a replay finds its own (`loopwise optimize` and `rank` use them)");
  }
  if (replay.prioritization.method == Method{PrioritizerKind::kRssi} && mission.radio.empty())
    console.warn("the mission has no radio readings: method rssi has no candidates");
  if (mission.scans->empty() && !replay.prioritization.method.empty())
    console.warn("the mission has no scans: no candidate can be computed");
}

/// The outcomes of the run so far; empty on a real clock.
std::optional<OutcomeFile> open_outcomes(const ReplayCommand& options, const Mission& mission,
                                         const Config& config, Console& console) {
  const fs::path folder = options.output;
  const fs::path file = folder / "outcomes.jsonl";
  if (options.clock == "real") {
    remove_former(file);  // it belongs to another run
    return std::nullopt;
  }
  if (options.resume && !fs::exists(file)) {
    if (fs::exists(folder / "summary.json")) {
      throw OptionError(folder.string() +
                        ": a run without outcomes.jsonl, as with --clock real, cannot be resumed; "
                        "--overwrite replaces it");
    }
    console.note("nothing to resume: a new run");
  }
  return std::make_optional<OutcomeFile>(file, run_fingerprint(mission, config), options.resume);
}

}  // namespace

Team read_team(const ReplayCommand& options, const Config& config, ThreadPool& threads, Console& console,
               const StopToken& stop) {
  const std::vector<fs::path> paths(options.missions.begin(), options.missions.end());
  Team team;
  if (options.job != nullptr) {
    team.mission = read_missions(paths, config.mission, console.progress_callback(), stop);
  } else {
    team = loopwise::read_team(paths, config, /*find=*/true, threads, console.progress_callback(), stop);
  }
  set_truth(team.mission, options.truth, config.mission);
  check_files(team.mission, config.replay);
  warn_about(team, options, config, console);
  return team;
}

ReplayFolder open_folder(const ReplayCommand& options, const Mission& mission, const Config& config,
                         Console& console) {
  if (options.resume && options.overwrite)
    throw OptionError("--resume continues the run in the folder, --overwrite starts again: give one of them");
  ReplayFolder folder{options.output, {}, {}, {}};
  refuse_recording(folder.path, options.missions);
  const bool is_new = !fs::exists(folder.path);
  prepare_output_folder(folder.path, options.overwrite || options.resume,
                        "; --resume continues it, --overwrite replaces it");
  try {
    folder.store = open_store(options.replay);
  } catch (const Error&) {
    std::error_code ignored;
    if (is_new) fs::remove(folder.path, ignored);
    throw;
  }
  folder.outcomes = open_outcomes(options, mission, config, console);
  // Only now is it certain that this run may replace the former results.
  remove_run_results(folder.path);
  folder.journal.emplace(folder.path / "journal.jsonl");
  if (!folder.outcomes) return folder;
  if (!folder.outcomes->known().empty()) {
    console.note("resuming with " + std::to_string(folder.outcomes->known().size()) +
                 " registrations already computed");
  }
  if (folder.outcomes->lost() > 0) {
    console.warn((folder.path / "outcomes.jsonl").string() +
                 ": lines with zeros in them, as after a loss of power, are computed again: " +
                 std::to_string(folder.outcomes->lost()));
  }
  return folder;
}

}  // namespace loopwise::cli
