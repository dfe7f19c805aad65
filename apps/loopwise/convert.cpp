// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/mission.hpp>

#include "command.hpp"
#include "team.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::vector<std::string> sources;
  std::string output, to = "mission", encoding = "binary_compressed", robots, frames, bin_layout;
  bool start_together = false;
};

Json problems_json(const Problems& problems) {
  Json json = Json::array();
  for (const Problem& problem : problems.all()) json.push_back(to_string(problem));
  return json;
}

/// One sentence on everything that a file of poses leaves out of a mission.
std::string trajectories_hold(MissionFormat format, const Problems& left_out) {
  constexpr std::string_view kSuffix = " left out";
  std::string others;
  for (const Problem& problem : left_out.all()) {
    std::string what = problem.kind;
    if (what.size() > kSuffix.size() && what.substr(what.size() - kSuffix.size()) == kSuffix)
      what.resize(what.size() - kSuffix.size());
    others += (others.empty() ? "" : ", ") + what +
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

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  if (!options.robots.empty()) config.mission.robots = options.robots;
  if (!options.frames.empty()) config.mission.frames = options.frames;
  if (options.start_together) config.mission.start_together = true;
  apply_bin_layout(options.bin_layout, config);
  if (config.mission.frames != "auto") config.mission.scan_cache_mb = 0.0;  // each scan is used once
  const MissionFormat format = format_of(options.to);
  ConvertOptions convert;
  convert.encoding = parse_enum<PcdEncoding>("--encoding", options.encoding);
  convert.threads = thread_count(options.common);
  convert.progress = console.progress_callback();
  convert.stop = interrupt.token();
  const bool existed = std::filesystem::exists(options.output);
  prepare_output_folder(options.output, false, "");

  Team team;
  Mission& mission = team.mission;
  ConvertResult result;
  try {
    const std::vector<std::filesystem::path> paths(options.sources.begin(), options.sources.end());
    ThreadPool threads(convert.threads);
    team = read_team(paths, config, /*find=*/false, threads, console.progress_callback(), interrupt.token());
    console.warn(mission.problems);
    result = convert_mission(mission, options.output, format, convert);
  } catch (...) {
    std::error_code ignored;
    if (!existed) std::filesystem::remove(options.output, ignored);
    throw;
  }
  console.warn(mission.scans->problems());
  if (format == MissionFormat::kTum || format == MissionFormat::kKitti) {
    console.note(trajectories_hold(format, result.left_out));
  } else {
    for (const Problem& problem : result.left_out.all()) console.note(to_string(problem));
  }

  Problems problems = mission.problems;
  problems.add(mission.scans->problems());
  Json robots = Json::array();
  std::size_t landmarks = 0;
  for (const Robot& robot : mission.robots.all()) {
    if (!robot.landmarks) robots.push_back(robot.name);
  }
  for (const Node& node : mission.graph.nodes()) landmarks += mission.robots.is_landmark(node.key) ? 1 : 0;
  Json json = {{"kind", enum_name(mission.kind)},
               {"to", options.to},
               {"folder", options.output},
               {"name", mission.name},
               {"robots", robots},
               {"nodes", mission.graph.nodes().size()},
               {"landmarks", landmarks},
               {"edges", mission.graph.edges().size()},
               {"priors", mission.graph.priors().size()},
               {"ranges", mission.graph.ranges().size()},
               {"gravity", mission.graph.gravities().size()},
               {"scans", result.scans},
               {"ground_truth", mission.ground_truth.size()},
               {"reference", mission.reference.size()},
               {"radio_readings", mission.radio.size()},
               {"beacons", mission.beacons.size()},
               {"left_out", problems_json(result.left_out)},
               {"problems", problems_json(problems)}};
  std::string text =
      enum_name(mission.kind) + " \"" + mission.name + "\" to " + options.to + ": " +
      std::to_string(robots.size()) + " robots, " + std::to_string(mission.graph.nodes().size()) + " nodes" +
      (landmarks > 0 ? " (" + std::to_string(landmarks) + " landmarks), " : ", ") +
      std::to_string(mission.graph.edges().size()) + " edges, " + std::to_string(result.scans) + " scans, " +
      std::to_string(mission.ground_truth.size()) + " true poses\n" +
      (team.frames ? frames_text(*team.frames) : "") + "folder       " + options.output + "\n";
  if (team.frames) json["frames"] = frames_json(*team.frames);
  print_results(options.common, json, text);
  return kDone;
}

}  // namespace

void add_convert(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("convert", "Write recorded data in another form");
  command->footer(
      "Reads what every command reads: mission folders, sessions, g2o files, g2o_pcd folders, bags, "
      "maps "
      "that\n"
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
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("LIST");
  add_joining_options(*command, options->frames, options->start_together);
  add_bin_layout_option(*command, options->bin_layout);
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
