// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "command.hpp"
#include "simulation_text.hpp"

namespace loopwise::cli {
namespace {

struct SimulateCommand {
  CommonOptions common;
  std::string world;
  std::string output;
  std::uint64_t seed = 1;
  std::string lidar = "vlp16";
  std::string scans = "lamp";
  SimulationOptions simulation;
  bool no_radio = false;
  bool no_gaps = false;
  bool statistics = false;
};

/// The options of the simulation. \throws OptionError
SimulationOptions simulation_options(const SimulateCommand& options) {
  SimulationOptions simulation = options.simulation;
  simulation.world = parse_enum<WorldKind>("world", options.world);
  simulation.lidar = parse_enum<LidarKind>("lidar", options.lidar);
  simulation.scans = parse_enum<ScanKind>("scans", options.scans);
  simulation.radio = !options.no_radio;
  simulation.communication_gaps = !options.no_gaps;
  simulation.threads = thread_count(options.common);
  validate_simulation(simulation);
  return simulation;
}

void print_mission(const SimulateCommand& options, const SimulationOptions& simulation,
                   const SimulatedMission& made, double seconds) {
  const Mission& mission = made.mission;
  std::int64_t last = mission.start_ns;
  for (const Node& node : mission.graph.nodes()) last = std::max(last, node.stamp_ns);
  const double duration = static_cast<double>(last - mission.start_ns) * 1e-9;
  Json json = {{"world", enum_name(simulation.world)},
               {"seed", std::to_string(options.seed)},
               {"folder", options.output},
               {"nodes", mission.graph.nodes().size()}};
  std::string text;
  const double length = add_robots(mission, json, text);
  const Json rest = {{"length_m", length},
                     {"duration_s", duration},
                     {"beacons", mission.beacons.size()},
                     {"radio_readings", mission.radio.size()},
                     {"communication_gaps", mission.gaps.size()},
                     {"rays", made.rays},
                     {"parameters_sha256", std::string(simulation_parameters_hash())},
                     {"seconds", {{"total", seconds}}}};
  json.update(rest);
  text += "\nmission      " + mission.name + ": " + std::to_string(mission.graph.nodes().size()) +
          " nodes, " + fixed(length, 0) + " m in " + fixed(duration, 0) + " s\nradio        " +
          std::to_string(mission.beacons.size()) + " beacons, " + std::to_string(mission.radio.size()) +
          " readings, " + std::to_string(mission.gaps.size()) + " communication gaps\ntime         " +
          fixed(seconds, 1) + " s for " + fixed(static_cast<double>(made.rays) * 1e-6, 1) + " million rays\n";
  if (options.statistics) add_statistics(made, simulation.threads, json, text);
  print_results(options.common, json, text);
}

int run_simulate(const SimulateCommand& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  static_cast<void>(load_config(options.common));  // reports an invalid configuration file
  const SimulationOptions simulation = simulation_options(options);
  NewFolder folder(options.output);
  const Stopwatch watch;
  SimulatedMission made;
  try {
    made = simulate_to_folder(options.output, simulation, options.seed, console.progress_callback(),
                              interrupt.token());
  } catch (const SimulationStopped&) {
    console.warn("interrupted: nothing was kept");
    return kInterrupted;
  }
  folder.keep();
  print_mission(options, simulation, made, watch.seconds());
  return kDone;
}

}  // namespace

void add_simulate(Command& app, Action& chosen) {
  const auto options = std::make_shared<SimulateCommand>();
  SimulationOptions& simulation = options->simulation;
  Command* command =
      app.add_subcommand("simulate", "Make a mission in an underground world, with ground truth");
  command->footer(
      "The same world, seed and options give the same mission. Lengths and teams are those of the paper "
      "unless "
      "given.\n"
      "  loopwise simulate tunnel -o my_mission --seed 7\n"
      "  loopwise simulate urban -o small --seed 1 --robots 2 --length 120");
  command->add_option("world", options->world, "tunnel, urban, finals or mine")
      ->required()
      ->type_name("WORLD");
  command->add_option("-o,--output", options->output, "Folder for the mission: a new one, or empty")
      ->required()
      ->type_name("DIR")
      ->check(not_standard_output());
  add_seed_option(*command, options->seed);
  command->add_option("--robots", simulation.robots, "Robots of the team")
      ->type_name("N")
      ->check(in_range(1, 26));
  command->add_option("--length", simulation.length_m, "Path length of all robots together, m")
      ->type_name("M");
  command->add_option("--lidar", options->lidar, "vlp16 or os1_64 (default vlp16)")->type_name("WORD");
  command
      ->add_option("--scans", options->scans,
                   "lamp: thinned as a front end does; raw: whole sweeps (default lamp)")
      ->type_name("WORD");
  command
      ->add_option("--scan-points", simulation.scan_points,
                   "Points of a thinned scan, at most (default 1500)")
      ->type_name("N");
  command->add_option("--node-spacing", simulation.node_spacing_m, "From node to node, m (default 2)")
      ->type_name("M");
  command
      ->add_option("--prior-tilt-sigma", simulation.prior_tilt_sigma_rad,
                   "Sigma of the alignment at the gate: roll and pitch, rad (default 0.005)")
      ->type_name("RAD");
  command
      ->add_option("--prior-yaw-sigma", simulation.prior_yaw_sigma_rad,
                   "Sigma of the alignment at the gate: yaw, rad (default 0.00041)")
      ->type_name("RAD");
  command
      ->add_option("--prior-position-sigma", simulation.prior_position_sigma_m,
                   "Sigma of the alignment at the gate: position, m (default 0.0016)")
      ->type_name("M");
  command->add_flag("--no-radio", options->no_radio, "No beacons");
  command->add_flag("--no-gaps", options->no_gaps, "Robots are never out of range");
  command->add_flag("--statistics", options->statistics,
                    "Also measure candidates, overlap, observability and received power");
  finish_command(*command, options, run_simulate, chosen);
}

}  // namespace loopwise::cli
