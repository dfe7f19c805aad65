// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/live_replay.hpp>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <map>
#include <new>
#include <optional>
#include <thread>
#include <type_traits>
#include <unordered_map>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/pipeline/loop_closure_module.hpp>

#include "journal.hpp"

namespace loopwise {
namespace {

/// What arrives at one moment.
struct Arrival {
  double time_s = 0.0;
  KeyFrame frame;
  std::vector<BeaconDrop> drops;
  std::vector<std::vector<RadioReading>> readings;  ///< By beacon.
};

struct Feed {
  std::vector<Arrival> arrivals;            ///< In order of time, then key.
  std::vector<Eigen::Isometry3d> odometry;  ///< Poses by odometry alone, in the order of the arrivals.
};

Feed feed_of(const Mission& mission, const Config& config) {
  const std::vector<Node>& nodes = mission.graph.nodes();
  const std::vector<double> times = arrival_times(mission);
  std::vector<std::size_t> order(nodes.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(times[a], nodes[a].key) < std::pair(times[b], nodes[b].key);
  });
  const std::vector<Edge> edges = replay_edges(mission, config.replay);
  std::unordered_map<Key, std::vector<std::size_t>> edges_at;
  for (std::size_t e = 0; e < edges.size(); ++e) {
    edges_at[edges[e].from].push_back(e);
    edges_at[edges[e].to].push_back(e);
  }
  std::unordered_map<Key, std::vector<PriorFactor>> priors_at;
  for (const PriorFactor& prior : mission.graph.priors()) priors_at[prior.key].push_back(prior);
  std::unordered_map<Key, std::vector<RangeFactor>> ranges_at;
  for (const RangeFactor& range : mission.graph.ranges()) {
    ranges_at[range.from].push_back(range);
    ranges_at[range.to].push_back(range);
  }
  std::unordered_map<Key, std::vector<GravityFactor>> gravities_at;
  for (const GravityFactor& gravity : mission.graph.gravities()) gravities_at[gravity.key].push_back(gravity);
  const std::vector<std::string> parts = method_parts(config.replay.method);
  const bool with_radio = std::find(parts.begin(), parts.end(), "rssi") != parts.end();
  std::unordered_map<Key, std::map<std::string, std::vector<RadioReading>>> readings_at;
  std::unordered_map<Key, std::vector<BeaconDrop>> drops_at;
  if (with_radio) {
    for (const RadioReading& reading : mission.radio)
      readings_at[reading.key][reading.beacon].push_back(reading);
    for (const BeaconDrop& drop : mission.beacons) drops_at[drop.drop_key].push_back(drop);
  }

  Feed feed;
  std::unordered_map<Key, std::size_t> place;
  for (const std::size_t i : order) {
    const Key key = nodes[i].key;
    Arrival arrival;
    arrival.time_s = times[i];
    arrival.frame.node = nodes[i];
    Eigen::Isometry3d pose = nodes[i].pose;
    bool chained = false;
    for (const std::size_t e : edges_at[key]) {
      const bool forward = edges[e].to == key;
      const auto other = place.find(forward ? edges[e].from : edges[e].to);
      if (other == place.end()) continue;  // comes with that node
      arrival.frame.factors.push_back(edges[e]);
      if (chained) continue;
      chained = true;
      pose = se3::normalized(feed.odometry[other->second] *
                             (forward ? edges[e].T_from_to : edges[e].T_from_to.inverse()));
    }
    if (const auto priors = priors_at.find(key); priors != priors_at.end()) {
      arrival.frame.priors = priors->second;
      pose = priors->second.front().pose;
    }
    for (const RangeFactor& range : ranges_at[key]) {
      if (place.count(range.from == key ? range.to : range.from) != 0) arrival.frame.ranges.push_back(range);
    }
    arrival.frame.gravities = gravities_at[key];
    if (const auto drops = drops_at.find(key); drops != drops_at.end()) arrival.drops = drops->second;
    if (const auto heard = readings_at.find(key); heard != readings_at.end()) {
      for (const auto& [beacon, readings] : heard->second) arrival.readings.push_back(readings);
    }
    place.emplace(key, feed.arrivals.size());
    feed.arrivals.push_back(std::move(arrival));
    feed.odometry.push_back(pose);
  }
  return feed;
}

/// A mission that is lived through cannot be replayed: what finds no memory is tried again for a second.
template <class Function>
std::invoke_result_t<Function&> patiently(Function&& function) {
  constexpr int kTries = 100;
  for (int tried = 1;; ++tried) {
    try {
      return function();
    } catch (const std::bad_alloc&) {
      if (tried == kTries) throw;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
}

/// Weights of the computed candidates' closures, as the graph has them.
void take_weights(const PoseGraph& graph, std::vector<ComputedCandidate>& computed) {
  std::map<std::pair<Key, Key>, double> weights;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) weights[{edge.from, edge.to}] = edge.weight;
  }
  for (ComputedCandidate& c : computed) {
    const auto found = weights.find({c.result.candidate.from, c.result.candidate.to});
    if (c.result.verified() && found != weights.end()) c.weight = found->second;
  }
}

/// The last closures may have come after the last estimate. Where the back end fails, the poses that the
/// module had are kept: a mission that was lived through cannot be replayed again.
void optimize_last(const Config& config, ReplayResult& result) {
  const std::vector<Edge>& edges = result.graph.edges();
  if (std::none_of(edges.begin(), edges.end(),
                   [](const Edge& edge) { return edge.kind == EdgeKind::kLoopClosure; })) {
    return;
  }
  const Stopwatch watch;
  try {
    PoseGraphOptimizer optimizer(config.optimization);
    const GncResult gnc = optimizer.optimize_gnc(result.graph, config.gnc);
    result.graph.set_poses(gnc.optimization.poses);
    for (std::size_t e = 0; e < gnc.weights.size(); ++e) result.graph.set_weight(e, gnc.weights[e]);
    ++result.optimizations;
  } catch (const std::exception& error) {
    result.problems.add("live", std::string("the back end failed: ") + error.what());
  }
  result.optimization_s = watch.seconds();
}

void check(const Config& config) {
  validate_config(config);
  const ReplayOptions& r = config.replay;
  const auto refuse = [](const std::string& option) {
    throw OptionError("replay." + option + ": only a virtual clock knows it");
  };
  if (r.max_registrations > 0) refuse("max_registrations");
  if (r.thin > 1) refuse("thin");
  if (r.measured_time) refuse("measured_time");
  if (r.guess == GuessSource::kOdometry) refuse("guess = \"odometry\"");
}

}  // namespace

ReplayResult replay_live(const Mission& mission, const Config& config,
                         std::shared_ptr<const Registrar> registrar, Clock& clock, int num_threads,
                         const ReplayHooks& hooks) {
  check(config);
  if (!registrar) throw InputError("replay_live needs a registrar");
  const Stopwatch watch;
  const Feed feed = feed_of(mission, config);
  const std::size_t total = feed.arrivals.size();

  ReplayResult result;
  result.mission_end_s = total == 0 ? 0.0 : feed.arrivals.back().time_s;
  const auto write = [&hooks](const std::string& line) {
    if (hooks.journal) hooks.journal(line);
  };
  write(journal::start_line(mission, config));

  ModuleOptions options;
  options.method = config.replay.method;
  options.batch = config.replay.batch;
  options.threads = num_threads;
  options.seed = config.replay.seed;
  LoopClosureModule* running = nullptr;  // for the callbacks, which come once it is fed
  ModuleCallbacks callbacks;
  callbacks.result = [&](const RegistrationResult& computed) {
    patiently([&] { result.computed.push_back({computed, clock.now(), 0.0}); });
    if (hooks.outcome) hooks.outcome(computed);
    write(journal::live_result_line(clock.now(), computed, running->statistics()));
  };
  callbacks.estimate = [&](const std::shared_ptr<const Estimate>& estimate) {
    patiently([&] { take_weights(estimate->graph, result.computed); });
    ++result.optimizations;
    if (!hooks.moment) return;
    hooks.moment({ReplayMoment::Kind::kBatch, clock.now(), estimate->graph, feed.odometry, result.computed,
                  running->statistics().candidates});
  };
  callbacks.problem = [&](const std::string& problem) {
    patiently([&] { result.problems.add("live", problem); });
  };
  ModuleParts parts;
  parts.scans = mission.scans->loader();
  parts.registrar = std::move(registrar);
  LoopClosureModule module(mission.robots, options, config, callbacks, std::move(parts));
  running = &module;

  std::size_t fed = 0;
  const auto report = [&] {
    if (!hooks.progress) return;
    const CandidateAccounting a = patiently([&] { return module.statistics(); }).candidates;
    hooks.progress({"key frames", fed, total,
                    std::to_string(a.computed) + " computed, " + std::to_string(a.pending) + " pending"});
  };
  for (const Arrival& arrival : feed.arrivals) {
    clock.wait_until(arrival.time_s, hooks.stop);
    if (hooks.stop.stop_requested()) break;
    KeyFrame frame = patiently([&] { return arrival.frame; });
    if (mission.scans->has(frame.node.key)) {
      try {
        frame.cloud = patiently([&] { return mission.scans->load(frame.node.key); });
      } catch (const Error&) {  // the store counts it; its candidates wait, then expire
      }
    }
    patiently([&] { module.add_key_frame(frame); });
    for (const BeaconDrop& drop : arrival.drops) patiently([&] { module.add_beacon_drop(drop); });
    for (const std::vector<RadioReading>& readings : arrival.readings)
      patiently([&] { module.add_radio(readings); });
    ++fed;
    report();
  }
  if (config.replay.after_mission && !hooks.stop.stop_requested()) {
    std::atomic<bool> idle{false};
    std::thread waiting = patiently([&] {
      return std::thread([&] {
        static_cast<void>(module.wait());
        idle = true;
      });
    });
    std::exception_ptr failure;
    try {
      while (!idle && !hooks.stop.stop_requested()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
        // The module waits for memory until there is some. Where there is none at all, this is to end.
        static_cast<void>(patiently([&] { return module.statistics(); }));
        report();
      }
    } catch (...) {
      failure = std::current_exception();
    }
    if (!idle) module.stop();  // ends the wait as well
    waiting.join();
    if (failure) std::rethrow_exception(failure);
  }
  module.stop();  // what is being computed still counts
  result.mission_time_s = clock.now();

  result.interrupted = hooks.stop.stop_requested();
  result.graph = patiently([&] { return module.graph(); });
  optimize_last(config, result);
  patiently([&] { take_weights(result.graph, result.computed); });
  const auto placed = static_cast<std::ptrdiff_t>(result.graph.nodes().size());
  patiently([&] { result.odometry.assign(feed.odometry.begin(), feed.odometry.begin() + placed); });
  const ModuleStatistics statistics = patiently([&] { return module.statistics(); });
  result.accounting = statistics.candidates;
  patiently([&] { result.handed_out.assign(statistics.handed_out.begin(), statistics.handed_out.end()); });
  result.batches = statistics.batches;
  result.registration_s = statistics.computing_s;
  patiently([&] {
    Problems all = result.problems;  // so that none counts twice
    all.add(mission.scans->problems());
    result.problems = std::move(all);
  });
  try {
    write(journal::end_line(result.mission_time_s, result.interrupted, result.accounting));
    if (hooks.moment) {
      hooks.moment({ReplayMoment::Kind::kEnd, result.mission_time_s, result.graph, result.odometry,
                    result.computed, result.accounting});
    }
  } catch (const std::exception& error) {  // a mission that was lived through cannot be replayed again
    result.problems.add("live", error.what());
  }
  result.total_s = watch.seconds();
  return result;
}

}  // namespace loopwise
