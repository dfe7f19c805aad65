// SPDX-License-Identifier: BSD-3-Clause
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <fstream>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/cost_forecast.hpp>
#include <loopwise/replay/live_replay.hpp>
#include <loopwise/replay/outcome_file.hpp>
#include <loopwise/replay/outcome_store.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/replay/trace.hpp>

#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/registration.hpp>
#endif

#include "command.hpp"
#include "replay_arguments.hpp"
#include "run_text.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

struct Options {
  CommonOptions common;
  std::vector<std::string> missions, truth;
  std::string frames;
  std::string bin_layout;
  bool start_together = false;
  std::string output;
  std::optional<std::string> method;
  std::string clock = "virtual";
  std::string trace, record_trace;
  ReplayArguments replay;
  std::optional<std::int64_t> workers;
  std::optional<double> rate;
  bool after_mission = false;
  bool resume = false;
  bool overwrite = false;
  double map_voxel_m = 0.2;
  bool map_ply = false;
  Transport* job = nullptr;
};

Config configured(const Options& o) {
  Config config = load_config(o.common);
  apply(o.replay, config);
  if (o.method) config.replay.prioritization.method = parse_method(*o.method);
  if (o.workers) config.replay.cost.workers = *o.workers;
  if (!o.frames.empty()) config.mission.frames = o.frames;
  if (o.start_together) config.mission.start_together = true;
  apply_bin_layout(o.bin_layout, config);
  if (o.after_mission) config.replay.after_mission = true;
  if (o.clock != "virtual" && o.clock != "real") throw_unknown_name("clock", o.clock, {"virtual", "real"});
  if (o.clock == "real" && o.job != nullptr)
    throw OptionError("--clock real: a real clock needs a single process");
  if (o.rate && o.clock != "real") throw OptionError("--rate needs --clock real");
  if (!o.record_trace.empty() && o.clock != "real") {
    throw OptionError(
        "--record-trace needs --clock real: a run on the virtual clock can be repeated without a trace");
  }
  if (o.clock == "real") {
    if (o.resume) throw OptionError("--resume: a run on the real clock cannot be repeated");
    for (const auto& [given, name] :
         {std::pair(o.workers.has_value(), "--workers"),
          std::pair(!o.replay.registration_time.empty(), "--registration-time"),
          std::pair(o.replay.gi_evaluation_time.has_value(), "--gi-evaluation-time")}) {
      if (given)
        throw OptionError(std::string(name) + ": not available on a real clock, which uses measured times");
    }
  }
  validate_config(config);
  return config;
}

ContentHash hash_of(const PoseGraph& graph) {
  ContentHasher hasher;
  const auto add_pose = [&hasher](const Eigen::Isometry3d& pose) {
    for (const double value : pose.matrix().reshaped()) hasher.number(value);
  };
  for (const Node& node : graph.nodes()) {
    hasher.integer(node.key).integer(static_cast<std::uint64_t>(node.stamp_ns));
    add_pose(node.pose);
  }
  for (const Edge& edge : graph.edges()) {
    hasher.integer(edge.from).integer(edge.to);
    add_pose(edge.T_from_to);
  }
  return hasher.finish();
}

/// Hashes all input that determines the outcomes of a run, except the contents of the scans. A run is resumed
/// only with the same input.
std::string fingerprint(const Mission& mission, const Config& config) {
  Json json = Json::object();
  json["mission"] = mission.name;
  json["graph"] = to_string(hash_of(mission.graph));
  json["scans"] = mission.scans->size();
  json["options"] = parse_json(config_json(config), "options");
  json["content"] = to_string(ContentHasher().text(config_key(config)).finish());
  json["code"] = replay_code_version();
  return json_text(json);
}

/// Trajectories of an earlier run in the folder, which may have had other robots.
std::vector<fs::path> former_trajectories(const fs::path& folder) {
  std::vector<fs::path> files;
  if (!fs::is_directory(folder / "trajectories")) return files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "trajectories")) {
    if (entry.path().extension() == ".tum") files.push_back("trajectories" / entry.path().filename());
  }
  return files;
}

/// Removes a file that would be mistaken for a result of the new run.
void remove_former(const fs::path& file) {
  std::error_code failure;
  fs::remove(file, failure);
  if (failure) throw IoError(file.string(), "cannot be removed: " + failure.message());
}

/// Removes former results that a new run does not always overwrite.
void remove_former_results(const fs::path& folder) {
  for (const char* name : {"summary.json", "map.pcd", "map.ply", "picture.svg"}) remove_former(folder / name);
  for (const fs::path& file : former_trajectories(folder)) remove_former(folder / file);
}

/// The store of --outcomes, or null.
std::shared_ptr<OutcomeStore> open_store(const ReplayArguments& arguments) {
  if (arguments.outcomes.empty()) return nullptr;
  return std::make_shared<OutcomeStore>(arguments.outcomes, arguments.outcomes_bound);
}

#ifdef LOOPWISE_HAS_MPI
/// Makes a registrar at its first use. By then rank 0 has checked the output folder, in which the registrar
/// may store outcomes.
class LateRegistrar final : public Registrar {
 public:
  explicit LateRegistrar(std::function<std::shared_ptr<const Registrar>()> make) : make_(std::move(make)) {}
  [[nodiscard]] std::string_view name() const override { return made().name(); }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    return made().compute(task);
  }

 private:
  const Registrar& made() const {
    std::call_once(once_, [&] { registrar_ = make_(); });
    return *registrar_;
  }

  std::function<std::shared_ptr<const Registrar>()> make_;
  mutable std::once_flag once_;
  mutable std::shared_ptr<const Registrar> registrar_;
};

/// The work of a rank other than the first: computes registrations for it.
int serve(const Options& options) {
  try {
    const Config config = configured(options);
    const std::vector<fs::path> paths(options.missions.begin(), options.missions.end());
    const Mission mission = read_missions(paths, config.mission);
    const LateRegistrar registrar([&]() -> std::shared_ptr<const Registrar> {
      return make_registration(config.replay.registration, mission.scans->loader(),
                               open_store(options.replay))
          .registrar;
    });
    serve_registrations(*options.job, replay_greeting(mission, config.replay), registrar);
    return kDone;
  } catch (const Error& error) {
    report_failure(*options.job, error.what());
    return kDone;  // the first rank reports the failure and ends the job
  }
}
#endif

#ifdef LOOPWISE_HAS_MPI
/// Reports the work of the ranks as a note and as JSON.
void note_ranks(Console& console, const WorkStatistics& statistics, Json& json) {
  const auto mean = [](std::size_t bytes, std::size_t messages) {
    return messages == 0 ? 0.0 : static_cast<double>(bytes) / static_cast<double>(messages);
  };
  const double request = mean(statistics.request_bytes, statistics.requests);
  const double answer = mean(statistics.answer_bytes, statistics.answers);
  json["ranks"] = {{"registrations", statistics.done},
                   {"messages", statistics.requests},
                   {"request_bytes", request},
                   {"answer_bytes", answer}};
  std::string done;
  for (const std::size_t of_rank : statistics.done)
    done += (done.empty() ? "" : ", ") + std::to_string(of_rank);
  std::ostringstream text;
  text << "registrations by rank: " << done << "; " << std::lround(request) << " B to another rank and "
       << std::lround(answer) << " B back for each";
  console.note(text.str());
}
#endif

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

/// Repeats a run of the online module.
int run_trace(const Options& options) {
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

int run(const Options& options) {
  if (!options.trace.empty()) return run_trace(options);
  if (options.missions.empty()) throw OptionError("MISSION is missing: what to replay");
#ifdef LOOPWISE_HAS_MPI
  std::shared_ptr<WorkServer> server;
  if (options.job != nullptr && options.job->rank() > 0) return serve(options);
#endif
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = configured(options);
  const std::vector<fs::path> paths(options.missions.begin(), options.missions.end());
  ThreadPool threads(options.job == nullptr ? thread_count(options.common) : 1);
  Team team =
      options.job != nullptr
          ? Team{read_missions(paths, config.mission, console.progress_callback(), interrupt.token()), {}}
          : read_team(paths, config, /*find=*/true, threads, console.progress_callback(), interrupt.token());
  Mission& mission = team.mission;
  set_truth(mission, options.truth, config.mission);
  Problems problems;
  for (const Problem& problem : mission.problems.all()) {
    const bool settled =
        config.replay.odometry_noise_m_per_m + config.replay.odometry_noise_rad_per_m > 0.0 &&
        problem.kind == "odometry taken from the optimised poses";
    if (!settled) problems.add(problem.kind, problem.example, problem.count);
  }
  console.warn(problems);
  std::size_t recorded = 0;
  for (const Edge& edge : mission.graph.edges()) recorded += edge.kind == EdgeKind::kLoopClosure ? 1 : 0;
  if (recorded > 0) {
    console.note(
        counted(recorded, "closure") +
        " of the mission left out: a replay finds its own (`loopwise optimize` and `rank` use them)");
  }
  if (config.replay.prioritization.method == Method{PrioritizerKind::kRssi} && mission.radio.empty()) {
    console.warn("the mission has no radio readings: method rssi has no candidates");
  }
  if (mission.scans->empty() && !config.replay.prioritization.method.empty()) {
    console.warn("the mission has no scans: no candidate can be computed");
  }

  if (options.resume && options.overwrite)
    throw OptionError("--resume continues the run in the folder, --overwrite starts again: give one of them");
  const fs::path folder(options.output);
  refuse_recording(folder, options.missions);
  prepare_output_folder(folder, options.overwrite || options.resume,
                        "; --resume continues it, --overwrite replaces it");
  const bool live = options.clock == "real";
  if (options.resume && !fs::exists(folder / "outcomes.jsonl")) {
    if (fs::exists(folder / "summary.json")) {
      throw OptionError(folder.string() +
                        ": a run without outcomes.jsonl, as with --clock real, cannot be resumed; "
                        "--overwrite replaces it");
    }
    console.note("nothing to resume: a new run");
  }
  std::optional<OutcomeFile> outcomes;
  if (live) {
    remove_former(folder / "outcomes.jsonl");  // it belongs to another run
  } else {
    outcomes.emplace(folder / "outcomes.jsonl", fingerprint(mission, config), options.resume);
  }
  // Only now is it certain that this run may replace the former results.
  remove_former_results(folder);
  std::ofstream journal(folder / "journal.jsonl", std::ios::binary | std::ios::trunc);
  if (!journal) throw IoError((folder / "journal.jsonl").string(), "cannot be written");
  if (outcomes && !outcomes->known().empty()) {
    console.note("resuming with " + std::to_string(outcomes->known().size()) +
                 " registrations already computed");
  }
  if (outcomes && outcomes->lost() > 0) {
    console.warn((folder / "outcomes.jsonl").string() +
                 ": lines with zeros in them, as after a loss of power, are computed again: " +
                 std::to_string(outcomes->lost()));
  }

  const std::shared_ptr<OutcomeStore> store = open_store(options.replay);
  const Registration registration =
      make_registration(config.replay.registration, mission.scans->loader(), store);
  ReplayHooks hooks;
  hooks.journal = [&](const std::string& line) {
    journal << line + "\n" << std::flush;
    if (!journal) throw IoError((folder / "journal.jsonl").string(), "cannot be written");
  };
  if (outcomes) hooks.outcome = [&](const RegistrationResult& result) { outcomes->add(result); };
  RunHistory history(mission);
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.progress = console.progress_callback();
  hooks.stop = interrupt.token();
  std::ofstream trace_file;
  std::optional<TraceWriter> trace;
  if (!options.record_trace.empty()) {
    trace_file.open(options.record_trace, std::ios::binary | std::ios::trunc);
    if (!trace_file) throw IoError(options.record_trace, "cannot be written");
    trace.emplace(mission.robots, module_options(config.replay), [&](const std::string& line) {
      trace_file << line + "\n" << std::flush;
      if (!trace_file) throw IoError(options.record_trace, "cannot be written");
    });
    hooks.event = [&](const HandledEvent& handled) { trace->add(handled); };
  }
  ReplayResult result = [&] {
    if (live) {
      RealClock clock(0.0, options.rate.value_or(1.0));
      return replay_live(mission, config.replay, registration.registrar, clock, thread_count(options.common),
                         hooks);
    }
#ifdef LOOPWISE_HAS_MPI
    if (options.job != nullptr) {
      WorkOptions limits;
      if (options.replay.rank_time_limit_s) limits.time_limit_s = *options.replay.rank_time_limit_s;
      server = std::make_shared<WorkServer>(*options.job, replay_greeting(mission, config.replay), limits);
      hooks.compute =
          distributed_batches(server, registration.registrar, std::max(1, options.common.threads));
    }
#endif
    return MissionReplay(mission, config.replay, registration).run(threads, hooks, outcomes->known());
  }();
  if (store) note_outcomes(console, store->statistics());
  const RunEvaluation evaluation = evaluate_run(mission, result);
  // A run on the virtual clock can be repeated, so its folder is either complete or marked as incomplete. A
  // run on a real clock cannot: its results are written even if the map or the journal fails, and the error
  // is thrown afterwards.
  std::exception_ptr failure;
  const auto attempt = [&](const std::function<void()>& call) {
    try {
      call();
    } catch (const std::exception&) {
      if (!live) throw;
      if (!failure) failure = std::current_exception();
    }
  };
  StitchedMap map;
  attempt([&] {
    map = stitch_map(result.graph, *mission.scans, options.map_voxel_m, hooks.stop,
                     console.progress_callback(), config.replay.registration.features.max_range_m);
  });
  result.problems.add(map.problems);
  add_scan_problems(result, *mission.scans);
  console.warn(result.problems);
  attempt([&] { finish_log(journal, folder / "journal.jsonl"); });
  if (outcomes) outcomes->finish();
  if (options.map_ply && !interrupt.interrupted() && !map.cloud.empty()) {
    attempt([&] { write_ply(folder / "map.ply", map.cloud); });
  }
  write_run_folder(folder, mission, config.replay, result, evaluation, history.rows(),
                   interrupt.interrupted() ? PointCloud{} : map.cloud);
  if (failure) std::rethrow_exception(failure);
  Json summary = parse_json(run_summary_json(mission, config.replay, result, evaluation), "summary");
#ifdef LOOPWISE_HAS_MPI
  if (server) note_ranks(console, server->statistics(), summary);
#endif
  if (team.frames) summary["frames"] = frames_json(*team.frames);
  print_results(options.common, summary,
                (team.frames ? frames_text(*team.frames) : "") +
                    results_text(mission.robots, config.replay, result, evaluation,
                                 thread_count(options.common), !live) +
                    "results      " + folder.string() + "\n");
  if (interrupt.interrupted()) {
    console.note(std::string("interrupted: the results are those so far") +
                 (live ? "" : "; --resume continues"));
    return kInterrupted;
  }
  return kDone;
}

}  // namespace

void add_replay(CLI::App& app, Action& chosen, Transport* job) {
  const auto options = std::make_shared<Options>();
  options->job = job;
  CLI::App* command = app.add_subcommand("replay", "Replay a recorded mission and find its loop closures");
  command->footer(
      "Key frames arrive at their recorded times; each registration takes --registration-time of mission "
      "time on one\n"
      "of --workers, however long it takes on this machine. So a result never depends on the machine's "
      "speed.\n"
      "  loopwise replay my_mission -o out --method obs\n"
      "  loopwise replay my_session -o out --set generation.skip_recent=2 --odometry-noise 0.05 0.01 --seed "
      "3\n"
      "  loopwise replay --trace run.trace -o again\n"
      "DIR gets summary.json, closures.csv, history.csv, graph.g2o, trajectories/, map.pcd, picture.svg "
      "and journal.jsonl.");
  command
      ->add_option("mission", options->missions,
                   "Mission folder, session, g2o file, g2o_pcd folder, bag or saved map; several bags, or "
                   "several missions of one robot, are read as one")
      ->type_name("MISSION");
  command->add_option("-o,--output", options->output, "Folder for the results")
      ->required()
      ->type_name("DIR")
      ->check(not_standard_output());
  command
      ->add_option("--method", options->method,
                   "Order of the candidates: expected (default), likely, obs, gi, full (obs and gi), rssi, "
                   "random, baseline "
                   "(arrival), odom (computes nothing), or several joined by +")
      ->type_name("M");
  add_joining_options(*command, options->frames, options->start_together);
  add_truth_option(*command, options->truth);
  add_bin_layout_option(*command, options->bin_layout);
  add_replay_arguments(*command, options->replay);
  command->get_option("--outcomes-mb")->needs("--outcomes");
  command
      ->add_option(
          "--clock", options->clock,
          "virtual (default): mission time is modelled; real: the online module, fed at the recorded times")
      ->type_name("WORD");
  command->add_option("--rate", options->rate, "Real clock: mission seconds per second (default 1)")
      ->type_name("R")
      ->check(CLI::PositiveNumber);
  command
      ->add_option(
          "--record-trace", options->record_trace,
          "Real clock: record all events in this file, from which --trace repeats the run to the bit")
      ->type_name("FILE")
      ->check(not_standard_output());
  command
      ->add_option("--trace", options->trace,
                   "Repeat a recorded run of the online module; the optional MISSION adds truth and map")
      ->type_name("FILE");
  command
      ->add_option("--workers", options->workers,
                   "Registrations at a time on the mission's clock (default 10)")
      ->type_name("N");
  command->add_flag("--after-mission", options->after_mission,
                    "Continue after the mission's end until no candidate is pending");
  command->add_flag("--map-ply", options->map_ply, "Write the map as binary PLY too, map.ply");
  command->add_option("--map-voxel", options->map_voxel_m, "Voxel of map.pcd, m (default 0.2)")
      ->type_name("M")
      ->check(CLI::PositiveNumber);
  command->add_flag("--resume", options->resume, "Continue a run that was interrupted or killed in DIR");
  command->add_flag("--overwrite", options->overwrite,
                    "Replace the results of an earlier run in DIR; other files stay");
  // A trace determines all of these.
  CLI::Option* trace = command->get_option("--trace");
  for (const char* other :
       {"--method", "--clock", "--rate", "--record-trace", "--workers", "--after-mission", "--resume",
        "--preset", "--skip-recent", "--thin", "--batch", "--registration-time", "--gi-evaluation-time",
        "--max-registrations", "--odometry-noise", "--registrar", "--guess", "--outcomes", "--seed"}) {
    trace->excludes(command->get_option(other));
  }
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
