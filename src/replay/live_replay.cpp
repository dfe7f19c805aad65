// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/live_replay.hpp>

#include <atomic>
#include <chrono>
#include <exception>
#include <memory>
#include <new>
#include <thread>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/online/loop_closure_module.hpp>

#include "closure_weights.hpp"
#include "journal.hpp"
#include "mission_feed.hpp"

namespace loopwise {
namespace {

void check(const ReplayOptions& options) {
  validate_replay(options);
  const auto refuse = [](const std::string& option) {
    throw OptionError(option + ": needs a virtual clock");
  };
  if (options.max_registrations > 0) refuse("replay.max_registrations");
  if (options.cost.measured_time) refuse("cost.measured_time");
  if (options.cost.refused_time_share != 1.0) refuse("cost.refused_time_share");
}

/// One run: passes a mission to the module in real time.
class LiveRun {
 public:
  LiveRun(const Mission& mission, const ReplayOptions& options, ModuleParts parts, Clock& clock, int threads,
          const ReplayHooks& hooks)
      : mission_(mission),
        options_(options),
        clock_(clock),
        hooks_(hooks),
        feed_(mission_feed(mission, options)),
        decisions_(decisions_of(mission, options)),
        odometry_(odometry_of(feed_, mission.robots)),
        module_(mission.robots, module_options(options, threads), callbacks(), observed(std::move(parts))) {
    result_.mission_end_s = feed_.empty() ? 0.0 : feed_.back().time_s;
  }

  ReplayResult execute() {
    const Stopwatch watch;
    write(journal::start_line(mission_, options_));
    drive();
    if (options_.after_mission && !stopped()) wait();
    stopped() ? module_.stop() : module_.finish();  // the results of running registrations still count
    take_result();
    try {
      write(journal::end_line(result_.mission_time_s, result_.interrupted, result_.accounting));
      show(ReplayMoment::Kind::kEnd, result_.mission_time_s, result_.graph, result_.odometry,
           result_.accounting);
    } catch (const std::exception& error) {  // a real-time run cannot be repeated, so its result is kept
      result_.problems.add("live", error.what());
    }
    result_.total_s = watch.seconds();
    return std::move(result_);
  }

 private:
  [[nodiscard]] bool stopped() const { return hooks_.stop.stop_requested(); }

  /// Adds an observer of events. It takes times from the engine, as in a trace.
  [[nodiscard]] ModuleParts observed(ModuleParts parts) {
    parts.on_event = [this](const HandledEvent& handled) {
      now_s_ = handled.now_s;
      if (hooks_.event) hooks_.event(handled);
    };
    return parts;
  }

  [[nodiscard]] ModuleCallbacks callbacks() {
    ModuleCallbacks callbacks;
    callbacks.on_result = [this](const RegistrationResult& computed) {
      result_.computed.push_back({computed, now_s_, 0.0});
      if (hooks_.outcome) hooks_.outcome(computed);
      write(journal::live_result_line(now_s_, computed, module_.statistics()));
    };
    callbacks.on_estimate = [this](const std::shared_ptr<const Estimate>& estimate) {
      take_weights(estimate->graph, result_.computed);
      ++result_.optimizations;
      if (estimate->continued) ++result_.continued_optimizations;
      if (hooks_.moment) {
        show(ReplayMoment::Kind::kBatch, now_s_, estimate->graph, odometry_, module_.statistics().candidates);
      }
    };
    callbacks.on_problem = [this](const std::string& problem) { result_.problems.add("live", problem); };
    return callbacks;
  }

  void drive() {
    for (const ClosureDecision& decision : decisions_) static_cast<void>(module_.decide(decision));
    for (const Arrival& arrival : feed_) {
      clock_.wait_until(arrival.time_s, hooks_.stop);
      if (stopped()) return;
      KeyFrame frame = arrival.frame;
      if (mission_.scans->has(frame.node.key)) {
        try {
          frame.cloud = mission_.scans->load(frame.node.key);
        } catch (const Error&) {  // the scan store counts it; the node's candidates wait, then expire
        }
      }
      bool taken = arrival.candidates.empty() || module_.add_candidates(arrival.candidates);
      taken = taken && module_.add_key_frame(frame);
      for (const BeaconDrop& drop : arrival.drops) taken = taken && module_.add_beacon_drop(drop);
      if (!arrival.readings.empty()) taken = taken && module_.add_radio(arrival.readings);
      if (!taken) throw std::bad_alloc();  // the module only stops itself if an allocation fails
      ++fed_;
      report();
    }
  }

  /// Waits until nothing is pending, or a stop is requested.
  void wait() {
    std::atomic<bool> idle{false}, completed{false};
    std::thread waiting([&] {
      completed = module_.wait();
      idle = true;
    });
    std::exception_ptr failure;
    try {
      while (!idle && !stopped()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
        report();
      }
    } catch (...) {
      failure = std::current_exception();
    }
    if (!idle) module_.stop();  // this also ends the wait
    waiting.join();
    if (failure) std::rethrow_exception(failure);
    if (idle && !completed && !stopped()) throw std::bad_alloc();
  }

  void take_result() {
    result_.mission_time_s = clock_.now();
    result_.interrupted = stopped();
    result_.graph = module_.graph();
    take_weights(result_.graph, result_.computed);
    const auto placed = static_cast<std::ptrdiff_t>(result_.graph.nodes().size());
    result_.odometry.assign(odometry_.begin(), odometry_.begin() + placed);
    const ModuleStatistics statistics = module_.statistics();
    result_.accounting = statistics.candidates;
    result_.handed_out.assign(statistics.handed_out.begin(), statistics.handed_out.end());
    result_.batches = statistics.batches;
    result_.registration_s = statistics.computing_s;
    result_.optimization_s = statistics.optimizing_s;
    Problems all = result_.problems;  // a copy, so that no problem counts twice
    all.add(mission_.scans->problems());
    report_missing(decisions_, result_.graph, all);
    result_.problems = std::move(all);
  }

  void write(const std::string& line) const {
    if (hooks_.journal) hooks_.journal(line);
  }
  void show(ReplayMoment::Kind kind, double now_s, const PoseGraph& graph,
            const std::vector<Eigen::Isometry3d>& odometry, const CandidateAccounting& account) const {
    if (hooks_.moment) hooks_.moment({kind, now_s, graph, odometry, result_.computed, account});
  }
  void report() const {
    if (!hooks_.progress) return;
    const CandidateAccounting a = module_.statistics().candidates;
    hooks_.progress({"key frames", fed_, feed_.size(),
                     std::to_string(a.computed) + " computed, " + std::to_string(a.pending) + " pending"});
  }

  const Mission& mission_;
  const ReplayOptions& options_;
  Clock& clock_;
  const ReplayHooks& hooks_;
  const std::vector<Arrival> feed_;
  const std::vector<ClosureDecision> decisions_;
  const std::vector<Eigen::Isometry3d> odometry_;
  double now_s_ = 0.0;  // of the current event; only the module's thread uses it
  std::size_t fed_ = 0;
  ReplayResult result_;
  LoopClosureModule module_;  // last, because its callbacks use all other members
};

}  // namespace

ModuleOptions module_options(const ReplayOptions& options, int threads) {
  ModuleOptions module;
  module.engine = options.engine;
  module.appearance = options.appearance;
  module.prioritization = options.prioritization;
  module.features = options.registration.features;
  module.registration = options.registration.fast;
  module.back_end = options.back_end;
  if (options.batch > 0) module.batch = options.batch;
  module.threads = threads;
  return module;
}

ReplayResult replay_live(const Mission& mission, const ReplayOptions& options,
                         std::shared_ptr<const Registrar> registrar, Clock& clock, int threads,
                         const ReplayHooks& hooks) {
  check(options);
  if (!registrar) throw InputError("replay_live needs a registrar");
  ModuleParts parts;
  parts.scans = mission.scans->loader();
  parts.registrar = [&registrar](const ScanLoader&) { return registrar; };
  parts.clock = std::shared_ptr<const Clock>(&clock, [](const Clock*) {});
  return LiveRun(mission, options, std::move(parts), clock, threads, hooks).execute();
}

}  // namespace loopwise
