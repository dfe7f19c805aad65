// SPDX-License-Identifier: BSD-3-Clause
#include "virtual_run.hpp"

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <optional>
#include <set>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/engine/scan_insight.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "account.hpp"
#include "batch_computation.hpp"
#include "journal.hpp"
#include "mission_feed.hpp"
#include "run_log.hpp"
#include "timed_event.hpp"

namespace loopwise {
namespace {

RoundRobinQueue queue_of(const Robots& robots, const ReplayOptions& options, const Registration& registration,
                         const PrioritizerFactory& own) {
  if (own) return RoundRobinQueue(own());
  return RoundRobinQueue(
      make_prioritizers(options.prioritization, options.engine.seed, robots,
                        scan_insight(*registration.features, options.prioritization.observability.variant)));
}

OptimizerOptions with_threads(OptimizerOptions options, int threads) {
  options.threads = threads;
  return options;
}

/// \throws InputError if a registrar reports no time
double measured_s(const RegistrationResult& result) {
  const double seconds = result.seconds();
  if (seconds >= 0.0 && std::isfinite(seconds)) return seconds;
  throw InputError("registration " + key_name(result.candidate.from) + " - " + key_name(result.candidate.to) +
                   " reports a time of " + std::to_string(seconds) +
                   " s; cost.measured_time needs a time >= 0");
}

/// One run: the engine on a virtual clock.
class Run {
 public:
  Run(const Mission& mission, const ReplayOptions& options, const Registration& registration,
      const PrioritizerFactory& prioritizers, ThreadPool& threads, const ReplayHooks& hooks,
      const KnownOutcomes& known)
      : mission_(mission),
        options_(options),
        hooks_(hooks),
        feed_(mission_feed(mission, options)),
        decisions_(decisions_of(mission, options)),
        engine_(mission.robots, options.engine,
                queue_of(mission.robots, options, registration, prioritizers)),
        computation_(*registration.registrar, threads, hooks, known),
        optimizer_(with_threads(options.back_end.optimization, threads.num_threads())),
        log_(hooks, engine_, result_, mission.graph.nodes().size(), options.max_registrations) {
    if (options.appearance.enabled)
      appearance_.emplace(options.appearance, mission.robots, mission.scans->loader());
  }

  ReplayResult execute() {
    const Stopwatch watch;
    double mission_end = 0.0;
    for (std::size_t i = 0; i < feed_.size(); ++i) {
      events_.insert({feed_[i].time_s, EventKind::kKeyFrame, feed_[i].frame.node.key, i});
      mission_end = std::max(mission_end, feed_[i].time_s);
    }
    result_.mission_end_s = mission_end;
    end_s_ = options_.after_mission ? std::numeric_limits<double>::infinity() : mission_end;
    log_.write(journal::start_line(mission_, options_));
    for (const ClosureDecision& decision : decisions_) feed(decision);

    while (!events_.empty() && events_.begin()->time_s <= end_s_ && !hooks_.stop.stop_requested()) {
      now_s_ = events_.begin()->time_s;
      while (!events_.empty() && events_.begin()->time_s == now_s_) {
        const TimedEvent event = *events_.begin();
        events_.erase(events_.begin());
        event.kind == EventKind::kKeyFrame ? on_key_frame(feed_[event.index]) : on_result(event.index);
      }
      feed(event::Tick{});
      if (batch_.empty()) start_batch();
      log_.show(now_s_ == mission_end ? ReplayMoment::Kind::kMissionEnd : ReplayMoment::Kind::kKeyFrame,
                now_s_);
    }

    result_.interrupted = hooks_.stop.stop_requested();
    finish();
    result_.total_s = watch.seconds();
    return std::move(result_);
  }

 private:
  [[nodiscard]] const CandidateAccounting& account() const { return engine_.pool().accounting(); }

  void feed(Event event) {
    const Stopwatch watch;
    std::vector<Effect> effects = engine_.handle(std::move(event), now_s_);
    result_.decision_s += watch.seconds();
    for (Effect& effect : effects) {
      std::visit([this](auto& e) { carry_out(e); }, effect);
    }
  }

  // ---- effects

  void carry_out(effect::Closure& /*closure*/) {
    // The result of this closure comes next.
    closure_edges_.emplace_back(engine_.graph().edges().size() - 1, result_.computed.size());
  }

  void carry_out(effect::Computed& computed) {
    result_.computed.push_back({computed.result, now_s_, 0.0});
    log_.write(journal::result_line(now_s_, computed.result, account()));
  }

  void carry_out(effect::Problem& problem) {
    if (problem.cause) std::rethrow_exception(problem.cause);
    result_.problems.add(problem.topic, problem.detail);
  }

  void carry_out(effect::Optimize& optimize) {
    const Stopwatch watch;
    GncOptions options = options_.back_end.gnc;
    if (optimize.from_scratch) options.warm_growth = 0.0;
    const GncResult gnc = optimizer_.optimize_gnc(*optimize.graph, options);
    for (const auto& [edge, computed] : closure_edges_) result_.computed[computed].weight = gnc.weights[edge];
    feed(event::Optimized{gnc, false, {}});
    ++result_.optimizations;
    if (!gnc.fresh) ++result_.continued_optimizations;
    result_.optimization_s += watch.seconds();
    log_.write(journal::estimate_line(now_s_, gnc, account()));
  }

  void carry_out(effect::EstimateReady& /*estimate*/) {}

  void carry_out(effect::Compute& compute) {
    ++result_.batches;
    batch_ = std::move(compute.tasks);
    log_.write(journal::batch_line(now_s_, batch_, account()));
    const bool alike = !options_.cost.measured_time && options_.cost.refused_time_share == 1.0;
    alike ? compute_alike() : compute_timed();
    next_result_ += batch_.size();
    if (batch_.empty()) feed(event::BatchDone{});  // no candidate could become a task
  }

  // ---- key frames

  void on_key_frame(const Arrival& arrival) {
    const std::size_t generated = account().generated;
    for (const BeaconDrop& drop : arrival.drops) feed(drop);
    if (!arrival.readings.empty()) feed(event::Radio{arrival.readings});
    if (!arrival.candidates.empty()) feed(event::Candidates{arrival.candidates});
    feed(arrival.frame);
    if (appearance_) {
      const Stopwatch watch;
      event::Candidates alike{appearance_->on_node(engine_.graph(), arrival.frame.node.key, now_s_)};
      result_.decision_s += watch.seconds();
      if (!alike.candidates.empty()) feed(std::move(alike));
    }
    const std::size_t added = account().generated - generated;
    announce_scan(arrival.frame.node);
    log_.write(journal::key_frame_line(now_s_, arrival.frame.node.key, added, account()));
    log_.report(account().computed, closure_edges_.size(), reachable());
  }

  void announce_scan(const Node& node) {
    if (engine_.pool().queue().prioritizers().empty() || !mission_.scans->has(node.key)) return;
    KeyedScan scan{node.key, node.stamp_ns, nullptr};
    try {
      scan.cloud = mission_.scans->load(node.key);
    } catch (const Error& error) {  // the node's candidates wait, then expire with the reason
      result_.problems.add("unreadable scan", error.what());
      return;
    }
    if (scan.cloud) feed(event::Scan{std::move(scan)});
  }

  // ---- registration

  /// Bound on the registrations that end before the clock does, including those in progress. It is not tight,
  /// because batches wait for each other. Without a bound if times are measured, or if refused registrations
  /// take no time.
  [[nodiscard]] std::size_t reachable() const {
    const double least_s =
        options_.cost.registration_time_s * std::min(1.0, options_.cost.refused_time_share);
    if (options_.after_mission || options_.cost.measured_time || least_s == 0.0)
      return std::numeric_limits<std::size_t>::max();
    const double turns = std::floor((end_s_ - now_s_) / least_s);
    const double most = std::min(turns * static_cast<double>(options_.cost.workers), 1e15);
    return std::max(outstanding_, static_cast<std::size_t>(std::max(most, 0.0)));
  }

  void start_batch() {
    std::size_t count = batch_size(options_);
    if (const auto bound = static_cast<std::size_t>(options_.max_registrations); bound > 0) {
      const std::size_t used = account().computed;
      if (used >= bound) return;
      count = std::min(count, bound - used);
    }
    if (!engine_.wants_batch()) return;
    // While the last batch was computed, the next one could be improved; its mission time limits the
    // evaluations.
    const double evaluations = (now_s_ - batch_began_s_) / options_.cost.gi_evaluation_time_s;
    const std::vector<std::uint64_t> bounds(engine_.pool().queue().prioritizers().size(),
                                            static_cast<std::uint64_t>(std::min(evaluations, 1e12)));
    feed(event::Improve{count, hooks_.stop, bounds});
    batch_began_s_ = now_s_;
    feed(event::Choose{count});
  }

  /// If all registrations take the same time: worker k of W computes the batch's candidates k, k + W, ….
  /// Those that would end after the mission are not computed.
  void compute_alike() {
    const auto workers = static_cast<std::size_t>(options_.cost.workers);
    std::size_t paid = 0;
    for (; paid < batch_.size(); ++paid) {
      const auto turns = static_cast<double>(paid / workers + 1);
      const double finish_s = now_s_ + turns * options_.cost.registration_time_s;
      if (finish_s > end_s_) break;
      events_.insert({finish_s, EventKind::kResult, next_result_ + paid, paid});
    }
    outstanding_ = paid;
    compute(paid);
  }

  /// Mission time of one registration.
  [[nodiscard]] double duration_s(const RegistrationResult& result) const {
    if (options_.cost.measured_time) return measured_s(result);
    return options_.cost.registration_time_s * (result.verified() ? 1.0 : options_.cost.refused_time_share);
  }

  /// If times differ: the time of a registration is known only after computing it, so all are computed first.
  /// Each then goes to the worker that is free first. Results of registrations that would end after the
  /// mission are discarded.
  void compute_timed() {
    compute(batch_.size());
    std::vector<double> free_s(static_cast<std::size_t>(options_.cost.workers), now_s_);
    outstanding_ = 0;
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      if (!results_[i]) continue;  // not begun before a stop request
      const auto worker = std::min_element(free_s.begin(), free_s.end());
      *worker += duration_s(*results_[i]);
      if (*worker > end_s_) {
        results_[i].reset();
        continue;
      }
      events_.insert({*worker, EventKind::kResult, next_result_ + i, i});
      ++outstanding_;
    }
  }

  /// Computes the first `count` tasks of the batch.
  void compute(std::size_t count) {
    const std::vector<RegistrationTask> tasks(batch_.begin(),
                                              batch_.begin() + static_cast<std::ptrdiff_t>(count));
    const std::size_t before = account().computed;
    results_ = computation_.run(
        tasks, [&](std::size_t done) { log_.report(before + done, closure_edges_.size(), reachable()); });
    results_.resize(batch_.size());
  }

  void on_result(std::size_t index) {
    --outstanding_;
    // Without a result, a stop request came first, and the candidate is given back at the end.
    if (results_[index]) feed(*results_[index]);
    if (outstanding_ > 0) return;
    // Candidates that would end after the mission stay in flight until the run ends.
    if (not_computed().empty()) batch_.clear();
    feed(event::BatchDone{});
    log_.show(ReplayMoment::Kind::kBatch, now_s_);
  }

  [[nodiscard]] std::vector<LoopCandidate> not_computed() const {
    std::vector<LoopCandidate> rest;
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      if (!results_[i]) rest.push_back(batch_[i].candidate);
    }
    return rest;
  }

  void finish() {
    // After a stop request, the results that the batch already has still count.
    const std::set<TimedEvent> left = std::exchange(events_, {});
    for (const TimedEvent& event : left) {
      if (!result_.interrupted || event.kind != EventKind::kResult || !results_[event.index]) continue;
      now_s_ = event.time_s;
      on_result(event.index);
    }
    feed(event::NoMoreScans{});
    feed(event::BatchDone{not_computed()});
    feed(event::Settle{!result_.interrupted});
    const CandidatePool& pool = engine_.pool();
    take_account(pool, result_);
    result_.mission_time_s = now_s_;
    result_.registration_s = computation_.seconds();
    result_.problems.add(mission_.scans->problems());
    result_.problems.add(engine_.radio_problems());
    report_missing(decisions_, engine_.graph(), result_.problems);
    if (appearance_) result_.problems.add(appearance_->problems());
    log_.write(journal::end_line(now_s_, result_.interrupted, account()));
    log_.show(ReplayMoment::Kind::kEnd, now_s_);
    result_.graph = engine_.graph();
    result_.odometry = engine_.odometry();
  }

  const Mission& mission_;
  const ReplayOptions& options_;
  const ReplayHooks& hooks_;

  const std::vector<Arrival> feed_;
  const std::vector<ClosureDecision> decisions_;
  Engine engine_;
  std::optional<AppearanceGenerator> appearance_;
  BatchComputation computation_;
  PoseGraphOptimizer optimizer_;
  std::set<TimedEvent> events_;
  double now_s_ = 0.0;
  double end_s_ = 0.0;
  std::vector<RegistrationTask> batch_;                     // in computation; empty if the workers are idle
  std::vector<std::optional<RegistrationResult>> results_;  // of the batch, by index
  double batch_began_s_ = 0.0;
  std::size_t outstanding_ = 0;  // pending results of the batch
  std::uint64_t next_result_ = 0;
  std::vector<std::pair<std::size_t, std::size_t>> closure_edges_;  // edge of the graph, index in `computed`
  ReplayResult result_;
  const RunLog log_;
};

}  // namespace

ReplayResult run_on_virtual_clock(const Mission& mission, const ReplayOptions& options,
                                  const Registration& registration, const PrioritizerFactory& prioritizers,
                                  ThreadPool& threads, const ReplayHooks& hooks, const KnownOutcomes& known) {
  return Run(mission, options, registration, prioritizers, threads, hooks, known).execute();
}

}  // namespace loopwise
