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
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/pipeline/loop_closure_module.hpp>

#include "journal.hpp"
#include "mission_feed.hpp"

namespace loopwise {
namespace {

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
  const std::vector<Arrival> feed = mission_feed(mission, config);
  const std::vector<Eigen::Isometry3d> odometry = odometry_of(feed, mission.robots);
  const std::size_t total = feed.size();

  ReplayResult result;
  result.mission_end_s = total == 0 ? 0.0 : feed.back().time_s;
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
    result.computed.push_back({computed, clock.now(), 0.0});
    if (hooks.outcome) hooks.outcome(computed);
    write(journal::live_result_line(clock.now(), computed, running->statistics()));
  };
  callbacks.estimate = [&](const std::shared_ptr<const Estimate>& estimate) {
    take_weights(estimate->graph, result.computed);
    ++result.optimizations;
    if (!hooks.moment) return;
    hooks.moment({ReplayMoment::Kind::kBatch, clock.now(), estimate->graph, odometry, result.computed,
                  running->statistics().candidates});
  };
  callbacks.problem = [&](const std::string& problem) { result.problems.add("live", problem); };
  ModuleParts parts;
  parts.scans = mission.scans->loader();
  parts.registrar = std::move(registrar);
  parts.clock = std::shared_ptr<const Clock>(&clock, [](const Clock*) {});
  LoopClosureModule module(mission.robots, options, config, callbacks, std::move(parts));
  running = &module;

  std::size_t fed = 0;
  const auto report = [&] {
    if (!hooks.progress) return;
    const CandidateAccounting a = module.statistics().candidates;
    hooks.progress({"key frames", fed, total,
                    std::to_string(a.computed) + " computed, " + std::to_string(a.pending) + " pending"});
  };
  for (const Arrival& arrival : feed) {
    clock.wait_until(arrival.time_s, hooks.stop);
    if (hooks.stop.stop_requested()) break;
    KeyFrame frame = arrival.frame;
    if (mission.scans->has(frame.node.key)) {
      try {
        frame.cloud = mission.scans->load(frame.node.key);
      } catch (const Error&) {  // the store counts it; its candidates wait, then expire
      }
    }
    if (!module.add_key_frame(frame)) throw std::bad_alloc();  // the one reason for it to stop by itself
    for (const BeaconDrop& drop : arrival.drops) module.add_beacon_drop(drop);
    if (!arrival.readings.empty()) module.add_radio(arrival.readings);
    ++fed;
    report();
  }
  if (config.replay.after_mission && !hooks.stop.stop_requested()) {
    std::atomic<bool> idle{false}, completed{false};
    std::thread waiting([&] {
      completed = module.wait();
      idle = true;
    });
    std::exception_ptr failure;
    try {
      while (!idle && !hooks.stop.stop_requested()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
        report();
      }
    } catch (...) {
      failure = std::current_exception();
    }
    if (!idle) module.stop();  // ends the wait as well
    waiting.join();
    if (failure) std::rethrow_exception(failure);
    if (idle && !completed && !hooks.stop.stop_requested()) throw std::bad_alloc();
  }
  module.stop();  // what is being computed still counts
  result.mission_time_s = clock.now();

  result.interrupted = hooks.stop.stop_requested();
  result.graph = module.graph();
  optimize_last(config, result);
  take_weights(result.graph, result.computed);
  const auto placed = static_cast<std::ptrdiff_t>(result.graph.nodes().size());
  result.odometry.assign(odometry.begin(), odometry.begin() + placed);
  const ModuleStatistics statistics = module.statistics();
  result.accounting = statistics.candidates;
  result.handed_out.assign(statistics.handed_out.begin(), statistics.handed_out.end());
  result.batches = statistics.batches;
  result.registration_s = statistics.computing_s;
  Problems all = result.problems;  // so that none counts twice
  all.add(mission.scans->problems());
  result.problems = std::move(all);
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
