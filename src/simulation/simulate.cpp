// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/simulate.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <system_error>
#include <utility>

#include <Eigen/Eigenvalues>

#include <nlohmann/json.hpp>

#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/core/version.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/simulation/ray_caster.hpp>

#include "lidar.hpp"
#include "odometry.hpp"
#include "parameters.hpp"
#include "planner.hpp"
#include "radio.hpp"

namespace loopwise {
namespace {

namespace parameters = simulation_parameters;
namespace sim = simulation_detail;

/// Streams of random numbers, so that more of one thing leaves the others alone.
enum Stream : std::uint64_t {
  kRoutes = 11,
  kDriving,
  kSweeps,
  kThinning,
  kAlignment,
  kDrift,
  kDrops,
  kOutages,
  kRadio
};

const parameters::MissionSize& size_of(WorldKind kind) {
  switch (kind) {
    case WorldKind::kTunnel:
      return parameters::kTunnelSize;
    case WorldKind::kUrban:
      return parameters::kUrbanSize;
    case WorldKind::kFinals:
      return parameters::kFinalsSize;
    case WorldKind::kMine:
      break;
  }
  return parameters::kMineSize;
}

/// The paper's teams: wheels in the tunnel and the mine, two on wheels and one on legs in the power plant,
/// one on wheels and three on legs in the finals.
bool on_legs(WorldKind world, int robot) {
  if (world == WorldKind::kUrban) return robot % 3 == 2;
  if (world == WorldKind::kFinals) return robot % 4 != 0;
  return false;
}

class Reporter {
 public:
  Reporter(const ProgressCallback& callback, std::string stage, std::size_t total) : callback_(callback) {
    progress_.stage = std::move(stage);
    progress_.total = total;
    if (callback_) callback_(progress_);
  }
  void step() {
    if (!callback_) return;
    const std::lock_guard<std::mutex> lock(mutex_);
    ++progress_.done;
    callback_(progress_);
  }

 private:
  const ProgressCallback& callback_;
  std::mutex mutex_;
  Progress progress_;
};

void stop_here(const StopToken& stop) {
  if (stop.stop_requested()) throw SimulationStopped("stopped before the mission was whole");
}

/// Nodes of one robot within the whole mission.
struct Span {
  std::size_t first;
  std::size_t count;
};

}  // namespace

void validate_simulation(const SimulationOptions& options) {
  validate(options);
  const parameters::MissionSize& size = size_of(options.world);
  const double length = options.length_m > 0.0 ? options.length_m : size.length_m;
  const int robots = options.robots > 0 ? options.robots : size.robots;
  const double least = std::max(20.0, 10.0 * options.node_spacing_m) * robots;
  if (length < std::max(60.0, least)) {
    throw OptionError("length_m = " + std::to_string(length) + ", must be >= " +
                      std::to_string(std::max(60.0, least)) + " for " + std::to_string(robots) + " robots");
  }
}

SimulationOptions resolved(SimulationOptions options) {
  validate_simulation(options);
  const parameters::MissionSize& size = size_of(options.world);
  if (options.length_m == 0.0) options.length_m = size.length_m;
  if (options.robots == 0) options.robots = size.robots;
  return options;
}

std::string_view simulation_parameters_hash() {
  return LOOPWISE_SIMULATION_PARAMETERS_HASH;
}

SimulatedMission simulate(const SimulationOptions& given, std::uint64_t seed,
                          const ProgressCallback& progress, const StopToken& stop, const ScanSink& sink) {
  SimulatedMission result;
  const SimulationOptions options = result.options = resolved(given);
  result.seed = seed;
  const auto stream = [seed](Stream which) { return combine_seeds(seed, which); };

  Reporter world_report(progress, "building the world", 1);
  const World world = make_world(options.world, options.length_m, seed, options.threads, stop);
  stop_here(stop);
  const RayCaster caster(world.mesh);
  world_report.step();

  // The ways.
  const auto robots = static_cast<std::size_t>(options.robots);
  const double length = options.length_m / options.robots;
  const auto routes = sim::plan_routes(world.routes, options.robots, length, stream(kRoutes));
  const auto count = static_cast<std::size_t>(std::floor(length / options.node_spacing_m)) + 1;
  std::vector<sim::Drive> team(robots);
  std::vector<Span> spans;
  std::vector<Robot> names;
  Mission& mission = result.mission;
  std::vector<Key> keys;
  for (std::size_t r = 0; r < robots; ++r) {
    const bool legs = on_legs(options.world, static_cast<int>(r));
    team[r].waypoints = sim::drive(world.routes, routes[r], legs ? parameters::kLegged : parameters::kGround,
                                   options.node_spacing_m, count, combine_seeds(stream(kDriving), r));
    for (const sim::Waypoint& w : team[r].waypoints) {
      team[r].time_s.push_back(w.time_s + parameters::kStartDelaySeconds * static_cast<double>(r));
    }
    const char character = static_cast<char>('a' + r);
    names.push_back(robot_of_character(character, (legs ? "legged" : "wheeled") + std::to_string(r + 1)));
    spans.push_back({keys.size(), team[r].waypoints.size()});
    for (std::size_t k = 0; k < team[r].waypoints.size(); ++k) keys.push_back(make_key(character, k));
  }
  mission.robots = Robots(names);
  stop_here(stop);

  const sim::Distances ways(world.routes);
  std::vector<sim::Drop> drops;
  if (options.radio) drops = sim::drop_beacons(world.routes, ways, team, stream(kDrops));
  if (options.communication_gaps) {
    mission.gaps = sim::communication_gaps(world.routes, ways, team, drops, stream(kOutages));
  }

  std::vector<Eigen::Isometry3d> truth;
  for (const sim::Drive& drive : team) {
    for (const sim::Waypoint& w : drive.waypoints) {
      truth.push_back(w.T_world_body);
      const auto& passage = world.routes.passages[w.passage];
      const double margin = std::max(3.0, passage.half_width_m + 2.0);
      result.in_corridor.push_back(passage.corridor && w.along_m > margin &&
                                   w.along_m < passage.length_m - margin);
    }
  }

  // The scans.
  const std::vector<Eigen::Vector3f> directions = sim::beam_directions(options.lidar);
  std::vector<Eigen::Matrix3d> scatter(keys.size());
  std::vector<std::uint64_t> rays(keys.size(), 0);
  auto clouds = std::make_shared<std::map<Key, std::shared_ptr<const PointCloud>>>();
  if (!sink) {
    for (const Key key : keys) (*clouds)[key] = nullptr;
  }
  ThreadPool pool(options.threads);
  {
    Reporter scan_report(progress, "casting scans", keys.size());
    pool.for_each(keys.size(), [&](std::size_t i) {
      if (stop.stop_requested()) return;
      sim::Sweep s =
          sim::sweep(caster, directions, options.lidar, truth[i], combine_seeds(stream(kSweeps), keys[i]));
      scatter[i] = s.normal_scatter;
      rays[i] = s.rays;
      if (options.scans == ScanKind::kLamp) {
        s.cloud = sim::thin(s.cloud, options.scan_points, combine_seeds(stream(kThinning), keys[i]));
      }
      if (sink) {
        sink(keys[i], s.cloud);
      } else {
        s.cloud.points.shrink_to_fit();
        clouds->at(keys[i]) = std::make_shared<const PointCloud>(std::move(s.cloud));
      }
      scan_report.step();
    });
  }
  stop_here(stop);
  for (const std::uint64_t n : rays) result.rays += n;
  for (const Eigen::Matrix3d& s : scatter) {
    result.observability.push_back(
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(s, Eigen::EigenvaluesOnly).eigenvalues()[0]);
  }
  if (!sink) {
    // The clouds live in the loader; the store itself keeps nothing.
    mission.scans = std::make_shared<ScanStore>(
        keys, [clouds](Key key) { return clouds->at(key); }, 0);
  }

  // The graph.
  mission.start_ns = parameters::kEpochSeconds * 1'000'000'000LL;
  for (std::size_t r = 0; r < robots; ++r) {
    const auto [first, nodes] = spans[r];
    const std::vector<Eigen::Isometry3d> own_truth(
        truth.begin() + static_cast<std::ptrdiff_t>(first),
        truth.begin() + static_cast<std::ptrdiff_t>(first + nodes));
    const std::vector<Eigen::Matrix3d> own_scatter(
        scatter.begin() + static_cast<std::ptrdiff_t>(first),
        scatter.begin() + static_cast<std::ptrdiff_t>(first + nodes));
    const bool legs = on_legs(options.world, static_cast<int>(r));
    const auto steps =
        sim::measure_odometry(own_truth, own_scatter, legs ? parameters::kLegged : parameters::kGround,
                              combine_seeds(stream(kDrift), r));
    Rng rng(combine_seeds(stream(kAlignment), r));
    Vector6d sigmas, error;
    sigmas << Eigen::Vector3d::Constant(options.prior_position_sigma_m), options.prior_tilt_sigma_rad,
        options.prior_tilt_sigma_rad, options.prior_yaw_sigma_rad;
    for (int k = 0; k < 6; ++k) error[k] = sigmas[k] * rng.normal();
    PriorFactor prior;
    prior.key = keys[first];
    prior.pose = own_truth.front() * se3::exp(error);
    prior.information = Matrix6d(sigmas.cwiseAbs2().cwiseInverse().asDiagonal());

    Eigen::Isometry3d pose = prior.pose;
    for (std::size_t k = 0; k < nodes; ++k) {
      if (k > 0) pose = se3::normalized(pose * steps[k - 1]);
      Node node;
      node.key = keys[first + k];
      node.pose = pose;
      node.stamp_ns = mission.start_ns + std::llround(team[r].time_s[k] * 1e3) * 1'000'000LL;
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = own_truth[k];
    }
    mission.graph.add_prior(prior);
    for (std::size_t k = 1; k < nodes; ++k) {
      Edge edge;
      edge.from = keys[first + k - 1];
      edge.to = keys[first + k];
      edge.T_from_to = steps[k - 1];
      edge.information =
          sim::stated_information((own_truth[k].translation() - own_truth[k - 1].translation()).norm());
      edge.kind = EdgeKind::kOdometry;
      mission.graph.add_edge(edge);
    }
  }

  // The radio.
  const auto node_key = [&](std::size_t robot, std::size_t node) { return keys[spans[robot].first + node]; };
  for (std::size_t d = 0; d < drops.size(); ++d) {
    const std::string name = "beacon-" + std::to_string(d + 1);
    const Key key = node_key(drops[d].robot, drops[d].node);
    mission.beacons.push_back({name, drops[d].robot, key, mission.graph.node(key).stamp_ns});
    result.beacons.push_back({name, sim::beacon_position(team, drops[d])});
  }
  if (!drops.empty()) {
    Reporter radio_report(progress, "hearing beacons", 1);
    for (const sim::Heard& h : sim::listen(caster, options.world, team, drops, stream(kRadio), pool)) {
      for (std::size_t k = 0; k < h.receive_dbm.size(); ++k) {
        mission.radio.push_back({node_key(h.robot, h.node), mission.beacons[h.drop].beacon,
                                 parameters::kTransmitDbm, std::to_string(k), h.receive_dbm[k]});
        result.readings.push_back({h.distance_m, h.walls});
      }
    }
    radio_report.step();
  }
  stop_here(stop);

  mission.name = enum_name(options.world) + "-" + std::to_string(seed);
  SimulationOptions told = options;
  told.threads = 0;  // how many threads made the mission is nowhere to be seen
  Json provenance = Json::object();
  provenance["generator"] = "loopwise simulate";
  provenance["version"] = std::string(version());
  provenance["seed"] = std::to_string(seed);
  provenance["options"] = to_json(told);
  provenance["options"].erase("threads");
  provenance["parameters_sha256"] = std::string(simulation_parameters_hash());
  mission.provenance_json = provenance.dump();
  return result;
}

SimulatedMission simulate_to_folder(const std::filesystem::path& folder, const SimulationOptions& options,
                                    std::uint64_t seed, const ProgressCallback& progress,
                                    const StopToken& stop) {
  validate_simulation(options);
  const bool existed = std::filesystem::exists(folder);
  const MissionWriter writer(folder);
  try {
    SimulatedMission made = simulate(options, seed, progress, stop,
                                     [&](Key key, const PointCloud& cloud) { writer.add_scan(key, cloud); });
    writer.finish(made.mission);
    made.mission.scans = read_mission(folder).scans;
    made.mission.path = folder;
    return made;
  } catch (...) {
    // The folder was empty or absent before: nothing of others is lost.
    std::error_code ignored;
    if (existed) {
      for (const auto& entry : std::filesystem::directory_iterator(folder, ignored)) {
        std::filesystem::remove_all(entry.path(), ignored);
      }
    } else {
      std::filesystem::remove_all(folder, ignored);
    }
    throw;
  }
}

}  // namespace loopwise
