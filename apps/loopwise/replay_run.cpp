// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <exception>
#include <fstream>
#include <functional>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/replay/live_replay.hpp>
#include <loopwise/replay/outcome_file.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/replay/trace.hpp>

#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/registration.hpp>
#endif

#include "console.hpp"
#include "replay_command.hpp"
#include "run_text.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

/// A log of lines that are on disk when add() returns.
class LineLog {
 public:
  explicit LineLog(fs::path file) : file_(std::move(file)), out_(file_, std::ios::binary | std::ios::trunc) {
    check();
  }
  void add(const std::string& line) {
    out_ << line + "\n" << std::flush;
    check();
  }
  void finish() { finish_log(out_, file_); }

 private:
  void check() const {
    if (!out_) throw IoError(file_.string(), "cannot be written");
  }
  fs::path file_;
  std::ofstream out_;
};

/// A run of `loopwise replay`, from the mission to the results.
class Run {
 public:
  explicit Run(const ReplayCommand& options)
      : options_(options),
        console_(options.common.quiet),
        config_(configured(options)),
        folder_(options.output),
        live_(options.clock == "real"),
        threads_(options.job == nullptr ? thread_count(options.common) : 1) {}

  int run() {
    read_mission();
    warn_about_mission();
    open_folder();
    RunHistory history(mission());
    ReplayResult result = compute(history);
    const RunEvaluation evaluation = evaluate_run(mission(), result);
    write(result, evaluation, history);
    print(result, evaluation);
    if (!interrupt_.interrupted()) return kDone;
    console_.note(std::string("interrupted: the results are those so far") +
                  (live_ ? "" : "; --resume continues"));
    return kInterrupted;
  }

 private:
  [[nodiscard]] Mission& mission() { return team_.mission; }

  void read_mission();
  void warn_about_mission();
  void open_folder();
  void open_outcomes();
  ReplayResult compute(RunHistory& history);
  ReplayResult replay(const Registration& registration, ReplayHooks& hooks);
  void write(ReplayResult& result, const RunEvaluation& evaluation, const RunHistory& history);
  void print(const ReplayResult& result, const RunEvaluation& evaluation);

  const ReplayCommand& options_;
  Console console_;
  const InterruptGuard interrupt_;
  const Config config_;
  const fs::path folder_;
  const bool live_;
  ThreadPool threads_;
  Team team_;
  std::optional<OutcomeFile> outcomes_;  ///< Empty on a real clock.
  std::optional<LineLog> journal_;
#ifdef LOOPWISE_HAS_MPI
  std::shared_ptr<WorkServer> server_;  ///< Null unless the process is rank 0 of a job.
#endif
};

void Run::read_mission() {
  const std::vector<fs::path> paths(options_.missions.begin(), options_.missions.end());
  if (options_.job != nullptr) {
    team_.mission = read_missions(paths, config_.mission, console_.progress_callback(), interrupt_.token());
  } else {
    team_ =
        read_team(paths, config_, /*find=*/true, threads_, console_.progress_callback(), interrupt_.token());
  }
  set_truth(mission(), options_.truth, config_.mission);
}

void Run::warn_about_mission() {
  const ReplayOptions& replay = config_.replay;
  Problems problems;
  for (const Problem& problem : mission().problems.all()) {
    const bool settled = replay.odometry_noise_m_per_m + replay.odometry_noise_rad_per_m > 0.0 &&
                         problem.kind == "odometry taken from the optimised poses";
    if (!settled) problems.add(problem.kind, problem.example, problem.count);
  }
  console_.warn(problems);
  if (options_.missions.size() > 1 && mission().robots.size() > 1 && !team_.frames &&
      config_.mission.frames.empty()) {
    console_.note(
        "frames: the poses of all sources count as poses in one frame; --frames auto finds the frames from "
        "the scans");
  }
  const auto& edges = mission().graph.edges();
  const auto recorded = static_cast<std::size_t>(std::count_if(
      edges.begin(), edges.end(), [](const Edge& edge) { return edge.kind == EdgeKind::kLoopClosure; }));
  if (recorded > 0) {
    console_.note(
        counted(recorded, "closure") +
        " of the mission left out: a replay finds its own (`loopwise optimize` and `rank` use them)");
  }
  if (replay.prioritization.method == Method{PrioritizerKind::kRssi} && mission().radio.empty())
    console_.warn("the mission has no radio readings: method rssi has no candidates");
  if (mission().scans->empty() && !replay.prioritization.method.empty())
    console_.warn("the mission has no scans: no candidate can be computed");
}

void Run::open_folder() {
  if (options_.resume && options_.overwrite)
    throw OptionError("--resume continues the run in the folder, --overwrite starts again: give one of them");
  refuse_recording(folder_, options_.missions);
  prepare_output_folder(folder_, options_.overwrite || options_.resume,
                        "; --resume continues it, --overwrite replaces it");
  open_outcomes();
  // Only now is it certain that this run may replace the former results.
  remove_former_results(folder_);
  journal_.emplace(folder_ / "journal.jsonl");
  if (!outcomes_) return;
  if (!outcomes_->known().empty()) {
    console_.note("resuming with " + std::to_string(outcomes_->known().size()) +
                  " registrations already computed");
  }
  if (outcomes_->lost() > 0) {
    console_.warn((folder_ / "outcomes.jsonl").string() +
                  ": lines with zeros in them, as after a loss of power, are computed again: " +
                  std::to_string(outcomes_->lost()));
  }
}

void Run::open_outcomes() {
  const fs::path file = folder_ / "outcomes.jsonl";
  if (live_) {
    remove_former(file);  // it belongs to another run
    return;
  }
  if (options_.resume && !fs::exists(file)) {
    if (fs::exists(folder_ / "summary.json")) {
      throw OptionError(folder_.string() +
                        ": a run without outcomes.jsonl, as with --clock real, cannot be resumed; "
                        "--overwrite replaces it");
    }
    console_.note("nothing to resume: a new run");
  }
  outcomes_.emplace(file, fingerprint(mission(), config_), options_.resume);
}

ReplayResult Run::compute(RunHistory& history) {
  const std::shared_ptr<OutcomeStore> store = open_store(options_.replay);
  const Registration registration =
      make_registration(config_.replay.registration, mission().scans->loader(), store);
  ReplayHooks hooks;
  hooks.journal = [&](const std::string& line) { journal_->add(line); };
  if (outcomes_) hooks.outcome = [&](const RegistrationResult& result) { outcomes_->add(result); };
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.progress = console_.progress_callback();
  hooks.stop = interrupt_.token();
  std::optional<LineLog> trace_log;
  std::optional<TraceWriter> trace;
  if (!options_.record_trace.empty()) {
    trace_log.emplace(options_.record_trace);
    trace.emplace(mission().robots, module_options(config_.replay),
                  [&](const std::string& line) { trace_log->add(line); });
    hooks.event = [&](const HandledEvent& handled) { trace->add(handled); };
  }
  ReplayResult result = replay(registration, hooks);
  if (store) note_outcomes(console_, store->statistics());
  return result;
}

ReplayResult Run::replay(const Registration& registration, ReplayHooks& hooks) {
  if (live_) {
    RealClock clock(0.0, options_.rate.value_or(1.0));
    return replay_live(mission(), config_.replay, registration.registrar, clock,
                       thread_count(options_.common), hooks);
  }
#ifdef LOOPWISE_HAS_MPI
  if (options_.job != nullptr) {
    WorkOptions limits;
    if (options_.replay.rank_time_limit_s) limits.time_limit_s = *options_.replay.rank_time_limit_s;
    server_ = std::make_shared<WorkServer>(*options_.job, replay_greeting(mission(), config_.replay), limits);
    hooks.compute =
        distributed_batches(server_, registration.registrar, std::max(1, options_.common.threads));
  }
#endif
  return MissionReplay(mission(), config_.replay, registration).run(threads_, hooks, outcomes_->known());
}

/// A run on the virtual clock can be repeated, so its folder is either complete or marked as incomplete. A
/// run on a real clock cannot: its results are written even if the map or the journal fails, and the error is
/// thrown afterwards.
void Run::write(ReplayResult& result, const RunEvaluation& evaluation, const RunHistory& history) {
  std::exception_ptr failure;
  const auto attempt = [&](const std::function<void()>& call) {
    try {
      call();
    } catch (const std::exception&) {
      if (!live_) throw;
      if (!failure) failure = std::current_exception();
    }
  };
  StitchedMap map;
  attempt([&] {
    map = stitch_map(result.graph, *mission().scans, options_.map_voxel_m, interrupt_.token(),
                     console_.progress_callback(), config_.replay.registration.features.max_range_m);
  });
  result.problems.add(map.problems);
  add_scan_problems(result, *mission().scans);
  console_.warn(result.problems);
  attempt([&] { journal_->finish(); });
  if (outcomes_) outcomes_->finish();
  const bool interrupted = interrupt_.interrupted();
  if (options_.map_ply && !interrupted && !map.cloud.empty())
    attempt([&] { write_ply(folder_ / "map.ply", map.cloud); });
  write_run_folder(folder_, mission(), config_.replay, result, evaluation, history.rows(),
                   interrupted ? PointCloud{} : map.cloud);
  if (failure) std::rethrow_exception(failure);
}

void Run::print(const ReplayResult& result, const RunEvaluation& evaluation) {
  Json summary = parse_json(run_summary_json(mission(), config_.replay, result, evaluation), "summary");
#ifdef LOOPWISE_HAS_MPI
  if (server_) note_ranks(console_, server_->statistics(), summary);
#endif
  if (team_.frames) summary["frames"] = frames_json(*team_.frames);
  print_results(options_.common, summary,
                (team_.frames ? frames_text(*team_.frames) : "") +
                    results_text(mission().robots, config_.replay, result, evaluation,
                                 thread_count(options_.common), !live_) +
                    "results      " + folder_.string() + "\n");
}

}  // namespace

int run_replay(const ReplayCommand& options) {
  if (options.missions.empty()) throw OptionError("MISSION is missing: what to replay");
  return Run(options).run();
}

}  // namespace loopwise::cli
