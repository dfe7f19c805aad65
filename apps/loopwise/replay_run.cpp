// SPDX-License-Identifier: BSD-3-Clause
#include <exception>
#include <functional>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_text.hpp>
#include <loopwise/replay/live_replay.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/replay/trace.hpp>

#include "replay_input.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

/// A run of `loopwise replay`, from the mission to the results.
class Run {
 public:
  explicit Run(const ReplayCommand& options)
      : options_(options),
        console_(options.common.quiet),
        config_(configured(options)),
        live_(options.clock == "real"),
        threads_(options.job == nullptr ? thread_count(options.common) : 1),
        team_(read_team(options, config_, threads_, console_, interrupt_.token())),
        folder_(open_folder(options, team_.mission, config_, console_)) {}

  int run() {
    RunHistory history(team_.mission);
    ReplayResult result = compute(history);
    const RunEvaluation evaluation = evaluate_run(team_.mission, result);
    write(result, evaluation, history);
    print(result, evaluation);
    if (config_.mission.strict) require_unaltered(result.problems);
    if (!interrupt_.interrupted()) return kDone;
    console_.note(std::string("interrupted: the results are those so far") +
                  (live_ ? "" : "; --resume continues"));
    return kInterrupted;
  }

 private:
  ReplayResult compute(RunHistory& history);
  ReplayResult replay(const Registration& registration, ReplayHooks& hooks);
  void write(ReplayResult& result, const RunEvaluation& evaluation, const RunHistory& history);
  void print(const ReplayResult& result, const RunEvaluation& evaluation);

  const ReplayCommand& options_;
  Console console_;
  const InterruptGuard interrupt_;
  const Config config_;
  const bool live_;
  ThreadPool threads_;
  const Team team_;
  ReplayFolder folder_;
#ifdef LOOPWISE_HAS_MPI
  std::shared_ptr<WorkServer> server_;  ///< Null unless the process is rank 0 of a job.
#endif
};

ReplayResult Run::compute(RunHistory& history) {
  const Registration registration =
      make_registration(config_.replay.registration, team_.mission.scans->loader(), folder_.store);
  ReplayHooks hooks;
  hooks.journal = [&](const std::string& line) { folder_.journal->add(line); };
  if (folder_.outcomes)
    hooks.outcome = [&](const RegistrationResult& result) { folder_.outcomes->add(result); };
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.progress = console_.progress_callback();
  hooks.stop = interrupt_.token();
  std::optional<LineLog> trace_log;
  std::optional<TraceWriter> trace;
  if (!options_.record_trace.empty()) {
    trace_log.emplace(options_.record_trace);
    trace.emplace(team_.mission.robots, module_options(config_.replay),
                  [&](const std::string& line) { trace_log->add(line); });
    hooks.event = [&](const HandledEvent& handled) { trace->add(handled); };
  }
  ReplayResult result = replay(registration, hooks);
  if (folder_.store) note_outcomes(console_, folder_.store->statistics());
  return result;
}

ReplayResult Run::replay(const Registration& registration, ReplayHooks& hooks) {
  if (live_) {
    RealClock clock(0.0, options_.rate.value_or(1.0));
    return replay_live(team_.mission, config_.replay, registration.registrar, clock,
                       thread_count(options_.common), hooks);
  }
#ifdef LOOPWISE_HAS_MPI
  if (options_.job != nullptr)
    server_ = use_ranks(options_, team_.mission, config_.replay, registration.registrar, hooks);
#endif
  return MissionReplay(team_.mission, config_.replay, registration)
      .run(threads_, hooks, folder_.outcomes->known());
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
  PointCloud map;
  attempt([&] {
    map = map_of_run(team_.mission, result, options_.map_voxel_m, interrupt_.token(),
                     console_.progress_callback(), config_.replay.registration.features.max_range_m);
  });
  add_scan_problems(result, *team_.mission.scans);  // if the map failed
  console_.warn(result.problems);
  attempt([&] { folder_.journal->finish(); });
  if (folder_.outcomes) folder_.outcomes->finish();
  if (interrupt_.interrupted()) map = {};
  if (options_.map_ply && !map.empty()) attempt([&] { write_ply(folder_.path / "map.ply", map); });
  write_run_folder(folder_.path, team_.mission, config_.replay, result, evaluation, history.rows(), map);
  if (failure) std::rethrow_exception(failure);
}

void Run::print(const ReplayResult& result, const RunEvaluation& evaluation) {
  Json summary = parse_json(run_summary_json(team_.mission, config_.replay, result, evaluation), "summary");
#ifdef LOOPWISE_HAS_MPI
  if (server_) note_ranks(console_, *server_, summary);
#endif
  if (team_.frames) summary["frames"] = frames_json(*team_.frames);
  print_results(options_.common, summary,
                (team_.frames ? frames_text(*team_.frames) : "") +
                    run_results_text(team_.mission.robots, config_.replay, result, evaluation,
                                     {thread_count(options_.common), !live_}) +
                    "results      " + folder_.path.string() + "\n");
}

}  // namespace

int run_replay(const ReplayCommand& options) {
  if (options.missions.empty()) throw OptionError("MISSION is missing: what to replay");
  return Run(options).run();
}

}  // namespace loopwise::cli
