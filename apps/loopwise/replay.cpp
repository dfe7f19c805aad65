// SPDX-License-Identifier: BSD-3-Clause
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>

#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/transport.hpp>
#endif

#include "command.hpp"
#include "mission_options.hpp"
#include "replay_command.hpp"

namespace loopwise::cli {
namespace {

int replay_or_trace(const ReplayCommand& options) {
  if (!options.trace.empty()) return run_trace(options);
#ifdef LOOPWISE_HAS_MPI
  if (options.job != nullptr && options.job->rank() > 0) {
    if (options.missions.empty()) throw OptionError("MISSION is missing: what to replay");
    return serve(options);
  }
#endif
  return run_replay(options);
}

void add_clock_options(Command& command, ReplayCommand& options) {
  command
      .add_option(
          "--clock", options.clock,
          "virtual (default): mission time is modelled; real: the online module, fed at the recorded times")
      ->type_name("WORD");
  command.add_option("--rate", options.rate, "Real clock: mission seconds per second (default 1)")
      ->type_name("R")
      ->check(positive_number());
  command
      .add_option("--record-trace", options.record_trace,
                  "Real clock: record all events in this file, from which --trace repeats the run to the bit")
      ->type_name("FILE")
      ->check(not_standard_output());
  command
      .add_option("--trace", options.trace,
                  "Repeat a recorded run of the online module; the optional MISSION adds truth and map")
      ->type_name("FILE");
}

void add_run_options(Command& command, ReplayCommand& options) {
  command
      .add_option("--workers", options.workers, "Registrations at a time on the mission's clock (default 10)")
      ->type_name("N");
  command.add_flag("--after-mission", options.after_mission,
                   "Continue after the mission's end until no candidate is pending");
  command.add_flag("--map-ply", options.map_ply, "Write the map as binary PLY too, map.ply");
  command.add_option("--map-voxel", options.map_voxel_m, "Voxel of map.pcd, m (default 0.2)")
      ->type_name("M")
      ->check(positive_number());
  command.add_flag("--resume", options.resume, "Continue a run that was interrupted or killed in DIR");
  command.add_flag("--overwrite", options.overwrite,
                   "Replace the results of an earlier run in DIR; other files stay");
}

/// A trace determines all of these options.
void exclude_with_trace(Command& command) {
  Argument* trace = command.get_option("--trace");
  for (const char* other :
       {"--method", "--clock", "--rate", "--record-trace", "--workers", "--after-mission", "--resume",
        "--preset", "--skip-recent", "--thin", "--batch", "--registration-time", "--gi-evaluation-time",
        "--max-registrations", "--odometry-noise", "--registrar", "--guess", "--outcomes", "--seed"}) {
    trace->excludes(command.get_option(other));
  }
}

}  // namespace

Config configured(const ReplayCommand& o) {
  Config config = load_config(o.common);
  apply(o.replay, config);
  if (o.method) config.replay.prioritization.method = parse_method(*o.method);
  if (o.workers) config.replay.cost.workers = *o.workers;
  if (o.after_mission) config.replay.after_mission = true;
  if (o.clock != "virtual" && o.clock != "real") throw_unknown_name("clock", o.clock, {"virtual", "real"});
  if (o.clock == "real" && o.job != nullptr)
    throw OptionError("--clock real: a real clock needs a single process");
  if (o.job != nullptr && config.mission.frames == "auto")
    throw OptionError("--frames auto: an MPI job searches no frames; join the sources before, by convert");
  if (o.job != nullptr && config.mission.frames == "common") config.mission.frames.clear();
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

void add_replay(Command& app, Action& chosen, Transport* job) {
  const auto options = std::make_shared<ReplayCommand>();
  options->job = job;
  Command* command = app.add_subcommand("replay", "Replay a recorded mission and find its loop closures");
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
  add_joining_options(*command, options->replay.reading);
  add_truth_option(*command, options->truth);
  add_bin_layout_option(*command, options->replay.reading.bin_layout);
  add_replay_arguments(*command, options->replay);
  command->get_option("--outcomes-mb")->needs(command->get_option("--outcomes"));
  add_clock_options(*command, *options);
  add_run_options(*command, *options);
  exclude_with_trace(*command);
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, replay_or_trace, chosen);
}

}  // namespace loopwise::cli
