// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Which method suffers how much if a mission is worse than its data say: simulated missions are replayed as
/// they are and with one disturbance each. Prints a table; a file keeps every run, so that an interrupted
/// study continues where it was.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/prioritization/method.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/registration.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/simulation/simulate.hpp>

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr WorldKind kWorlds[] = {WorldKind::kTunnel, WorldKind::kUrban, WorldKind::kFinals, WorldKind::kMine};
constexpr const char* kMethods[] = {"random", "obs", "gi", "expected"};
constexpr int kRobots = 3;
constexpr double kLengthM = 900.0;
constexpr int kWorkers = 2;
constexpr int kFewPoints = 300;

/// What is wrong with a mission.
struct Disturbance {
  const char* name;
  double noise_m = 0.0, noise_rad = 0.0;  ///< Added to the odometry, after 1 m; its information falls.
  double optimism = 1.0;       ///< Stated deviations of the odometry are this many times too small.
  bool few_points = false;     ///< Scans have kFewPoints points.
  double false_accepts = 0.0;  ///< Share of the refused pairs that become closures of a wrong pose.
  double jitter_s = 0.0;       ///< Stamps are wrong by up to this much.
  bool robot_lost = false;     ///< The last robot sends nothing after half of its key frames.
};

constexpr Disturbance kDisturbances[] = {
    {"none"},
    {"odometry with noise of 0.02 m and 0.004 rad after 1 m", 0.02, 0.004},
    {"odometry with noise of 0.06 m and 0.012 rad after 1 m", 0.06, 0.012},
    {"odometry stated three times too certain", 0.0, 0.0, 3.0},
    {"scans of 300 points", 0.0, 0.0, 1.0, true},
    {"a tenth of the refused pairs accepted", 0.0, 0.0, 1.0, false, 0.1},
    {"stamps wrong by up to 2 s", 0.0, 0.0, 1.0, false, 0.0, 2.0},
    {"one robot lost half way", 0.0, 0.0, 1.0, false, 0.0, 0.0, true},
};

/// Accepts some of the pairs that another registrar refuses, at poses that are wrong by some metres.
class Careless : public Registrar {
 public:
  Careless(std::shared_ptr<const Registrar> careful, double share)
      : careful_(std::move(careful)), share_(share) {}
  [[nodiscard]] std::string_view name() const override { return "careless"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    RegistrationResult result = careful_->compute(task);
    Rng rng(task.seed);
    if (result.verified() || !task.guess_from_to || rng.uniform() >= share_) return result;
    Vector6d error;
    for (int i = 0; i < 6; ++i) error[i] = (i < 3 ? 3.0 : 0.2) * rng.normal();
    LoopClosure closure{task.candidate.from, task.candidate.to, *task.guess_from_to * se3::exp(error)};
    closure.covariance.diagonal() << 1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5;
    result.reason = RejectionReason::kNone;
    result.message.clear();
    result.T_from_to = closure.T_from_to;
    result.closure = closure;
    return result;
  }

 private:
  std::shared_ptr<const Registrar> careful_;
  double share_;
};

/// The graph with changed nodes; those for which `change` returns false, and their factors, are left out.
/// For graphs without ranges and gravity.
template <class Change>
PoseGraph with_nodes(const PoseGraph& graph, Change&& change) {
  PoseGraph out;
  std::map<Key, bool> in;
  for (Node node : graph.nodes()) {
    const Key key = node.key;
    if ((in[key] = change(node))) out.add_node(node);
  }
  for (const PriorFactor& prior : graph.priors()) {
    if (in[prior.key]) out.add_prior(prior);
  }
  for (const Edge& edge : graph.edges()) {
    if (in[edge.from] && in[edge.to]) out.add_edge(edge);
  }
  return out;
}

/// Without the later half of the last robot's key frames.
PoseGraph without_lost(const PoseGraph& graph, const Robots& robots) {
  const std::size_t last = robots.size() - 1;
  std::size_t of_last = 0, seen = 0;
  for (const Node& node : graph.nodes()) of_last += robots.of(node.key) == last ? 1 : 0;
  return with_nodes(graph,
                    [&](const Node& node) { return robots.of(node.key) != last || 2 * seen++ < of_last; });
}

Mission disturbed(Mission mission, const Disturbance& by, std::uint64_t seed) {
  PoseGraph& graph = mission.graph;
  for (std::size_t k = 0; k < graph.edges().size(); ++k) {
    graph.set_information(k, graph.edges()[k].information * (by.optimism * by.optimism));
  }
  Rng rng(seed);
  if (by.jitter_s > 0.0) {
    graph = with_nodes(graph, [&](Node& node) {
      const std::int64_t error_ns = std::llround(1e9 * rng.uniform(-by.jitter_s, by.jitter_s));
      node.stamp_ns = std::max(mission.start_ns, node.stamp_ns + error_ns);
      return true;
    });
  }
  if (by.robot_lost) graph = without_lost(graph, mission.robots);
  return mission;
}

/// The figures of a run that the table needs.
struct Run {
  double error_m = 0.0;         ///< Mean position error after the best rigid motion.
  double without_lost_m = 0.0;  ///< The same without the nodes that a lost robot does not send.
  double wrong = 0.0;           ///< Closures kept that are wrong by more than 0.5 m or 0.05 rad.
};

bool is_wrong(const Edge& edge, const PosesByKey& truth) {
  const auto error = edge.T_from_to.inverse() * truth.at(edge.from).inverse() * truth.at(edge.to);
  return error.translation().norm() > 0.5 || se3::log(error).tail<3>().norm() > 0.05;
}

/// \param seed of the noise and of all other draws
Run run_of(const Mission& mission, const Disturbance& by, const std::string& method, std::uint64_t seed) {
  ReplayOptions options;
  options.engine.guess = GuessSource::kOdometry;
  options.engine.seed = seed;
  options.prioritization.method = parse_method(method);
  options.cost.workers = kWorkers;
  options.odometry_noise_m_per_m = by.noise_m;
  options.odometry_noise_rad_per_m = by.noise_rad;
  Registration registration = make_registration(options.registration, mission.scans->loader());
  if (by.false_accepts > 0.0)
    registration.registrar = std::make_shared<Careless>(registration.registrar, by.false_accepts);
  ThreadPool threads(1);
  const ReplayResult result = MissionReplay(mission, options, registration).run(threads);
  Run run;
  const auto error = [&](const PoseGraph& estimate) {
    return evaluate_trajectory(poses_by_key(estimate), mission.ground_truth, Alignment::kSe3, mission.robots)
        .ate_m.mean;
  };
  run.error_m = error(result.graph);
  run.without_lost_m = by.robot_lost ? run.error_m : error(without_lost(result.graph, mission.robots));
  for (const Edge& edge : result.graph.edges()) {
    const bool kept = edge.kind == EdgeKind::kLoopClosure && edge.weight > 0.5;
    run.wrong += kept && is_wrong(edge, mission.ground_truth) ? 1.0 : 0.0;
  }
  return run;
}

/// The runs of a study by disturbance, method and mission, in a file that grows with each of them. A file of
/// another version of the code is begun anew.
class Runs {
 public:
  explicit Runs(fs::path file) : file_(std::move(file)) {
    const std::string version = "version " + replay_code_version();
    std::ifstream in(file_);
    std::string line;
    if (std::getline(in, line) && line == version) {
      while (std::getline(in, line)) read(line);
    } else {
      write(version, std::ios::trunc);
    }
  }
  [[nodiscard]] bool has(const std::string& name) const { return runs_.count(name) > 0; }
  [[nodiscard]] const Run& of(const std::string& name) const { return runs_.at(name); }
  void add(const std::string& name, const Run& run) {
    runs_[name] = run;
    std::ostringstream line;
    line.precision(17);
    line << name << "; " << run.error_m << ' ' << run.without_lost_m << ' ' << run.wrong << " .";
    write(line.str(), std::ios::app);
    std::fprintf(stderr, "%s: %.3f m, %g wrong\n", name.c_str(), run.error_m, run.wrong);
  }

 private:
  /// A line that an interruption has cut lacks the point at its end.
  void read(const std::string& line) {
    std::istringstream values(line);
    std::string name, end;
    Run run;
    if (std::getline(values, name, ';') && values >> run.error_m >> run.without_lost_m >> run.wrong >> end &&
        end == ".")
      runs_[name] = run;
  }
  void write(const std::string& line, std::ios::openmode mode) const {
    std::ofstream out(file_, mode);
    if (mode == std::ios::app) out << '\n';  // after a line that was cut
    out << line << std::endl;
    if (!out) throw IoError(file_.string(), "cannot be written");
  }

  fs::path file_;
  std::map<std::string, Run> runs_;
};

std::string name_of(const Disturbance& by, const std::string& method, const std::string& mission) {
  return std::string(by.name) + ", " + method + ", " + mission;
}

Mission simulated(WorldKind world, std::uint64_t seed, bool few_points) {
  SimulationOptions options;
  options.world = world;
  options.robots = kRobots;
  options.length_m = kLengthM;
  options.radio = false;
  if (few_points) options.scan_points = kFewPoints;
  return simulate(options, seed).mission;
}

/// Computes what the file lacks for one mission.
void complete(WorldKind world, std::uint64_t seed, Runs& runs) {
  const std::string name = enum_name(world) + "-" + std::to_string(seed);
  const std::uint64_t draws = combine_seeds(seed, static_cast<std::uint64_t>(world));
  for (const bool few_points : {false, true}) {
    std::vector<std::pair<const Disturbance*, std::string>> open;
    for (const Disturbance& by : kDisturbances) {
      for (const char* method : kMethods) {
        if (by.few_points == few_points && !runs.has(name_of(by, method, name)))
          open.emplace_back(&by, method);
      }
    }
    if (open.empty()) continue;
    const Mission mission = simulated(world, seed, few_points);
    for (const auto& [by, method] : open) {
      runs.add(name_of(*by, method, name), run_of(disturbed(mission, *by, draws), *by, method, draws));
    }
  }
}

/// A row: geometric means over the missions, the ratio to the undisturbed runs, and wrong closures kept.
void print_row(const Disturbance& by, const std::vector<std::string>& missions, const Runs& runs) {
  std::printf("| %s |", by.name);
  for (const char* method : kMethods) {
    double log_error = 0.0, log_ratio = 0.0, wrong = 0.0;
    for (const std::string& mission : missions) {
      const Run &run = runs.of(name_of(by, method, mission)),
                &plain = runs.of(name_of(kDisturbances[0], method, mission));
      log_error += std::log(run.error_m);
      log_ratio += std::log(run.error_m / (by.robot_lost ? plain.without_lost_m : plain.error_m));
      wrong += run.wrong;
    }
    const double n = static_cast<double>(missions.size());
    std::printf(" %.3f m, × %.2f, %g |", std::exp(log_error / n), std::exp(log_ratio / n), wrong);
  }
  std::printf("\n");
}

int run(const std::vector<std::string>& arguments) {
  if (arguments.size() < 2) throw OptionError("usage: loopwise_robustness_study FILE SEED...");
  Runs runs(arguments[0]);
  std::vector<std::string> missions;
  for (auto argument = arguments.begin() + 1; argument != arguments.end(); ++argument) {
    const std::uint64_t seed = std::stoull(*argument);
    for (const WorldKind world : kWorlds) {
      complete(world, seed, runs);
      missions.push_back(enum_name(world) + "-" + std::to_string(seed));
    }
  }
  std::printf("| disturbance |");
  for (const char* method : kMethods) std::printf(" %s |", method);
  std::printf("\n| --- |");
  for (std::size_t i = 0; i < std::size(kMethods); ++i) std::printf(" --- |");
  std::printf("\n");
  for (const Disturbance& by : kDisturbances) print_row(by, missions, runs);
  return 0;
}

}  // namespace
}  // namespace loopwise

int main(int argc, char** argv) {
  try {
    return loopwise::run(std::vector<std::string>(argv + 1, argv + argc));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "robustness study: %s\n", error.what());
    return 1;
  }
}
