// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/report.hpp>
#include <loopwise/evaluation/run_mcap.hpp>
#include <loopwise/evaluation/text_tables.hpp>

#include "command.hpp"
#include "mission_options.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

struct ReportCommand {
  CommonOptions common;
  std::vector<std::string> runs, missions, truth;
  std::string output = "report.html";
  std::string mcap;
  ReportOptions report;
};

/// Writes a single run with its mission as a recording for viewers.
int write_mcap(const ReportCommand& options, const std::vector<Mission>& missions, Console& console) {
  if (options.runs.size() != 1 || missions.size() != 1)
    throw OptionError("--mcap takes one run and its mission (--mission)");
  const McapResult result =
      write_run_mcap(options.mcap, options.runs.front(), missions.front(), {}, console.progress_callback());
  for (const std::string& note : result.notes) console.note(note);
  console.warn(missions.front().scans->problems());
  const Json json = {{"mcap", options.mcap},
                     {"messages", result.messages},
                     {"scans", result.scans},
                     {"closures", result.closures},
                     {"notes", result.notes}};
  print_results(options.common, json,
                "mcap " + options.mcap + ": " + counted(result.scans, "scan") + ", " +
                    counted(result.closures, "closure") + ", " + std::to_string(result.messages) +
                    " messages\n");
  return kDone;
}

int run_report(const ReportCommand& options) {
  Console console(options.common.quiet);
  const Config config = load_config(options.common);
  std::vector<Mission> missions;
  if (options.missions.empty() && !options.truth.empty())
    throw OptionError("--truth needs --mission, whose nodes it refers to");
  for (std::size_t i = 0; i < options.missions.size(); ++i) {
    missions.push_back(read_mission(options.missions[i], config.mission, console.progress_callback()));
    set_truth(missions.back(), truth_of_mission(options.truth, i, options.missions.size()), config.mission);
    console.warn(missions.back().problems);
  }
  if (!options.mcap.empty()) return write_mcap(options, missions, console);
  ThreadPool threads(thread_count(options.common));
  const Report report =
      write_report(options.output, std::vector<fs::path>(options.runs.begin(), options.runs.end()), missions,
                   options.report, threads, console.progress_callback());
  for (const std::string& note : report.notes) console.note(note);
  for (const Mission& mission : missions) console.warn(mission.scans->problems());

  const auto bytes = static_cast<std::size_t>(fs::file_size(options.output));
  const Json json = {{"report", options.output},  {"bytes", bytes},      {"runs", report.runs},
                     {"studies", report.studies}, {"maps", report.maps}, {"notes", report.notes}};
  print_results(options.common, json,
                "report " + options.output + ": " + counted(report.runs, "run") +
                    (report.studies > 0 ? ", " + counted(report.studies, "study", "studies") : "") + ", " +
                    fixed(static_cast<double>(bytes) * 1e-6, 1) + " MB. Open it in any browser.\n");
  return kDone;
}

}  // namespace

void add_report(Command& app, Action& chosen) {
  const auto options = std::make_shared<ReportCommand>();
  Command* command = app.add_subcommand("report", "Runs side by side as one page for any browser");
  command->footer(
      "The page holds a map to turn and zoom, charts over mission time, tables and options, and loads "
      "nothing\n"
      "from the network.\n"
      "  loopwise report out -o report.html --mission my_mission\n"
      "  loopwise report out/baseline out/obs out/full -o report.html --mission my_mission");
  command
      ->add_option("runs", options->runs,
                   "Folders of 'loopwise replay' or of 'loopwise study ablation', 'budget' or 'rssi'")
      ->required()
      ->type_name("RUN");
  command->add_option("-o,--output", options->output, "The page (default report.html)")
      ->type_name("FILE")
      ->check(not_standard_output());
  command
      ->add_option(
          "--mcap", options->mcap,
          "Instead of a page, write one run with its mission as an MCAP file of ROS 2 messages, which "
          "Foxglove and other viewers open")
      ->type_name("FILE")
      ->check(not_standard_output());
  command
      ->add_option("--mission", options->missions,
                   "Mission of the runs, for true paths, radio and observability; may be repeated")
      ->type_name("MISSION")
      ->expected(1)
      ->take_all();
  add_truth_option(*command, options->truth);
  command
      ->add_option("--map-points", options->report.map_points,
                   "Most points of a map that are drawn (default 20000)")
      ->type_name("N");
  command->add_option("--maps", options->report.maps, "Runs that get a map, the first ones (default 8)")
      ->type_name("N");
  command
      ->add_option("--review", options->report.review_closures,
                   "Closures whose scans are shown for review, the most doubtful first (default 60)")
      ->type_name("N");
  command
      ->add_option("--seed", options->report.seed, "Seed of the draw in layers with more items (default 1)")
      ->type_name("S")
      ->check(not_negative());
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_report, chosen);
}

}  // namespace loopwise::cli
