// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <atomic>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/replay.hpp>

#include "testing_mission.hpp"

namespace loopwise::replay_test {
namespace {

using testing::OracleRegistrar;
using testing::two_circles;
using testing::with_landmark;

ReplayOptions fast_config(const std::string& method = "random") {
  ReplayOptions config;
  config.prioritization.method = parse_method(method);
  config.batch = 20;
  config.prioritization.observability.min_sum = 0.0;
  return config;
}

// It keeps a reference to its mission.
static_assert(std::is_constructible_v<MissionReplay, Mission&, ReplayOptions, Registration>);
static_assert(!std::is_constructible_v<MissionReplay, Mission, ReplayOptions, Registration>);

struct Recorded {
  ReplayResult result;
  std::vector<Json> journal;
  std::vector<std::string> lines;
  std::vector<RegistrationResult> outcomes;
};

Recorded run_replay(const Mission& mission, const ReplayOptions& config, int threads = 1,
                    const KnownOutcomes& known = {}, std::shared_ptr<const Registrar> registrar = nullptr,
                    const StopToken& stop = {}, const ProgressCallback& progress = {}) {
  if (!registrar) registrar = std::make_shared<OracleRegistrar>(mission.ground_truth);
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
  Recorded recorded;
  ReplayHooks hooks;
  hooks.journal = [&](const std::string& line) {
    recorded.lines.push_back(line);
    recorded.journal.push_back(parse_json(line, "journal"));
  };
  hooks.outcome = [&](const RegistrationResult& result) { recorded.outcomes.push_back(result); };
  hooks.stop = stop;
  hooks.progress = progress;
  ThreadPool pool(threads);
  recorded.result = MissionReplay(mission, config, {features, registrar}).run(pool, hooks, known);
  return recorded;
}

std::size_t number(const Json& account, const char* name) {
  return account.at(name).get<std::size_t>();
}

/// The first robot drops a beacon at its third node; both pass it on their second round.
Mission with_radio(Mission mission) {
  mission.beacons.push_back({"beacon", 0, make_key('a', 2), mission.graph.node(make_key('a', 2)).stamp_ns});
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 30; i < 34; ++i) {
      for (const char* receiver : {"0", "1"}) {
        mission.radio.push_back({make_key(robot, i), "beacon", 28.0, receiver, -20.0});
      }
    }
  }
  return mission;
}

/// Mean distance of the poses from the truth, no alignment.
double mean_error(const Mission& mission, const PoseGraph& graph) {
  double sum = 0.0;
  for (const Node& node : graph.nodes()) {
    if (mission.robots.is_landmark(node.key)) continue;
    sum += (node.pose.translation() - mission.ground_truth.at(node.key).translation()).norm();
  }
  return sum / static_cast<double>(mission.ground_truth.size());
}

double mean_error(const Mission& mission, const std::vector<Eigen::Isometry3d>& poses,
                  const PoseGraph& graph) {
  PoseGraph copy = graph;
  copy.set_poses(poses);
  return mean_error(mission, copy);
}

}  // namespace

TEST_CASE("replay: the account balances at every event of the journal, for every method",
          "[replay][replay]") {
  const Mission mission = with_radio(two_circles());
  for (const std::string& method : method_names()) {
    CAPTURE(method);
    const Recorded run = run_replay(mission, fast_config(method));
    REQUIRE(run.journal.front().at("event") == "start");
    REQUIRE(run.journal.back().at("event") == "end");
    double time = 0.0;
    std::size_t results = 0, key_frames = 0;
    for (const Json& line : run.journal) {
      const Json& a = line.at("account");
      REQUIRE(number(a, "generated") == number(a, "pruned") + number(a, "expired") + number(a, "waiting") +
                                            number(a, "pending") + number(a, "in_flight") +
                                            number(a, "computed"));
      REQUIRE(line.at("time_s").get<double>() >= time);
      time = line.at("time_s").get<double>();
      results += line.at("event") == "result" ? 1 : 0;
      key_frames += line.at("event") == "key_frame" ? 1 : 0;
      REQUIRE(number(a, "computed") == results);
    }
    REQUIRE(key_frames == mission.graph.nodes().size());
    REQUIRE(results == run.result.computed.size());
    REQUIRE(run.result.accounting.balanced());
    REQUIRE(run.result.accounting.in_flight == 0);
    REQUIRE(run.result.accounting.waiting == 0);
    REQUIRE((results == 0) == (method == "odom"));
  }
}

TEST_CASE("replay: an outcome that cannot be kept ends the run, it does not become a rejection",
          "[replay][replay][error]") {
  const Mission mission = two_circles();
  const ReplayOptions config = fast_config("baseline");
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
  ReplayHooks hooks;
  std::size_t kept = 0;
  hooks.outcome = [&](const RegistrationResult&) {
    if (++kept == 3) throw InputError("outcomes.jsonl: cannot be written");
  };
  for (const int threads : {1, 2}) {
    kept = 0;
    ThreadPool pool(threads);
    const MissionReplay replay(mission, config,
                               {features, std::make_shared<OracleRegistrar>(mission.ground_truth)});
    REQUIRE_THROWS_WITH(replay.run(pool, hooks), Contains("cannot be written"));
  }
}

TEST_CASE("replay: the same bits for any number of threads", "[replay][replay][threads]") {
  const Mission mission = with_radio(two_circles());
  for (const char* method : {"random", "full", "obs+gi+rssi"}) {
    const Recorded one = run_replay(mission, fast_config(method), 1);
    for (const int threads : {2, 4}) {
      const Recorded many = run_replay(mission, fast_config(method), threads);
      REQUIRE(many.lines == one.lines);
      for (std::size_t i = 0; i < one.result.graph.nodes().size(); ++i) {
        REQUIRE((many.result.graph.nodes()[i].pose.matrix().array() ==
                 one.result.graph.nodes()[i].pose.matrix().array())
                    .all());
      }
    }
  }
}

TEST_CASE("replay: closures bring the estimate to the truth, false ones get no weight", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config();
  config.after_mission = true;
  config.batch = 100;
  const Recorded run = run_replay(mission, config);
  const double odometry = mean_error(mission, run.result.odometry, run.result.graph);
  const double optimized = mean_error(mission, run.result.graph);
  CAPTURE(odometry, optimized);
  REQUIRE(odometry > 0.4);
  REQUIRE(optimized < 0.1);  // measured 0.02; half the odometry's error if the back end did nothing useful
  std::size_t wrong = 0, kept = 0, right = 0;
  for (const ComputedCandidate& c : run.result.computed) {
    if (!c.result.verified()) {
      REQUIRE(c.weight == 0.0);
      continue;
    }
    const LoopClosure& closure = *c.result.closure;
    const Eigen::Isometry3d truth =
        mission.ground_truth.at(closure.from).inverse() * mission.ground_truth.at(closure.to);
    const bool is_false = (truth.inverse() * closure.T_from_to).translation().norm() > 1.0;
    wrong += is_false ? 1 : 0;
    kept += !is_false && c.weight > 0.5 ? 1 : 0;
    right += is_false ? 0 : 1;
    if (is_false) REQUIRE(c.weight < 0.5);
  }
  // The threshold is to keep 99 % of the true ones; measured: 885 of 894.
  REQUIRE(static_cast<double>(kept) > 0.97 * static_cast<double>(right));
  REQUIRE(wrong > 10);
}

TEST_CASE("replay: the cost model decides how much is computed", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config();
  config.cost.workers = 1;
  config.cost.registration_time_s = 2.0;
  const Recorded slow = run_replay(mission, config);
  // The mission lasts 78.5 s; at one registration every 2 s no more than 39 fit.
  REQUIRE(slow.result.mission_time_s == Approx(78.5));
  REQUIRE(slow.result.computed.size() <= 39);
  REQUIRE(slow.result.computed.size() >= 20);
  for (std::size_t i = 1; i < slow.result.computed.size(); ++i) {
    REQUIRE(slow.result.computed[i].mission_time_s - slow.result.computed[i - 1].mission_time_s >=
            2.0 - 1e-9);
  }
  // Registrations that exceed the modelled time are not computed either.
  REQUIRE(slow.outcomes.size() == slow.result.computed.size());

  config.cost.workers = 4;
  REQUIRE(run_replay(mission, config).result.computed.size() > 2 * slow.result.computed.size());

  config.max_registrations = 7;
  const Recorded bounded = run_replay(mission, config);
  REQUIRE(bounded.result.computed.size() == 7);
  REQUIRE(bounded.result.graph.nodes().size() == mission.graph.nodes().size());

  config.max_registrations = 0;
  config.after_mission = true;
  config.batch = 200;
  const Recorded all = run_replay(mission, config);
  REQUIRE(all.result.accounting.pending == 0);
  REQUIRE(all.result.computed.size() == all.result.accounting.queued());
  REQUIRE(all.result.mission_time_s > 78.5);
}

/// The oracle, with a duration for each pair, as a machine would measure it.
class TimedRegistrar final : public Registrar {
 public:
  explicit TimedRegistrar(const Mission& mission, double features_s = 0.5)
      : oracle_(mission.ground_truth), features_s_(features_s) {}
  std::string_view name() const override { return "timed"; }
  RegistrationResult compute(const RegistrationTask& task) const override {
    RegistrationResult result = oracle_.compute(task);
    result.features_s = features_s_;
    result.refine_s = Rng(task.seed).uniform(0.0, 3.0);
    return result;
  }

 private:
  OracleRegistrar oracle_;
  double features_s_;
};

TEST_CASE("replay: measured times that are negative or not finite are refused", "[replay][replay][error]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config();
  config.cost.measured_time = true;
  for (const double none : {std::nan(""), -100.0}) {
    const auto registrar = std::make_shared<TimedRegistrar>(mission, none);
    REQUIRE_THROWS_WITH(run_replay(mission, config, 2, {}, registrar), Contains("cost.measured_time"));
  }
}

TEST_CASE("replay: with measured times each worker is busy for as long as it took", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config();
  config.cost.measured_time = true;
  config.cost.workers = 3;
  config.max_registrations = 150;  // more than fit with these times
  const auto registrar = std::make_shared<TimedRegistrar>(mission);
  const Recorded run = run_replay(mission, config, 2, {}, registrar);
  REQUIRE(run.result.accounting.balanced());
  REQUIRE(run.result.accounting.in_flight == 0);
  REQUIRE(run.result.computed.size() > 60);  // 75 s, 3 workers, 2 s each
  REQUIRE(run.result.computed.size() < 120);
  double busy = 0.0;
  for (const ComputedCandidate& c : run.result.computed) {
    busy += c.result.seconds();
    REQUIRE(c.mission_time_s <= 78.5);
  }
  REQUIRE(busy <= 3.0 * 78.5);
  REQUIRE(busy > 0.8 * 3.0 * 76.0);  // measured 0.87: a batch ends with its slowest

  // Another machine's times change the run, recorded ones repeat it.
  KnownOutcomes known;
  for (const RegistrationResult& outcome : run.outcomes) {
    const RegistrationResult copy = parse_outcome_line(outcome_line(outcome));
    known[{copy.candidate.from, copy.candidate.to}] = copy;
  }
  const auto other = std::make_shared<OracleRegistrar>(mission.ground_truth);  // takes no time
  REQUIRE(run_replay(mission, config, 1, known, other).lines == run.lines);
  REQUIRE(run_replay(mission, config, 1, {}, other).lines != run.lines);
  config.after_mission = true;
  config.max_registrations = 0;
  config.batch = 200;
  const Recorded all = run_replay(mission, config, 1, {}, other);
  REQUIRE(all.result.accounting.pending == 0);
}

TEST_CASE("replay: a refused registration may take a share of the time, or none", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config();
  config.cost.workers = 1;
  config.batch = 1;  // the worker is always busy
  const auto at_share = [&](double share) {
    config.cost.refused_time_share = share;
    return run_replay(mission, config).result;
  };
  std::size_t before = 0;
  for (const double share : {2.0, 1.0, 0.5, 0.0}) {
    const ReplayResult run = at_share(share);
    REQUIRE(run.accounting.balanced());
    double busy_s = 0.0;
    for (const ComputedCandidate& c : run.computed)
      busy_s += config.cost.registration_time_s * (c.result.verified() ? 1.0 : share);
    REQUIRE(busy_s <= run.mission_end_s);
    REQUIRE(busy_s > 0.8 * run.mission_end_s);
    REQUIRE(run.computed.size() > before);
    before = run.computed.size();
  }
}

TEST_CASE("replay: a batch takes about as long on a slow computer as on a fast one", "[replay][replay]") {
  ReplayOptions config = fast_config();
  const auto size = [&](std::int64_t workers, double registration_time_s) {
    config.cost.workers = workers;
    config.cost.registration_time_s = registration_time_s;
    return batch_size(config);
  };
  config.batch = 0;
  REQUIRE(size(10, 1.3) == 100);
  REQUIRE(size(2, 1.3) == 20);
  REQUIRE(size(1, 2.6) == 5);
  REQUIRE(size(3, 60.0) == 3);  // nobody is idle
  REQUIRE(size(200, 1.3) == 200);
  REQUIRE(size(1, 0.001) == 100);
  config.cost.measured_time = true;
  REQUIRE(size(2, 1.3) == 100);
  config.cost.measured_time = false;
  config.batch = 7;
  REQUIRE(size(2, 1.3) == 7);

  config.batch = 0;
  config.cost.workers = 2;
  config.cost.registration_time_s = 4.0;
  std::size_t batches = 0;
  for (const std::string& line : run_replay(two_circles(), config).lines) {
    const nlohmann::json event = nlohmann::json::parse(line);
    if (event.value("event", "") != "batch") continue;
    ++batches;
    REQUIRE(event["pairs"].size() <= 6);
  }
  REQUIRE(batches > 5);
}

TEST_CASE("replay: options that contradict each other are refused", "[replay][error]") {
  ReplayOptions config;
  config.cost.measured_time = true;
  config.cost.refused_time_share = 0.5;
  REQUIRE_THROWS_WITH(validate_replay(config), Contains("cost.refused_time_share"));
  config.cost.refused_time_share = 1.0;
  REQUIRE_NOTHROW(validate_replay(config));
  config.prioritization.expected.verified_weights = "1,2,3";
  REQUIRE_THROWS_WITH(validate_replay(config), Contains("expected.verified_weights: 3 numbers"));
  config.prioritization.expected.verified_weights = "1,2,3,4,5,6";
  config.prioritization.expected.right_weights = "1,2,3,4,5,x";
  REQUIRE_THROWS_WITH(validate_replay(config), Contains("expected.right_weights: \"x\""));
}

TEST_CASE("replay: thinning keeps a uniform share of the pairs, the same for every method",
          "[replay][replay]") {
  const Mission mission = two_circles();
  const auto pairs = [&](const char* method, std::int64_t thin, std::uint64_t seed) {
    ReplayOptions config = fast_config(method);
    config.after_mission = true;
    config.batch = 200;
    config.engine.thin = thin;
    config.engine.seed = seed;
    std::set<std::pair<Key, Key>> out;
    for (const ComputedCandidate& c : run_replay(mission, config).result.computed) {
      out.emplace(c.result.candidate.from, c.result.candidate.to);
    }
    return out;
  };
  const auto all = pairs("baseline", 1, 1), kept = pairs("baseline", 4, 1);
  const double expected = static_cast<double>(all.size()) / 4.0;
  REQUIRE(std::abs(static_cast<double>(kept.size()) - expected) < 4.0 * std::sqrt(expected));
  REQUIRE(pairs("baseline", 4, 2) != kept);
  // It draws by pair, so methods with other orders draw the same for the same pairs.
  const auto at_random = pairs("random", 4, 1);
  std::size_t common = 0;
  for (const auto& pair : at_random) common += kept.count(pair);
  REQUIRE(static_cast<double>(common) > 0.9 * static_cast<double>(kept.size()));
}

TEST_CASE("replay: key frames of a communication gap arrive at its end, in order", "[replay][replay]") {
  Mission mission = two_circles();
  mission.gaps = {{1, 10.0, 50.0}};
  const Recorded run = run_replay(mission, fast_config());
  std::vector<std::pair<double, Key>> arrivals;
  for (const Json& line : run.journal) {
    if (line.at("event") != "key_frame") continue;
    arrivals.emplace_back(line.at("time_s").get<double>(), parse_key(line.at("key").get<std::string>()));
  }
  std::size_t late = 0;
  Key previous_b = 0;
  for (const auto& [time, key] : arrivals) {
    if (key_character(key) != 'b') continue;
    REQUIRE_FALSE((time >= 10.0 && time < 50.0));
    late += time == 50.0 ? 1 : 0;
    REQUIRE(key > previous_b);
    previous_b = key;
  }
  REQUIRE(late == 20);
  // Nodes that come late are placed relative to the estimate of those before them, so odometry alone is
  // unchanged.
  REQUIRE(mean_error(mission, run.result.odometry, run.result.graph) ==
          Approx(mean_error(mission, mission.graph)).margin(1e-9));
}

TEST_CASE("replay: a run that continues from outcomes equals an uninterrupted one",
          "[replay][replay][resume]") {
  const Mission mission = two_circles();
  const ReplayOptions config = fast_config("obs");
  const Recorded whole = run_replay(mission, config);

  StopSource stop;
  std::size_t seen = 0;
  const Recorded part = run_replay(mission, config, 2, {}, nullptr, stop.token(), [&](const Progress& p) {
    seen = std::max(seen, p.done);
    if (seen >= 30) stop.request_stop();
  });
  REQUIRE(part.result.interrupted);
  REQUIRE(part.result.accounting.balanced());
  REQUIRE(part.result.computed.size() == part.outcomes.size());  // nothing computed is lost
  REQUIRE(part.outcomes.size() >= 30);
  REQUIRE(part.outcomes.size() < whole.outcomes.size());

  KnownOutcomes known;
  for (const RegistrationResult& outcome : part.outcomes) {
    const RegistrationResult copy = parse_outcome_line(outcome_line(outcome));
    known[{copy.candidate.from, copy.candidate.to}] = copy;
  }
  const Recorded rest = run_replay(mission, config, 1, known);
  REQUIRE(rest.outcomes.size() + part.outcomes.size() == whole.outcomes.size());
  REQUIRE(rest.lines == whole.lines);
}

TEST_CASE("replay: an outcome of the same pair from another guess is computed again",
          "[replay][replay][resume]") {
  /// What it gives depends on the guess, as registrations do in the last digits.
  class GuessDependentRegistrar final : public Registrar {
   public:
    explicit GuessDependentRegistrar(const Mission& mission) : oracle_(mission.ground_truth) {}
    std::string_view name() const override { return "guess_dependent"; }
    RegistrationResult compute(const RegistrationTask& task) const override {
      RegistrationResult result = oracle_.compute(task);
      if (result.closure) result.closure->T_from_to.translation() += 1e-3 * task.guess_from_to->translation();
      return result;
    }

   private:
    OracleRegistrar oracle_;
  };
  const Mission mission = two_circles();
  const ReplayOptions config = fast_config("obs");
  const auto registrar = std::make_shared<GuessDependentRegistrar>(mission);
  const Recorded whole = run_replay(mission, config, 1, {}, registrar);
  const Recorded other = run_replay(mission, fast_config("random"), 1, {}, registrar);
  const auto known_of = [](const Recorded& run) {
    KnownOutcomes known;
    for (const RegistrationResult& outcome : run.outcomes) {
      const RegistrationResult copy = parse_outcome_line(outcome_line(outcome));
      REQUIRE(copy.task_hash == outcome.task_hash);
      REQUIRE(copy.task_hash != 0);
      known[{copy.candidate.from, copy.candidate.to}] = copy;
    }
    return known;
  };
  const KnownOutcomes known = known_of(other);
  std::size_t shared = 0;
  for (const RegistrationResult& outcome : whole.outcomes) {
    shared += known.count({outcome.candidate.from, outcome.candidate.to});
  }
  REQUIRE(shared > 5);
  const Recorded again = run_replay(mission, config, 1, known, registrar);
  REQUIRE(again.lines == whole.lines);
  for (std::size_t i = 0; i < whole.result.computed.size(); ++i) {
    REQUIRE(whole.result.computed[i].result.task_hash != 0);
    REQUIRE(again.result.computed[i].result.task_hash == whole.result.computed[i].result.task_hash);
  }
  // Almost all pairs had another guess, except those before the first closure.
  REQUIRE(again.outcomes.size() < whole.outcomes.size());
  REQUIRE(again.outcomes.size() > 9 * whole.outcomes.size() / 10);
  REQUIRE(run_replay(mission, config, 1, known_of(whole), registrar).outcomes.empty());
  KnownOutcomes unknown_task = known;
  for (auto& [pair, outcome] : unknown_task) outcome.task_hash = 0;
  REQUIRE(run_replay(mission, config, 1, unknown_task, registrar).lines != whole.lines);  // whoever wants it
}

TEST_CASE("replay: outcomes survive as text to the bit", "[replay][replay][resume]") {
  RegistrationResult rejected;
  rejected.candidate.from = make_key('b', 3);
  rejected.candidate.to = make_key('a', 9);
  rejected.reason = RejectionReason::kLowOverlap;
  rejected.message = "overlap 0.1, must be >= 0.3 \"quoted\"";
  rejected.T_from_to = Eigen::Isometry3d::Identity();
  rejected.T_from_to->translation() << 0.1, 1.0 / 3.0, -1e-17;
  const RegistrationResult copy = parse_outcome_line(outcome_line(rejected));
  REQUIRE(copy.candidate.from == rejected.candidate.from);
  REQUIRE(copy.reason == rejected.reason);
  REQUIRE(copy.message == rejected.message);
  REQUIRE(copy.T_from_to->translation() == rejected.T_from_to->translation());
  REQUIRE(std::isnan(copy.overlap));
  for (const char* bad : {"", "{", "{}", "[1]", "{\"from\":\"x\"}"}) {
    REQUIRE_THROWS_AS(parse_outcome_line(bad), InputError);
  }
  RegistrationResult verified = rejected;
  verified.reason = RejectionReason::kNone;
  verified.closure = LoopClosure{verified.candidate.from, verified.candidate.to};
  verified.closure->covariance = 0.01 * Matrix6d::Identity();
  REQUIRE(parse_outcome_line(outcome_line(verified)).closure->covariance == verified.closure->covariance);
  REQUIRE_FALSE(parse_outcome_line(outcome_line(verified)).incomplete);
  verified.incomplete = true;
  REQUIRE(parse_outcome_line(outcome_line(verified)).incomplete);
  for (const double variance : {0.0, -1.0}) {  // as it would be refused later, without a line
    verified.closure->covariance(2, 2) = variance;
    REQUIRE_THROWS_WITH(parse_outcome_line(outcome_line(verified)),
                        Contains("covariance is not positive definite"));
  }
}

TEST_CASE("replay: added odometry noise is seeded, and lowers the stated information", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions options;
  REQUIRE(replay_edges(mission, options)[5].T_from_to.matrix() ==
          mission.graph.edges()[5].T_from_to.matrix());
  options.odometry_noise_m_per_m = 0.05;
  options.odometry_noise_rad_per_m = 0.01;
  const std::vector<Edge> a = replay_edges(mission, options), same = replay_edges(mission, options);
  options.engine.seed = 2;
  const std::vector<Edge> other = replay_edges(mission, options);
  double squares_m = 0.0, squares_rad = 0.0;
  for (std::size_t e = 0; e < a.size(); ++e) {
    REQUIRE(a[e].T_from_to.matrix() == same[e].T_from_to.matrix());
    REQUIRE(a[e].T_from_to.matrix() != other[e].T_from_to.matrix());
    const Vector6d noise = se3::log(mission.graph.edges()[e].T_from_to.inverse() * a[e].T_from_to);
    squares_m += noise.head<3>().squaredNorm() / 3.0;
    squares_rad += noise.tail<3>().squaredNorm() / 3.0;
    // 1/(1/400 + 0.05²·2) and 1/(1e-4 + 0.01²·2) for steps of 2 m, as near as the noisy steps' lengths allow.
    REQUIRE(a[e].information(0, 0) == Approx(1.0 / (1.0 / 400.0 + 0.0025 * 2.0)).epsilon(0.1));
    REQUIRE(a[e].information(4, 4) == Approx(1.0 / (1e-4 + 1e-4 * 2.0)).epsilon(0.1));
  }
  const double n = static_cast<double>(a.size());
  REQUIRE(std::sqrt(squares_m / n) == Approx(0.05 * std::sqrt(2.0)).epsilon(0.25));
  REQUIRE(std::sqrt(squares_rad / n) == Approx(0.01 * std::sqrt(2.0)).epsilon(0.25));
}

TEST_CASE("replay: missing and unreadable scans expire their candidates with a reason",
          "[replay][replay][error]") {
  Mission mission = two_circles();
  std::vector<Key> keys;
  for (const Key key : mission.graph.keys()) {
    if (key_index(key) % 4 != 0) keys.push_back(key);
  }
  const ScanLoader whole = mission.scans->loader();
  mission.scans = std::make_shared<ScanStore>(keys, [whole](Key key) {
    if (key_index(key) == 7) throw InputError("scan " + std::to_string(key) + ": cut short");
    return whole(key);
  });
  ReplayOptions config = fast_config();
  config.after_mission = true;
  const Recorded run = run_replay(mission, config);
  REQUIRE(run.result.accounting.balanced());
  REQUIRE(run.result.expired.at("missing_scan") == run.result.accounting.expired);
  REQUIRE(run.result.accounting.expired > 100);
  REQUIRE(run.result.problems.count("unreadable scan") == 2);
  for (const ComputedCandidate& c : run.result.computed) {
    REQUIRE(key_index(c.result.candidate.from) % 4 != 0);
    REQUIRE(key_index(c.result.candidate.to) != 7);
  }
}

TEST_CASE("replay: scans that vanish during the run are named, their candidates counted, the run continues",
          "[replay][replay][error]") {
  const testing::TemporaryFolder folder;
  Mission mission = two_circles(1, 20);
  std::map<Key, testing::fs::path> files;
  for (const Key key : mission.graph.keys()) {
    files[key] = folder / (std::to_string(key) + ".pcd");
    write_pcd(files[key], *mission.scans->load(key));
  }
  mission.scans = std::make_shared<ScanStore>(files, 0);  // read anew each time
  ReplayOptions config = fast_config("baseline");
  config.after_mission = true;
  config.registration.features.max_cache_mb = 0.0;
  std::set<Key> gone;
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
  class Reading final : public Registrar {
   public:
    Reading(std::shared_ptr<FeatureCache> features, const Mission& mission)
        : features_(std::move(features)), oracle_(mission.ground_truth) {}
    std::string_view name() const override { return "reading"; }
    RegistrationResult compute(const RegistrationTask& task) const override {
      for (const Key key : {task.candidate.from, task.candidate.to}) {
        try {
          if (features_->get(key)) continue;
        } catch (const Error& error) {
          RegistrationResult missing;
          missing.candidate = task.candidate;
          missing.reason = RejectionReason::kMissingScan;
          missing.message = error.what();
          return missing;
        }
      }
      return oracle_.compute(task);
    }

   private:
    std::shared_ptr<FeatureCache> features_;
    OracleRegistrar oracle_;
  };
  ReplayHooks hooks;
  std::size_t computed = 0;
  hooks.outcome = [&](const RegistrationResult&) {
    if (++computed % 40 != 0) return;
    const Key key = make_key(computed % 80 == 0 ? 'a' : 'b', computed / 40);
    testing::fs::remove(files.at(key));
    gone.insert(key);
  };
  ThreadPool pool(2);
  const ReplayResult result =
      MissionReplay(mission, config, {features, std::make_shared<Reading>(features, mission)})
          .run(pool, hooks);
  REQUIRE(result.accounting.balanced());
  REQUIRE(result.accounting.pending + result.accounting.in_flight == 0);
  REQUIRE(result.computed.size() == result.accounting.computed);
  std::size_t missing = 0;
  for (const ComputedCandidate& c : result.computed) {
    if (c.result.reason != RejectionReason::kMissingScan) continue;
    ++missing;
    REQUIRE((gone.count(c.result.candidate.from) + gone.count(c.result.candidate.to)) > 0);
    REQUIRE_THAT(c.result.message, Contains(".pcd"));
  }
  REQUIRE(missing > 0);
  const std::size_t named = result.problems.count("scan cannot be read");
  REQUIRE(named > 0);
  REQUIRE(named <= gone.size());
  REQUIRE_THAT(to_string(result.problems.all().front()), Contains(".pcd: No such file"));
  REQUIRE(std::any_of(result.computed.begin() + 80, result.computed.end(),
                      [](const ComputedCandidate& c) { return c.result.verified(); }));
}

TEST_CASE("replay: a registrar that throws rejects its candidates", "[replay][replay][error]") {
  class Broken final : public Registrar {
   public:
    std::string_view name() const override { return "broken"; }
    RegistrationResult compute(const RegistrationTask&) const override {
      throw std::runtime_error("out of order");
    }
  };
  const Mission mission = two_circles();
  const Recorded run = run_replay(mission, fast_config(), 2, {}, std::make_shared<Broken>());
  REQUIRE_FALSE(run.result.computed.empty());
  for (const ComputedCandidate& c : run.result.computed) {
    REQUIRE(c.result.reason == RejectionReason::kFailed);
    REQUIRE(c.result.message == "out of order");
  }
  REQUIRE(run.result.problems.count("registration failed") == run.result.computed.size());
  REQUIRE_THAT(to_string(run.result.problems.all().front()), Contains("out of order"));
}

TEST_CASE("replay: landmarks, ranges and gravity hold the map and are never candidates", "[replay][replay]") {
  const Mission mission = testing::with_landmark(two_circles());
  const Recorded without = run_replay(two_circles(), fast_config("odom")),
                 with = run_replay(mission, fast_config("odom"));
  REQUIRE(with.result.graph.nodes().size() == mission.graph.nodes().size());
  REQUIRE(with.result.graph.ranges().size() == 1);
  REQUIRE(with.result.graph.gravities().size() == mission.graph.gravities().size());
  REQUIRE(with.result.graph.edges().size() == mission.graph.edges().size());
  // Measured 0.23; the odometry alone leaves 1.
  REQUIRE(mean_error(mission, with.result.graph) < 0.5 * mean_error(mission, without.result.graph));
  const Recorded all = run_replay(mission, fast_config("full"));
  REQUIRE_FALSE(all.result.computed.empty());
  for (const Json& line : all.journal) {
    if (line.at("event") != "batch") continue;
    for (const Json& pair : line.at("pairs")) {
      for (const Json& key : pair) {
        REQUIRE_FALSE((key.is_string() && mission.robots.is_landmark(parse_key(key.get<std::string>()))));
      }
    }
  }
  REQUIRE(run_replay(mission, fast_config("full"), 2).lines == all.lines);
}

TEST_CASE("replay: robots that share nothing, a robot without prior, a lone node", "[replay][replay]") {
  Mission mission = two_circles();
  PoseGraph graph;
  for (const Node& node : mission.graph.nodes()) graph.add_node(node);
  for (const Edge& edge : mission.graph.edges()) {
    if (edge.from != make_key('b', 19)) graph.add_edge(edge);  // robot b's path is broken once
  }
  graph.add_prior(mission.graph.priors()[0]);  // robot b has none
  mission.graph = graph;
  ReplayOptions config = fast_config();
  config.after_mission = true;
  config.batch = 200;
  const Recorded run = run_replay(mission, config);
  REQUIRE(run.result.graph.nodes().size() == 80);
  REQUIRE(mean_error(mission, run.result.graph) < 0.2);
}

TEST_CASE("config: sections, presets and assignments; errors name section and field",
          "[replay][config][error]") {
  const testing::TemporaryFolder folder;
  Config config;
  testing::write_text(
      folder / "c.json",
      R"({"generation": {"preset": "lamp_robot", "skip_recent": 3}, "replay": {"batch": 7}})");
  read_config(folder / "c.json", config);
  REQUIRE(config.replay.engine.generation.radius_max_m == 80.0);
  REQUIRE(config.replay.engine.generation.skip_recent == 3);
  REQUIRE(config.replay.batch == 7);
  set_config_option("prioritization.method=random", config);
  Config nearer;  // the example of the documentation: one option is enough
  set_config_option("generation.radius_max_m=20", nearer);
  REQUIRE_NOTHROW(validate_proximity(nearer.replay.engine.generation));
  REQUIRE(nearer.replay.engine.generation.rate_m == 0.2);  // and the others stay
  REQUIRE(to_string(config.replay.prioritization.method) == "random");
  testing::write_text(folder / "all.json", config_json(config));
  Config copy;
  read_config(folder / "all.json", copy);
  REQUIRE(config_json(copy) == config_json(config));

  const std::vector<std::pair<std::string, std::string>> bad{
      {R"({"generatoin": {}})", "generation"},
      {R"({"generation": {"rate": 1}})", "generation.rate"},
      {R"({"generation": {"rate_m": -1}})", "generation.rate_m = -1, must be >= 0"},
      {R"({"generation": {"rate_m": "x"}})", "generation.rate_m"},
      {R"({"generation": {"preset": "none"}})", "preset = \"none\""},
      {R"({"generation": {"radius_min_m": 90}})", "generation.radius_min_m"},
      {R"({"prioritization": {"method": "best"}})", "best"},
      {R"({"replay": {"method": "obs"}})", "it is now called prioritization.method"},
      {R"({"replay": {"seed": 2}})", "it is now called engine.seed"},
      {R"([])", "object"}};
  for (const auto& [text, part] : bad) {
    CAPTURE(text);
    testing::write_text(folder / "bad.json", text);
    const std::string before = config_json(config);
    REQUIRE_THROWS_WITH(read_config(folder / "bad.json", config), Contains(part) && Contains("bad.json"));
    REQUIRE(config_json(config) == before);
  }
  for (const char* assignment : {"rate_m=1", "generation.rate_m", "generation.rate_m=x", "x.y=1",
                                 "generation.x=1", "replay.workers=3"}) {
    CAPTURE(assignment);
    REQUIRE_THROWS_AS(set_config_option(assignment, config), OptionError);
  }
}

TEST_CASE("replay: with full each prioritiser has its share of every batch while both have candidates",
          "[replay][replay]") {
  ReplayOptions config = fast_config("full");
  config.batch = 7;
  const Recorded run = run_replay(two_circles(), config);
  REQUIRE(run.result.handed_out.size() == 2);
  REQUIRE(run.result.handed_out[0].first == "obs");
  REQUIRE(run.result.handed_out[1].first == "gi");
  const std::size_t obs = run.result.handed_out[0].second, gi = run.result.handed_out[1].second;
  REQUIRE(obs + gi >= 50);
  REQUIRE(std::max(obs, gi) - std::min(obs, gi) <= 1);
}

TEST_CASE("replay: graph information spends the evaluations that fit into mission time", "[replay][replay]") {
  const Mission mission = two_circles();
  ReplayOptions config = fast_config("gi");
  const auto order = [&] {
    std::vector<std::pair<Key, Key>> pairs;
    for (const ComputedCandidate& c : run_replay(mission, config).result.computed) {
      pairs.emplace_back(c.result.candidate.from, c.result.candidate.to);
    }
    return pairs;
  };
  const auto usual = order();
  REQUIRE(order() == usual);
  config.cost.gi_evaluation_time_s = 1e6;  // none fits: greedy choice alone
  const auto greedy_alone = order();
  REQUIRE(greedy_alone.size() == usual.size());
  config.prioritization.graph_information.selector = SelectorKind::kGreedy;
  REQUIRE(order() == greedy_alone);
}

TEST_CASE("replay: radio candidates come first with method rssi, all others are pruned", "[replay][replay]") {
  const Recorded run = run_replay(with_radio(two_circles()), fast_config("rssi"));
  // Two fly-bys of four nodes: each against the drop, and against each other.
  REQUIRE(run.result.computed.size() == 8 + 16);
  for (const ComputedCandidate& c : run.result.computed) {
    REQUIRE(c.result.candidate.source == CandidateSource::kRadio);
  }
  REQUIRE(run.result.pruned.at("not_radio") == run.result.accounting.pruned);
  REQUIRE_THROWS_AS(parse_method("obs+loud"), OptionError);
}

TEST_CASE("replay: position fixes neither turn the path nor are left out of the estimate",
          "[replay][replay]") {
  const Mission plain = two_circles(1, 20);
  Mission fixed = plain;
  for (std::uint64_t i = 4; i < 20; i += 4) {
    PriorFactor prior;  // as of GNSS: the rotation is made up
    prior.key = make_key('a', i);
    prior.pose.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 2.0));
    prior.pose.translation() = plain.ground_truth.at(prior.key).translation();
    prior.information.setZero();
    prior.information.diagonal().head<3>().setConstant(1e4);
    fixed.graph.add_prior(prior);
  }
  ReplayOptions config;
  config.prioritization.method = parse_method("odom");
  const auto registrar = std::make_shared<OracleRegistrar>(plain.ground_truth);
  const auto run = [&](const Mission& mission) {
    const auto features = std::make_shared<FeatureCache>(mission.scans->loader());
    ThreadPool threads(1);
    return MissionReplay(mission, config, {features, registrar}).run(threads);
  };
  const ReplayResult by_odometry = run(plain), by_fixes = run(fixed);
  for (std::size_t i = 0; i < by_odometry.odometry.size(); ++i)
    REQUIRE(by_fixes.odometry[i].matrix() == by_odometry.odometry[i].matrix());
  REQUIRE(by_odometry.optimizations == 0);
  REQUIRE(by_fixes.optimizations == 1);
  const auto error = [&](const ReplayResult& result) {
    double sum = 0.0;
    for (std::uint64_t i = 0; i < 20; ++i) {
      const Key key = make_key('a', i);
      sum += (result.graph.node(key).pose.translation() - plain.ground_truth.at(key).translation()).norm();
    }
    return sum / 20.0;
  };
  CAPTURE(error(by_odometry), error(by_fixes));
  REQUIRE(error(by_fixes) < 0.5 * error(by_odometry));
}

TEST_CASE("replay: a 2D graph is refused before anything is computed", "[replay][planar][error]") {
  Mission mission = testing::two_circles();
  PoseGraph flat;
  flat.set_planar();
  Node node;
  node.key = make_key('a', 0);
  flat.add_node(node);
  mission.graph = flat;
  mission.path = "flat.g2o";
  const auto registrar = std::make_shared<OracleRegistrar>(mission.ground_truth);
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader());
  ThreadPool threads(1);
  REQUIRE_THROWS_WITH(MissionReplay(mission, {}, {features, registrar}).run(threads),
                      Contains("flat.g2o: has a 2D graph"));
}

}  // namespace loopwise::replay_test
