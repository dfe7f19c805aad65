// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/output_folder.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "pose_text.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

struct AlignCommand {
  CommonOptions common;
  std::string map, session, output;
  MissionArguments reading;
};

/// Writes the joined mission. If that fails, the partial output is removed.
std::size_t write_joined(const Mission& mission, const AlignCommand& options, Console& console,
                         const StopToken& stop) {
  NewFolder folder(options.output);
  ConvertOptions convert;
  convert.threads = thread_count(options.common);
  convert.progress = console.progress_callback();
  convert.stop = stop;
  const std::size_t scans = convert_mission(mission, options.output, MissionFormat::kMission, convert).scans;
  folder.keep();
  return scans;
}

int run_align(const AlignCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  apply(options.reading, config);
  if (!options.output.empty()) refuse_recording(options.output, {options.map, options.session});
  MissionOptions reading = config.mission;
  reading.frames.clear();
  Mission mission =
      read_missions({options.map, options.session}, reading, console.progress_callback(), interrupt.token());
  if (mission.robot_sources.empty()) {
    throw InputError("bags are one recording: convert MAP and SESSION to missions first (loopwise convert)");
  }
  ThreadPool threads(thread_count(options.common));
  const TeamFrames frames =
      find_team_frames(mission, config, threads, console.progress_callback(), interrupt.token());
  const bool placed = frames.result.groups == 1;
  Json json = frames_json(frames);
  json["status"] = placed ? "placed" : "apart";
  json["T_map_session"] = nullptr;
  std::string text = placed ? "placed\n" : "apart: " + frames.result.frames.back().reason + "\n";
  if (placed) {
    const Eigen::Isometry3d& T = frames.result.frames.back().pose;
    json["T_map_session"] = json["components"].back()["T_common_component"];
    text += "T_map_session\n" + matrix_rows(T, 6) + frames_text(frames);
    mission = placed_team(mission, frames);
    console.warn(mission.problems);
    if (!options.output.empty()) {
      const std::size_t scans = write_joined(mission, options, console, interrupt.token());
      json["folder"] = options.output;
      json["scans"] = scans;
      text += "folder       " + options.output + "\n";
    }
  } else if (!options.output.empty()) {
    console.warn(options.output + " is not written: the session has no place in the map");
  }
  console.warn(mission.scans->problems());
  print_results(options.common, json, text);
  if (config.mission.strict) require_unaltered(mission.scans->problems());
  return placed ? kDone : kBadInput;
}

}  // namespace

void add_align(Command& app, Action& chosen) {
  const auto options = std::make_shared<AlignCommand>();
  Command* command = app.add_subcommand("align", "Place a new session in an existing map");
  command->footer(
      "Finds T_map_session from the scans alone, however far apart the two frames are, and writes both as "
      "one mission.\n"
      "MAP may have several robots in one frame. A session that cannot be placed with certainty is not "
      "placed: status 3.\n"
      "  loopwise align my_map new_session -o joined");
  command->add_option("map", options->map, "Mission whose frame stays")->required()->type_name("MAP");
  command->add_option("session", options->session, "Mission or session to place")
      ->required()
      ->type_name("SESSION");
  command->add_option("-o,--output", options->output, "Folder for the joined mission: a new one, or empty")
      ->type_name("DST")
      ->check(not_standard_output());
  add_bin_layout_option(*command, options->reading.bin_layout);
  finish_command(*command, options, run_align, chosen);
}

}  // namespace loopwise::cli
