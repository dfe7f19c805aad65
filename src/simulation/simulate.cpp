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

/// Separate streams of random numbers: more draws from one stream do not change the others.
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
  if (stop.stop_requested()) throw SimulationStopped("stopped before the mission was complete");
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

namespace {

/// Makes one mission, step by step.
class Maker {
 public:
  Maker(const SimulationOptions& given, std::uint64_t seed, const ProgressCallback& progress,
        const StopToken& stop, const ScanSink& sink)
      : seed_(seed), progress_(progress), stop_(stop), sink_(sink) {
    result_.options = resolved(given);
    result_.seed = seed;
  }

  SimulatedMission make() {
    build_world();
    drive_team();
    stop_here(stop_);
    lay_out_radio();
    note_truth();
    ThreadPool pool(options().threads);
    cast_scans(pool);
    stop_here(stop_);
    mission().start_ns = parameters::kEpochSeconds * 1'000'000'000LL;
    for (std::size_t r = 0; r < team_.size(); ++r) add_robot_graph(r);
    receive_beacons(pool);
    stop_here(stop_);
    describe();
    return std::move(result_);
  }

 private:
  [[nodiscard]] const SimulationOptions& options() const { return result_.options; }
  [[nodiscard]] Mission& mission() { return result_.mission; }
  [[nodiscard]] std::uint64_t stream(Stream which) const { return combine_seeds(seed_, which); }
  [[nodiscard]] bool legs(std::size_t robot) const {
    return on_legs(options().world, static_cast<int>(robot));
  }
  [[nodiscard]] Key node_key(std::size_t robot, std::size_t node) const {
    return keys_[spans_[robot].first + node];
  }

  void build_world();
  void drive_team();
  void lay_out_radio();
  void note_truth();
  void cast_scans(ThreadPool& pool);
  [[nodiscard]] PriorFactor first_prior(std::size_t robot, const Eigen::Isometry3d& truth) const;
  void add_robot_graph(std::size_t robot);
  void receive_beacons(ThreadPool& pool);
  void describe();

  std::uint64_t seed_;
  const ProgressCallback& progress_;
  const StopToken& stop_;
  const ScanSink& sink_;
  SimulatedMission result_;
  World world_;
  std::unique_ptr<const RayCaster> caster_;
  std::vector<sim::Drive> team_;
  std::vector<Span> spans_;
  std::vector<Key> keys_;  ///< Of all nodes, robot by robot, as in the next two members.
  std::vector<Eigen::Isometry3d> truth_;
  std::vector<Eigen::Matrix3d> scatter_;
  std::vector<sim::Drop> drops_;
};

void Maker::build_world() {
  Reporter report(progress_, "building the world", 1);
  world_ = make_world(options().world, options().length_m, seed_, options().threads, stop_);
  stop_here(stop_);
  caster_ = std::make_unique<const RayCaster>(world_.mesh);
  report.step();
}

void Maker::drive_team() {
  const double length = options().length_m / options().robots;
  const auto routes = sim::plan_routes(world_.routes, options().robots, length, stream(kRoutes));
  const auto count = static_cast<std::size_t>(std::floor(length / options().node_spacing_m)) + 1;
  team_.resize(static_cast<std::size_t>(options().robots));
  std::vector<Robot> names;
  for (std::size_t r = 0; r < team_.size(); ++r) {
    team_[r].waypoints =
        sim::drive(world_.routes, routes[r], legs(r) ? parameters::kLegged : parameters::kGround,
                   options().node_spacing_m, count, combine_seeds(stream(kDriving), r));
    for (const sim::Waypoint& w : team_[r].waypoints) {
      team_[r].time_s.push_back(w.time_s + parameters::kStartDelaySeconds * static_cast<double>(r));
    }
    const char character = static_cast<char>('a' + r);
    names.push_back(robot_of_character(character, (legs(r) ? "legged" : "wheeled") + std::to_string(r + 1)));
    spans_.push_back({keys_.size(), team_[r].waypoints.size()});
    for (std::size_t k = 0; k < team_[r].waypoints.size(); ++k) keys_.push_back(make_key(character, k));
  }
  mission().robots = Robots(names);
}

void Maker::lay_out_radio() {
  const sim::Distances ways(world_.routes);
  if (options().radio) drops_ = sim::drop_beacons(world_.routes, ways, team_, stream(kDrops));
  if (options().communication_gaps) {
    mission().gaps = sim::communication_gaps(world_.routes, ways, team_, drops_, stream(kOutages));
  }
}

void Maker::note_truth() {
  for (const sim::Drive& drive : team_) {
    for (const sim::Waypoint& w : drive.waypoints) {
      truth_.push_back(w.T_world_body);
      const auto& passage = world_.routes.passages[w.passage];
      const double margin = std::max(3.0, passage.half_width_m + 2.0);
      result_.in_corridor.push_back(passage.corridor && w.along_m > margin &&
                                    w.along_m < passage.length_m - margin);
    }
  }
}

void Maker::cast_scans(ThreadPool& pool) {
  const std::vector<Eigen::Vector3f> directions = sim::beam_directions(options().lidar);
  scatter_.resize(keys_.size());
  std::vector<std::uint64_t> rays(keys_.size(), 0);
  auto clouds = std::make_shared<std::map<Key, std::shared_ptr<const PointCloud>>>();
  if (!sink_) {
    for (const Key key : keys_) (*clouds)[key] = nullptr;
  }
  Reporter report(progress_, "casting scans", keys_.size());
  pool.for_each(keys_.size(), [&](std::size_t i) {
    if (stop_.stop_requested()) return;
    sim::Sweep s = sim::sweep(*caster_, directions, options().lidar, truth_[i],
                              combine_seeds(stream(kSweeps), keys_[i]));
    scatter_[i] = s.normal_scatter;
    rays[i] = s.rays;
    if (options().scans == ScanKind::kLamp) {
      s.cloud = sim::thin(s.cloud, options().scan_points, combine_seeds(stream(kThinning), keys_[i]));
    }
    if (sink_) {
      sink_(keys_[i], s.cloud);
    } else {
      s.cloud.points.shrink_to_fit();
      clouds->at(keys_[i]) = std::make_shared<const PointCloud>(std::move(s.cloud));
    }
    report.step();
  });
  stop_here(stop_);
  for (const std::uint64_t n : rays) result_.rays += n;
  for (const Eigen::Matrix3d& s : scatter_) {
    result_.observability.push_back(
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(s, Eigen::EigenvaluesOnly).eigenvalues()[0]);
  }
  if (!sink_) {
    // The loader holds the clouds, so the store caches nothing.
    mission().scans = std::make_shared<ScanStore>(
        keys_, [clouds](Key key) { return clouds->at(key); }, 0);
  }
}

PriorFactor Maker::first_prior(std::size_t robot, const Eigen::Isometry3d& truth) const {
  Rng rng(combine_seeds(stream(kAlignment), robot));
  Vector6d sigmas, error;
  sigmas << Eigen::Vector3d::Constant(options().prior_position_sigma_m), options().prior_tilt_sigma_rad,
      options().prior_tilt_sigma_rad, options().prior_yaw_sigma_rad;
  for (int k = 0; k < 6; ++k) error[k] = sigmas[k] * rng.normal();
  PriorFactor prior;
  prior.key = node_key(robot, 0);
  prior.pose = truth * se3::exp(error);
  prior.information = Matrix6d(sigmas.cwiseAbs2().cwiseInverse().asDiagonal());
  return prior;
}

/// Adds nodes at the poses of the drifting odometry, the odometry edges, and the prior of the first node.
void Maker::add_robot_graph(std::size_t r) {
  const auto [first, nodes] = spans_[r];
  const auto begin = static_cast<std::ptrdiff_t>(first), end = static_cast<std::ptrdiff_t>(first + nodes);
  const std::vector<Eigen::Isometry3d> truth(truth_.begin() + begin, truth_.begin() + end);
  const std::vector<Eigen::Matrix3d> scatter(scatter_.begin() + begin, scatter_.begin() + end);
  const auto steps = sim::measure_odometry(
      truth, scatter, legs(r) ? parameters::kLegged : parameters::kGround, combine_seeds(stream(kDrift), r));
  const PriorFactor prior = first_prior(r, truth.front());

  Eigen::Isometry3d pose = prior.pose;
  for (std::size_t k = 0; k < nodes; ++k) {
    if (k > 0) pose = se3::normalized(pose * steps[k - 1]);
    Node node;
    node.key = keys_[first + k];
    node.pose = pose;
    node.stamp_ns = mission().start_ns + std::llround(team_[r].time_s[k] * 1e3) * 1'000'000LL;
    mission().graph.add_node(node);
    mission().ground_truth[node.key] = truth[k];
  }
  mission().graph.add_prior(prior);
  for (std::size_t k = 1; k < nodes; ++k) {
    Edge edge;
    edge.from = keys_[first + k - 1];
    edge.to = keys_[first + k];
    edge.T_from_to = steps[k - 1];
    edge.information = sim::stated_information((truth[k].translation() - truth[k - 1].translation()).norm());
    edge.kind = EdgeKind::kOdometry;
    mission().graph.add_edge(edge);
  }
}

void Maker::receive_beacons(ThreadPool& pool) {
  for (std::size_t d = 0; d < drops_.size(); ++d) {
    const std::string name = "beacon-" + std::to_string(d + 1);
    const Key key = node_key(drops_[d].robot, drops_[d].node);
    mission().beacons.push_back({name, drops_[d].robot, key, mission().graph.node(key).stamp_ns});
    result_.beacons.push_back({name, sim::beacon_position(team_, drops_[d])});
  }
  if (drops_.empty()) return;
  Reporter report(progress_, "simulating radio readings", 1);
  for (const sim::Reception& h :
       sim::receptions_of(*caster_, options().world, team_, drops_, stream(kRadio), pool)) {
    for (std::size_t k = 0; k < h.receive_dbm.size(); ++k) {
      mission().radio.push_back({node_key(h.robot, h.node), mission().beacons[h.drop].beacon,
                                 parameters::kTransmitDbm, std::to_string(k), h.receive_dbm[k]});
      result_.readings.push_back({h.distance_m, h.walls});
    }
  }
  report.step();
}

void Maker::describe() {
  mission().name = enum_name(options().world) + "-" + std::to_string(seed_);
  SimulationOptions stated = options();
  stated.threads = 0;  // the mission does not depend on the number of threads
  Json provenance = Json::object();
  provenance["generator"] = "loopwise simulate";
  provenance["version"] = std::string(version());
  provenance["seed"] = std::to_string(seed_);
  provenance["options"] = to_json(stated);
  provenance["options"].erase("threads");
  provenance["parameters_sha256"] = std::string(simulation_parameters_hash());
  mission().provenance_json = provenance.dump();
}

}  // namespace

SimulatedMission simulate(const SimulationOptions& options, std::uint64_t seed,
                          const ProgressCallback& progress, const StopToken& stop, const ScanSink& sink) {
  return Maker(options, seed, progress, stop, sink).make();
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
    // The folder was empty or absent before, so only files of this mission are removed.
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
