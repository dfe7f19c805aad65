// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/mission_summary.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/io/output_folder.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

struct ConvertCommand {
  CommonOptions common;
  std::vector<std::string> sources;
  std::string output, to = "mission", encoding = "binary_compressed";
  MissionArguments reading;
};

/// One sentence on everything that a file of poses leaves out of a mission.
std::string trajectories_hold(MissionFormat format, const Problems& left_out) {
  std::string others;
  for (const Problem& problem : left_out.all()) {
    others += (others.empty() ? "" : ", ") + problem.kind.substr(0, problem.kind.rfind(" left out")) +
              (problem.count > 1 ? " x " + std::to_string(problem.count) : "");
  }
  return enum_name(format) + " files hold the robots' poses" +
         (format == MissionFormat::kTum ? " and stamps" : "") + " alone" +
         (others.empty() ? "" : "; the mission also has: " + others);
}

MissionFormat format_of(const std::string& word) {
  if (word == "glim") {
    throw OptionError(
        "--to glim: GLIM takes poses and graph of a map from values.bin and graph.bin, archives of GTSAM and "
        "Boost that only a program linked to them can write. Write the poses by --to tum, and the map by "
        "'loopwise replay MISSION -o DIR --map-ply'");
  }
  return parse_enum<MissionFormat>("--to", word);
}

/// Reads the sources and writes the mission. An output folder made here is removed if that fails.
ConvertResult write_converted(const ConvertCommand& options, MissionFormat format, const Config& config,
                              Team& team, Console& console, const StopToken& stop) {
  const ConvertOptions convert{parse_enum<PcdEncoding>("--encoding", options.encoding),
                               thread_count(options.common), console.progress_callback(), stop};
  NewFolder folder(options.output);
  const std::vector<std::filesystem::path> paths(options.sources.begin(), options.sources.end());
  ThreadPool threads(convert.threads);
  team = read_team(paths, config, /*find=*/false, threads, convert.progress, stop);
  console.warn(team.mission.problems);
  ConvertResult result = convert_mission(team.mission, options.output, format, convert);
  folder.keep();
  return result;
}

void print_conversion(const ConvertCommand& options, const Team& team, const ConvertResult& result) {
  const MissionSummary s = summarize_mission(team.mission);
  Json robots = Json::array();
  std::size_t landmarks = 0;
  for (const RobotSummary& robot : s.robots) {
    if (!robot.landmarks) robots.push_back(robot.name);
    if (robot.landmarks) landmarks += robot.nodes;
  }
  Json json = {{"kind", enum_name(s.kind)},
               {"to", options.to},
               {"folder", options.output},
               {"name", s.name},
               {"robots", robots},
               {"nodes", s.nodes},
               {"landmarks", landmarks},
               {"edges", s.edges},
               {"priors", s.priors},
               {"ranges", s.ranges},
               {"gravity", s.gravity},
               {"scans", result.scans},
               {"ground_truth", s.ground_truth},
               {"reference", s.reference},
               {"radio_readings", s.radio_readings},
               {"beacons", s.beacons},
               {"left_out", problems_json(result.left_out)},
               {"problems", problems_json(s.problems)}};
  if (team.frames) json["frames"] = frames_json(*team.frames);
  print_results(options.common, json,
                enum_name(s.kind) + " \"" + s.name + "\" to " + options.to + ": " +
                    std::to_string(robots.size()) + " robots, " + std::to_string(s.nodes) + " nodes" +
                    (landmarks > 0 ? " (" + std::to_string(landmarks) + " landmarks), " : ", ") +
                    std::to_string(s.edges) + " edges, " + std::to_string(result.scans) + " scans, " +
                    std::to_string(s.ground_truth) + " true poses\n" +
                    (team.frames ? frames_text(*team.frames) : "") + "folder       " + options.output + "\n");
}

int run_convert(const ConvertCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  apply(options.reading, config);
  if (config.mission.frames != "auto") config.mission.scan_cache_mb = 0.0;  // each scan is used once
  const MissionFormat format = format_of(options.to);
  Team team;
  const ConvertResult result = write_converted(options, format, config, team, console, interrupt.token());
  console.warn(team.mission.scans->problems());
  if (format == MissionFormat::kTum || format == MissionFormat::kKitti) {
    console.note(trajectories_hold(format, result.left_out));
  } else {
    for (const Problem& problem : result.left_out.all()) console.note(to_string(problem));
  }
  print_conversion(options, team, result);
  if (config.mission.strict) require_unaltered(team.mission.scans->problems());
  return kDone;
}

}  // namespace

void add_convert(Command& app, Action& chosen) {
  const auto options = std::make_shared<ConvertCommand>();
  Command* command = app.add_subcommand("convert", "Write recorded data in another form");
  command->footer(
      "Reads what every command reads: mission folders, sessions, g2o files, g2o_pcd folders, bags, "
      "maps that\n"
      "LAMP saved. Several bags are one recording; several missions become one mission.\n"
      "  loopwise convert tunnel/rosbag -o tunnel_mission\n"
      "  loopwise convert session1 session2 session3 -o team --frames frames.csv\n"
      "  loopwise convert session1 session2 session3 -o team --frames auto\n"
      "  loopwise convert my_mission -o for_others --to g2o_pcd");
  command->add_option("sources", options->sources, "Missions, sessions, bags, archives or folders of them")
      ->required()
      ->type_name("SRC");
  command->add_option("-o,--output", options->output, "Folder to write: a new one, or empty")
      ->required()
      ->type_name("DST")
      ->check(not_standard_output());
  command->add_option("--to", options->to, "mission (default), g2o_pcd, tum, kitti, hdl_graph_slam or hba")
      ->type_name("FORM");
  command
      ->add_option("--encoding", options->encoding,
                   "Of the clouds: ascii, binary or binary_compressed (default)")
      ->type_name("WORD");
  add_robots_option(*command, options->reading.robots);
  add_joining_options(*command, options->reading);
  add_bin_layout_option(*command, options->reading.bin_layout);
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_convert, chosen);
}

}  // namespace loopwise::cli
