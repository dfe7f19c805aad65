// SPDX-License-Identifier: BSD-3-Clause
#include <chrono>
#include <cmath>
#include <system_error>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/simulation/simulate.hpp>
#include <loopwise/simulation/statistics.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

struct Options {
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

constexpr double kDegrees = 57.29577951308232;

Json number(double value) {
  return std::isnan(value) ? Json() : Json(value);
}

Json quartiles(const ScoreQuartiles& q) {
  return {{"count", q.count}, {"low", number(q.low)}, {"median", number(q.median)}, {"high", number(q.high)}};
}

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

/// Adds the measurements of --statistics.
void measure(const SimulatedMission& made, int threads, Json& json, std::string& text) {
  CandidateStatisticsOptions candidate_options;
  candidate_options.threads = threads;
  const CandidateStatistics candidates = candidate_statistics(made.mission, candidate_options);
  json["candidates"] = {{"radius_m", candidate_options.radius_m},
                        {"generated", candidates.candidates},
                        {"looked_at", candidates.looked_at},
                        {"mean_overlap", number(candidates.mean_overlap)},
                        {"overlapping", number(candidates.overlapping)},
                        {"within_radius", number(candidates.within_radius)}};
  text += "pairs        " + std::to_string(candidates.candidates) + " of nodes within " +
          fixed(candidate_options.radius_m, 0) + " m; the scans of " +
          fixed(100.0 * candidates.overlapping, 1) + " % overlap at the true poses (sample of " +
          std::to_string(candidates.looked_at) + ")\n";
  const SensorStatistics sensors = sensor_statistics(made, threads);
  json["observability"] = {{"corridors", quartiles(sensors.corridors)},
                           {"elsewhere", quartiles(sensors.elsewhere)}};
  text += "observable   corridors " + fixed(sensors.corridors.median, 3) + ", elsewhere " +
          fixed(sensors.elsewhere.median, 3) + " (medians)\n";
  std::vector<std::vector<std::string>> rows{
      {"beacon at m", "walls", "heard", "missed", "mean dBm", "sigma dB"}};
  Json power = Json::array();
  for (const PowerBin& bin : sensors.power) {
    power.push_back({{"from_m", bin.from_m},
                     {"to_m", bin.to_m},
                     {"walls", bin.walls},
                     {"heard", bin.heard},
                     {"missed", bin.missed},
                     {"mean_dbm", number(bin.mean_dbm)},
                     {"sigma_db", number(bin.sigma_db)}});
    if (bin.heard + bin.missed == 0) continue;
    rows.push_back({fixed(bin.from_m, 0) + "-" + fixed(bin.to_m, 0), bin.walls ? "yes" : "no",
                    std::to_string(bin.heard), std::to_string(bin.missed), fixed(bin.mean_dbm, 1),
                    fixed(bin.sigma_db, 1)});
  }
  json["power"] = power;
  if (rows.size() > 1) text += "\n" + table(rows);
}

int run(const Options& options) {
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  static_cast<void>(load_config(options.common));  // reports an invalid configuration file
  SimulationOptions simulation = options.simulation;
  simulation.world = parse_enum<WorldKind>("world", options.world);
  simulation.lidar = parse_enum<LidarKind>("lidar", options.lidar);
  simulation.scans = parse_enum<ScanKind>("scans", options.scans);
  simulation.radio = !options.no_radio;
  simulation.communication_gaps = !options.no_gaps;
  simulation.threads = thread_count(options.common);
  validate_simulation(simulation);
  const bool existed = std::filesystem::exists(options.output);
  prepare_output_folder(options.output, false, "");

  const auto start = std::chrono::steady_clock::now();
  SimulatedMission made;
  try {
    made = simulate_to_folder(options.output, simulation, options.seed, console.progress_callback(),
                              interrupt.token());
  } catch (const SimulationStopped&) {
    std::error_code ignored;
    if (!existed) std::filesystem::remove(options.output, ignored);
    console.warn("interrupted: nothing was kept");
    return kInterrupted;
  } catch (...) {
    std::error_code ignored;
    if (!existed) std::filesystem::remove(options.output, ignored);
    throw;
  }
  const double seconds = seconds_since(start);

  const Mission& mission = made.mission;
  std::int64_t last = mission.start_ns;
  for (const Node& node : mission.graph.nodes()) last = std::max(last, node.stamp_ns);
  Json robots = Json::array();
  std::vector<std::vector<std::string>> rows{{"robot", "length m", "drift m", "drift %", "drift deg"}};
  double length = 0.0;
  for (const RobotDrift& drift : odometry_drift(mission)) {
    length += drift.length_m;
    robots.push_back({{"name", drift.robot},
                      {"length_m", drift.length_m},
                      {"largest_error_m", drift.largest_m},
                      {"largest_error_rad", drift.largest_rad},
                      {"end_error_m", drift.end_m}});
    rows.push_back({drift.robot, fixed(drift.length_m, 1), fixed(drift.largest_m, 2),
                    fixed(100.0 * drift.largest_m / drift.length_m, 2),
                    fixed(drift.largest_rad * kDegrees, 2)});
  }
  const double duration = static_cast<double>(last - mission.start_ns) * 1e-9;
  Json json = {{"world", enum_name(simulation.world)},
               {"seed", std::to_string(options.seed)},
               {"folder", options.output},
               {"nodes", mission.graph.nodes().size()},
               {"robots", robots},
               {"length_m", length},
               {"duration_s", duration},
               {"beacons", mission.beacons.size()},
               {"radio_readings", mission.radio.size()},
               {"communication_gaps", mission.gaps.size()},
               {"rays", made.rays},
               {"parameters_sha256", std::string(simulation_parameters_hash())},
               {"seconds", {{"total", seconds}}}};
  std::string text = table(rows);
  text += "\nmission      " + mission.name + ": " + std::to_string(mission.graph.nodes().size()) +
          " nodes, " + fixed(length, 0) + " m in " + fixed(duration, 0) + " s\nradio        " +
          std::to_string(mission.beacons.size()) + " beacons, " + std::to_string(mission.radio.size()) +
          " readings, " + std::to_string(mission.gaps.size()) + " communication gaps\ntime         " +
          fixed(seconds, 1) + " s for " + fixed(static_cast<double>(made.rays) * 1e-6, 1) + " million rays\n";
  if (options.statistics) measure(made, simulation.threads, json, text);
  print_results(options.common, json, text);
  return kDone;
}

}  // namespace

void add_simulate(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  SimulationOptions& simulation = options->simulation;
  CLI::App* command =
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
  command->add_option("--seed", options->seed, "Seed of all random draws (default 1)")
      ->type_name("S")
      ->check(not_negative());
  command->add_option("--robots", simulation.robots, "Robots of the team")->type_name("N");
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
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
