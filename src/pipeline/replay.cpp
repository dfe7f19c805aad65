// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/replay.hpp>

#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <tuple>
#include <utility>

#include <Eigen/LU>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/batch.hpp>

#include "journal.hpp"
#include "mission_feed.hpp"

namespace loopwise {
namespace {

/// Order of events of the same time.
enum class EventKind { kKeyFrame, kResult };

struct TimedEvent {
  double time_s;
  EventKind kind;
  std::uint64_t number;  ///< Key of the key frame; place of the result within the run.
  std::size_t index;     ///< Arrival of the feed; result of the batch.

  bool operator<(const TimedEvent& other) const {
    return std::tie(time_s, kind, number) < std::tie(other.time_s, other.kind, other.number);
  }
};

std::vector<LoopCandidate> candidates_of(const std::vector<RegistrationTask>& tasks) {
  std::vector<LoopCandidate> candidates;
  candidates.reserve(tasks.size());
  for (const RegistrationTask& task : tasks) candidates.push_back(task.candidate);
  return candidates;
}

OptimizerOptions with_threads(OptimizerOptions options, int num_threads) {
  options.num_threads = num_threads;
  return options;
}

/// One run: the engine on a virtual clock.
class Run {
 public:
  Run(const Mission& mission, const Config& config, FeatureCache& features, const Registrar& registrar,
      const PrioritizerFactory& prioritizers, ThreadPool& threads, const ReplayHooks& hooks,
      const KnownOutcomes& known)
      : mission_(mission),
        config_(config),
        registrar_(registrar),
        threads_(threads),
        hooks_(hooks),
        known_(known),
        feed_(mission_feed(mission, config)),
        engine_(mission.robots, engine_options(config),
                prioritizers ? RoundRobinQueue(prioritizers())
                             : make_queue(config, mission.robots,
                                          observability_of(features, config.observability.variant))),
        optimizer_(with_threads(config.optimization, threads.num_threads())) {}

  ReplayResult execute() {
    const Stopwatch watch;
    double mission_end = 0.0;
    for (std::size_t i = 0; i < feed_.size(); ++i) {
      events_.insert({feed_[i].time_s, EventKind::kKeyFrame, feed_[i].frame.node.key, i});
      mission_end = std::max(mission_end, feed_[i].time_s);
    }
    result_.mission_end_s = mission_end;
    end_s_ = config_.replay.after_mission ? std::numeric_limits<double>::infinity() : mission_end;
    write(journal::start_line(mission_, config_));

    while (!events_.empty() && events_.begin()->time_s <= end_s_ && !hooks_.stop.stop_requested()) {
      now_s_ = events_.begin()->time_s;
      while (!events_.empty() && events_.begin()->time_s == now_s_) {
        const TimedEvent event = *events_.begin();
        events_.erase(events_.begin());
        event.kind == EventKind::kKeyFrame ? on_key_frame(feed_[event.index]) : on_result(event.index);
      }
      feed(event::Tick{});
      if (batch_.empty()) start_batch();
      show(now_s_ == mission_end ? ReplayMoment::Kind::kMissionEnd : ReplayMoment::Kind::kKeyFrame);
    }

    result_.interrupted = hooks_.stop.stop_requested();
    finish();
    result_.total_s = watch.seconds();
    return std::move(result_);
  }

 private:
  [[nodiscard]] const CandidateAccounting& account() const { return engine_.pool().accounting(); }

  void feed(Event event) {
    for (Effect& effect : engine_.handle(std::move(event), now_s_)) {
      std::visit([this](auto& e) { carry_out(e); }, effect);
    }
  }

  // ---- effects

  void carry_out(effect::Closure& /*closure*/) {
    // Its result comes next.
    closure_edges_.emplace_back(engine_.graph().edges().size() - 1, result_.computed.size());
  }

  void carry_out(effect::Computed& computed) {
    result_.computed.push_back({computed.result, now_s_, 0.0});
    write(journal::result_line(now_s_, computed.result, account()));
  }

  void carry_out(effect::Problem& problem) {
    if (problem.cause) std::rethrow_exception(problem.cause);
    result_.problems.add(problem.topic, problem.detail);
  }

  void carry_out(effect::Optimize& optimize) {
    const Stopwatch watch;
    const GncResult gnc = optimizer_.optimize_gnc(*optimize.graph, config_.gnc);
    for (const auto& [edge, computed] : closure_edges_) result_.computed[computed].weight = gnc.weights[edge];
    feed(event::Optimized{gnc, false, {}});
    ++result_.optimizations;
    result_.optimization_s += watch.seconds();
    write(journal::estimate_line(now_s_, gnc, account()));
  }

  void carry_out(effect::EstimateReady& /*estimate*/) {}

  void carry_out(effect::Compute& compute) {
    ++result_.batches;
    batch_ = std::move(compute.tasks);
    write(journal::batch_line(now_s_, candidates_of(batch_), account()));
    config_.replay.measured_time ? compute_measured() : compute_modelled();
    next_result_ += batch_.size();
    if (batch_.empty()) feed(event::BatchDone{});  // none could become a task
  }

  // ---- key frames

  void on_key_frame(const Arrival& arrival) {
    const std::size_t generated = account().generated;
    for (const BeaconDrop& drop : arrival.drops) feed(drop);
    if (!arrival.readings.empty()) feed(event::Radio{arrival.readings});
    feed(arrival.frame);
    const std::size_t added = account().generated - generated;
    announce_scan(arrival.frame.node);
    write(journal::key_frame_line(now_s_, arrival.frame.node.key, added, account()));
    ++key_frames_;
    report(account().computed);
  }

  void announce_scan(const Node& node) {
    if (engine_.pool().queue().prioritizers().empty() || !mission_.scans->has(node.key)) return;
    KeyedScan scan{node.key, node.stamp_ns, nullptr};
    try {
      scan.cloud = mission_.scans->load(node.key);
    } catch (const Error& error) {  // its candidates wait, then expire with the reason
      result_.problems.add("unreadable scan", error.what());
      return;
    }
    if (scan.cloud) feed(event::Scan{std::move(scan)});
  }

  // ---- registration

  void start_batch() {
    std::size_t count = static_cast<std::size_t>(config_.replay.batch);
    if (const auto bound = static_cast<std::size_t>(config_.replay.max_registrations); bound > 0) {
      const std::size_t used = account().computed;
      if (used >= bound) return;
      count = std::min(count, bound - used);
    }
    if (!engine_.wants_batch()) return;
    // While the last batch was computed the next one could be improved: as far as mission time allowed.
    const double evaluations = (now_s_ - batch_began_s_) / config_.replay.gi_evaluation_time_s;
    const std::vector<std::uint64_t> bounds(engine_.pool().queue().prioritizers().size(),
                                            static_cast<std::uint64_t>(std::min(evaluations, 1e12)));
    feed(event::Improve{count, hooks_.stop, bounds});
    batch_began_s_ = now_s_;
    feed(event::Choose{count});
  }

  /// Worker k of W computes the batch's candidates k, k + W, …; those that would end after the mission are
  /// not paid for, so they are not computed.
  void compute_modelled() {
    const auto workers = static_cast<std::size_t>(config_.replay.workers);
    std::vector<std::size_t> paid;
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      const std::size_t turns = i / workers + 1;
      const double finish_s = now_s_ + static_cast<double>(turns) * config_.replay.registration_time_s;
      if (finish_s > end_s_) break;
      events_.insert({finish_s, EventKind::kResult, next_result_ + i, i});
      paid.push_back(i);
    }
    outstanding_ = paid.size();
    compute(paid);
  }

  /// The time of a registration is known once it is computed: all are, each then takes its turn on the worker
  /// that is free first, and the results of those that would end after the mission are not looked at.
  void compute_measured() {
    std::vector<std::size_t> all(batch_.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    compute(all);
    std::vector<double> free_s(static_cast<std::size_t>(config_.replay.workers), now_s_);
    outstanding_ = 0;
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      if (!results_[i]) continue;  // a stop request came first
      const auto worker = std::min_element(free_s.begin(), free_s.end());
      const double finish_s = *worker + results_[i]->seconds();
      *worker = finish_s;
      if (finish_s > end_s_) {
        results_[i].reset();
        continue;
      }
      events_.insert({finish_s, EventKind::kResult, next_result_ + i, i});
      ++outstanding_;
    }
  }

  void compute(const std::vector<std::size_t>& paid) {
    const Stopwatch watch;
    results_.assign(batch_.size(), std::nullopt);
    std::vector<RegistrationTask> tasks;
    std::vector<std::size_t> places;
    std::map<std::pair<Key, Key>, std::uint64_t> task_hashes;
    for (const std::size_t i : paid) {
      const RegistrationTask& task = batch_[i];
      const std::pair<Key, Key> pair(task.candidate.from, task.candidate.to);
      const std::uint64_t task_hash = hash_of(task).low;
      const auto known = known_.find(pair);
      if (known != known_.end() && (known->second.task_hash == task_hash || known->second.task_hash == 0)) {
        results_[i] = known->second;
        results_[i]->candidate = task.candidate;
        continue;
      }
      task_hashes[pair] = task_hash;
      tasks.push_back(task);
      places.push_back(i);
    }
    const std::size_t before = account().computed;
    const auto progress = [&](const Progress& p) { report(before + p.done); };
    std::function<void(const RegistrationResult&)> outcome;
    if (hooks_.outcome) {
      outcome = [&](RegistrationResult result) {
        result.task_hash = task_hashes.at({result.candidate.from, result.candidate.to});
        hooks_.outcome(result);
      };
    }
    const auto computed = hooks_.compute
                              ? hooks_.compute(tasks, hooks_.stop, progress, outcome)
                              : compute_batch(registrar_, tasks, threads_, hooks_.stop, progress, outcome);
    for (std::size_t k = 0; k < places.size(); ++k) {
      std::optional<RegistrationResult>& result = results_[places[k]];
      result = computed[k];
      if (result) result->task_hash = task_hashes.at({result->candidate.from, result->candidate.to});
    }
    result_.registration_s += watch.seconds();
  }

  void on_result(std::size_t index) {
    --outstanding_;
    // Otherwise a stop request came first; the candidate is given back at the end.
    if (results_[index]) feed(*results_[index]);
    if (outstanding_ > 0) return;
    // Those that would end after the mission stay in flight until the run ends.
    if (not_computed().empty()) batch_.clear();
    feed(event::BatchDone{});
    show(ReplayMoment::Kind::kBatch);
  }

  [[nodiscard]] std::vector<LoopCandidate> not_computed() const {
    std::vector<LoopCandidate> rest;
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      if (!results_[i]) rest.push_back(batch_[i].candidate);
    }
    return rest;
  }

  void finish() {
    // After a stop request: what the batch had computed by then counts.
    const std::set<TimedEvent> left = std::exchange(events_, {});
    for (const TimedEvent& event : left) {
      if (!result_.interrupted || event.kind != EventKind::kResult || !results_[event.index]) continue;
      now_s_ = event.time_s;
      on_result(event.index);
    }
    feed(event::NoMoreScans{});
    feed(event::BatchDone{not_computed()});
    feed(event::Settle{});
    const CandidatePool& pool = engine_.pool();
    result_.accounting = pool.accounting();
    result_.pruned = pool.pruned_reasons();
    result_.expired = pool.expired_reasons();
    for (std::size_t i = 0; i < pool.queue().prioritizers().size(); ++i) {
      result_.handed_out.emplace_back(pool.queue().prioritizers()[i]->name(), pool.queue().handed_out()[i]);
    }
    result_.mission_time_s = now_s_;
    result_.problems.add(mission_.scans->problems());
    result_.problems.add(engine_.radio_problems());
    write(journal::end_line(now_s_, result_.interrupted, account()));
    show(ReplayMoment::Kind::kEnd);
    result_.graph = engine_.graph();
    result_.odometry = engine_.odometry();
  }

  // ---- helpers

  void write(const std::string& line) const {
    if (hooks_.journal) hooks_.journal(line);
  }

  void show(ReplayMoment::Kind kind) const {
    if (!hooks_.moment) return;
    hooks_.moment({kind, now_s_, engine_.graph(), engine_.odometry(), result_.computed, account()});
  }

  void report(std::size_t computed) const {
    if (!hooks_.progress) return;
    const CandidateAccounting& a = account();
    std::size_t total = a.computed + a.in_flight + a.pending;
    if (config_.replay.max_registrations > 0) {
      total = std::min(total, static_cast<std::size_t>(config_.replay.max_registrations));
    }
    const std::size_t verified = closure_edges_.size();
    hooks_.progress({"registering", computed, std::max(total, computed),
                     std::to_string(verified) + " accepted, " + std::to_string(a.computed - verified) +
                         " rejected, " + std::to_string(key_frames_) + "/" +
                         std::to_string(mission_.graph.nodes().size()) + " key frames"});
  }

  const Mission& mission_;
  const Config& config_;
  const Registrar& registrar_;
  ThreadPool& threads_;
  const ReplayHooks& hooks_;
  const KnownOutcomes& known_;

  const std::vector<Arrival> feed_;
  Engine engine_;
  PoseGraphOptimizer optimizer_;
  std::set<TimedEvent> events_;
  double now_s_ = 0.0;
  double end_s_ = 0.0;
  std::vector<RegistrationTask> batch_;  // being computed; empty when the computation is dry
  std::vector<std::optional<RegistrationResult>> results_;  // of the batch, by place
  double batch_began_s_ = 0.0;
  std::size_t outstanding_ = 0;  // results of the batch still to come
  std::uint64_t next_result_ = 0;
  std::vector<std::pair<std::size_t, std::size_t>> closure_edges_;  // edge of the graph, place in `computed`
  std::size_t key_frames_ = 0;
  ReplayResult result_;
};

}  // namespace

std::vector<Edge> replay_edges(const Mission& mission, const ReplayOptions& options) {
  constexpr std::uint64_t kStream =
      0x6f646f6d65747279;  // keeps this noise apart from the registrations' seeds
  std::vector<Edge> edges, sightings;
  for (Edge edge : mission.graph.edges()) {
    if (edge.kind == EdgeKind::kLandmark) sightings.push_back(edge);
    if (edge.kind != EdgeKind::kOdometry) continue;
    const double root = std::sqrt(edge.T_from_to.translation().norm());
    const double sigma_m = options.odometry_noise_m_per_m * root,
                 sigma_rad = options.odometry_noise_rad_per_m * root;
    if (sigma_m > 0.0 || sigma_rad > 0.0) {
      Rng rng(pair_seed(combine_seeds(options.seed, kStream), edge.from, edge.to));
      Vector6d noise, variance;
      for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0.0, k < 3 ? sigma_m : sigma_rad);
      variance << Eigen::Vector3d::Constant(sigma_m * sigma_m),
          Eigen::Vector3d::Constant(sigma_rad * sigma_rad);
      edge.T_from_to = se3::normalized(edge.T_from_to * se3::exp(noise));
      // (Ω⁻¹ + N)⁻¹ without inverting either: both may be singular.
      const Matrix6d& omega = edge.information;
      const Matrix6d lowered =
          (Matrix6d::Identity() + omega * variance.asDiagonal()).partialPivLu().solve(omega);
      edge.information = 0.5 * (lowered + lowered.transpose());
    }
    edges.push_back(edge);
  }
  edges.insert(edges.end(), sightings.begin(), sightings.end());
  return edges;
}

std::vector<double> arrival_times(const Mission& mission) {
  const std::vector<Node>& nodes = mission.graph.nodes();
  std::vector<std::size_t> order(nodes.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return nodes[a].key < nodes[b].key; });
  std::vector<double> times(nodes.size(), 0.0), latest(mission.robots.size(), 0.0);
  for (const std::size_t i : order) {
    const std::size_t robot = mission.robots.of(nodes[i].key);
    double time = mission.time_s(nodes[i].stamp_ns);
    for (const CommunicationGap& gap :
         mission.gaps) {  // in order of their begins: one may lead into the next
      if (gap.robot == robot && time >= gap.begin_s && time < gap.end_s) time = gap.end_s;
    }
    times[i] = latest[robot] = std::max(time, latest[robot]);
  }
  return times;
}

MissionReplay::MissionReplay(const Mission& mission, const Config& config,
                             std::shared_ptr<FeatureCache> features,
                             std::shared_ptr<const Registrar> registrar, PrioritizerFactory prioritizers)
    : mission_(mission),
      config_(config),
      features_(std::move(features)),
      registrar_(std::move(registrar)),
      prioritizers_(std::move(prioritizers)) {
  validate_config(config_);
  if (!features_) throw InputError("MissionReplay needs a feature cache");
  if (!registrar_) throw InputError("MissionReplay needs a registrar");
}

ReplayResult MissionReplay::run(ThreadPool& threads, const ReplayHooks& hooks,
                                const KnownOutcomes& known) const {
  return Run(mission_, config_, *features_, *registrar_, prioritizers_, threads, hooks, known).execute();
}

}  // namespace loopwise
