// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/replay.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <tuple>
#include <unordered_map>
#include <utility>

#include <Eigen/LU>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/batch.hpp>

#include "journal.hpp"

namespace loopwise {
namespace {

/// Order of events of the same time.
enum class EventKind { kKeyFrame, kResult };

struct Event {
  double time_s;
  EventKind kind;
  std::uint64_t number;  ///< Key of the key frame; place of the result within the run.
  std::size_t index;     ///< Node of the mission's graph; result of the batch.

  bool operator<(const Event& other) const {
    return std::tie(time_s, kind, number) < std::tie(other.time_s, other.kind, other.number);
  }
};

OptimizerOptions with_threads(OptimizerOptions options, int num_threads) {
  options.num_threads = num_threads;
  return options;
}

/// One run: everything that changes while events are handled.
class Run {
 public:
  Run(const Mission& mission, const Config& config, FeatureCache& features, const Registrar& registrar,
      const PrioritizerFactory& prioritizers, ThreadPool& threads, const ReplayHooks& hooks,
      const KnownOutcomes& known)
      : mission_(mission),
        config_(config),
        features_(features),
        registrar_(registrar),
        threads_(threads),
        hooks_(hooks),
        known_(known),
        edges_(replay_edges(mission, config.replay)),
        generator_(config.generation, mission.robots),
        radio_(config.radio, mission.robots),
        pool_(config.pool,
              prioritizers ? RoundRobinQueue(prioritizers())
                           : make_queue(config, mission.robots,
                                        [this](const KeyedScan& scan) { return eigenvalue(scan.key); }),
              mission.robots),
        optimizer_(with_threads(config.optimization, threads.num_threads())) {
    for (std::size_t e = 0; e < edges_.size(); ++e) {
      edges_at_[edges_[e].from].push_back(e);
      edges_at_[edges_[e].to].push_back(e);
    }
    for (std::size_t r = 0; r < mission.graph.ranges().size(); ++r) {
      ranges_at_[mission.graph.ranges()[r].from].push_back(r);
      ranges_at_[mission.graph.ranges()[r].to].push_back(r);
    }
    for (std::size_t g = 0; g < mission.graph.gravities().size(); ++g) {
      gravities_at_[mission.graph.gravities()[g].key].push_back(g);
    }
    for (std::size_t p = 0; p < mission.graph.priors().size(); ++p) {
      priors_at_[mission.graph.priors()[p].key].push_back(p);
    }
    const std::vector<std::string> parts = method_parts(config.replay.method);
    with_radio_ = std::find(parts.begin(), parts.end(), "rssi") != parts.end();
    if (with_radio_) {
      for (const RadioReading& reading : mission.radio) readings_at_[reading.key].push_back(reading);
      for (std::size_t b = 0; b < mission.beacons.size(); ++b) {
        drops_at_[mission.beacons[b].drop_key].push_back(b);
      }
    }
  }

  ReplayResult execute() {
    const Stopwatch watch;
    const std::vector<double> times = arrival_times(mission_);
    double mission_end = 0.0;
    for (std::size_t i = 0; i < times.size(); ++i) {
      events_.insert({times[i], EventKind::kKeyFrame, mission_.graph.nodes()[i].key, i});
      mission_end = std::max(mission_end, times[i]);
    }
    result_.mission_end_s = mission_end;
    end_s_ = config_.replay.after_mission ? std::numeric_limits<double>::infinity() : mission_end;
    write(journal::start_line(mission_, config_));

    while (!events_.empty() && events_.begin()->time_s <= end_s_ && !hooks_.stop.stop_requested()) {
      now_s_ = events_.begin()->time_s;
      while (!events_.empty() && events_.begin()->time_s == now_s_) {
        const Event event = *events_.begin();
        events_.erase(events_.begin());
        event.kind == EventKind::kKeyFrame ? on_key_frame(event.index) : on_result(event.index);
      }
      pool_.expire(now_s_);
      if (batch_.empty()) start_batch();
      show(now_s_ == mission_end ? ReplayMoment::Kind::kMissionEnd : ReplayMoment::Kind::kKeyFrame);
    }

    result_.interrupted = hooks_.stop.stop_requested();
    finish();
    result_.total_s = watch.seconds();
    return std::move(result_);
  }

 private:
  // ---- key frames
  // -------------------------------------------------------------------------------------------------

  void on_key_frame(std::size_t index) {
    const Node& recorded = mission_.graph.nodes()[index];
    Node node = recorded;
    node.covariance.reset();
    Eigen::Isometry3d odometry = recorded.pose;
    if (const auto priors = priors_at_.find(node.key); priors != priors_at_.end()) {
      node.pose = odometry = mission_.graph.priors()[priors->second.front()].pose;
    } else if (const auto previous = edge_to_known(node.key)) {
      const Eigen::Isometry3d& T = edges_[previous->edge].T_from_to;
      const Eigen::Isometry3d step = previous->forward ? T : T.inverse();
      node.pose = se3::normalized(graph_.nodes()[previous->node].pose * step);
      odometry = se3::normalized(result_.odometry[previous->node] * step);
    }
    graph_.add_node(node);
    result_.odometry.push_back(odometry);
    if (const auto priors = priors_at_.find(node.key); priors != priors_at_.end()) {
      for (const std::size_t p : priors->second) graph_.add_prior(mission_.graph.priors()[p]);
    }
    if (const auto edges = edges_at_.find(node.key); edges != edges_at_.end()) {
      for (const std::size_t e : edges->second) {
        const Edge& edge = edges_[e];
        if (!graph_.contains(edge.from) || !graph_.contains(edge.to)) continue;
        graph_.add_edge(edge);
        if (edge.kind == EdgeKind::kLandmark) new_factors_ = true;
      }
    }
    add_auxiliary_factors(node.key);

    // Generation sees each new node before its scan is announced, so that what waits for the scan is found at
    // once.
    std::vector<LoopCandidate> candidates = generator_.on_node(graph_, node.key, now_s_);
    if (with_radio_) {
      // First, so that a pair that both propose counts as radio's.
      std::vector<LoopCandidate> heard = radio_candidates(node.key);
      candidates.insert(candidates.begin(), heard.begin(), heard.end());
    }
    if (config_.replay.thin > 1) {
      candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                      [this](const LoopCandidate& c) { return !kept(c); }),
                       candidates.end());
    }
    const std::size_t added = pool_.queue().prioritizers().empty() ? 0 : pool_.add(candidates);
    announce_scan(node);
    write(journal::key_frame_line(now_s_, node.key, added, pool_.accounting()));
    ++key_frames_;
    report();
  }

  /// Gravity at the node, and ranges whose other end has come.
  void add_auxiliary_factors(Key key) {
    if (const auto gravities = gravities_at_.find(key); gravities != gravities_at_.end()) {
      for (const std::size_t g : gravities->second) graph_.add_gravity(mission_.graph.gravities()[g]);
      new_factors_ = true;
    }
    if (const auto ranges = ranges_at_.find(key); ranges != ranges_at_.end()) {
      for (const std::size_t r : ranges->second) {
        const RangeFactor& range = mission_.graph.ranges()[r];
        if (!graph_.contains(range.from) || !graph_.contains(range.to)) continue;
        graph_.add_range(range);
        new_factors_ = true;
      }
    }
  }

  /// Whether a candidate is among those that ReplayOptions::thin leaves.
  [[nodiscard]] bool kept(const LoopCandidate& candidate) const {
    constexpr std::uint64_t kStream = 0x7468696e;  // apart from the registrations' seeds
    const auto [low, high] = std::minmax(candidate.from, candidate.to);
    return pair_seed(combine_seeds(config_.replay.seed, kStream), low, high) %
               static_cast<std::uint64_t>(config_.replay.thin) ==
           0;
  }

  /// A node comes with the beacons dropped there and what it heard.
  std::vector<LoopCandidate> radio_candidates(Key key) {
    std::vector<LoopCandidate> found;
    const auto take = [&found](const std::vector<LoopCandidate>& more) {
      found.insert(found.end(), more.begin(), more.end());
    };
    if (const auto drops = drops_at_.find(key); drops != drops_at_.end()) {
      for (const std::size_t b : drops->second) take(radio_.on_drop(graph_, mission_.beacons[b], now_s_));
    }
    if (const auto readings = readings_at_.find(key); readings != readings_at_.end()) {
      take(radio_.on_radio(graph_, readings->second, now_s_));
    }
    take(radio_.on_node(graph_, key, now_s_));
    return found;
  }

  struct KnownNeighbour {
    std::size_t edge;
    std::size_t node;
    bool forward;  ///< The edge leads from the known node to the new one.
  };

  std::optional<KnownNeighbour> edge_to_known(Key key) const {
    const auto edges = edges_at_.find(key);
    if (edges == edges_at_.end()) return std::nullopt;
    for (const std::size_t e : edges->second) {
      const Edge& edge = edges_[e];
      const bool forward = edge.to == key;
      if (const auto node = graph_.find(forward ? edge.from : edge.to))
        return KnownNeighbour{e, *node, forward};
    }
    return std::nullopt;
  }

  void announce_scan(const Node& node) {
    if (pool_.queue().prioritizers().empty() || !mission_.scans->has(node.key)) return;
    KeyedScan scan;
    scan.key = node.key;
    scan.stamp_ns = node.stamp_ns;
    try {
      scan.cloud = mission_.scans->load(node.key);
    } catch (const Error& error) {
      result_.problems.add("unreadable scan",
                           error.what());  // its candidates wait, then expire with the reason
      return;
    }
    if (scan.cloud) pool_.on_scan(scan);
  }

  // ---- registration
  // -----------------------------------------------------------------------------------------------

  void start_batch() {
    std::size_t count = static_cast<std::size_t>(config_.replay.batch);
    if (const auto bound = static_cast<std::size_t>(config_.replay.max_registrations); bound > 0) {
      const std::size_t used = pool_.accounting().computed;
      if (used >= bound) return;
      count = std::min(count, bound - used);
    }
    if (pool_.accounting().pending == 0) return;
    if (graph_.nodes().size() != announced_nodes_) pool_.on_graph(graph_);
    announced_nodes_ = graph_.nodes().size();
    // While the last batch was computed the next one could be improved: as far as mission time allowed.
    const double evaluations = (now_s_ - batch_began_s_) / config_.replay.gi_evaluation_time_s;
    pool_.improve(count, hooks_.stop, static_cast<std::uint64_t>(std::min(evaluations, 1e12)));
    batch_began_s_ = now_s_;
    batch_ = pool_.take(count);
    if (batch_.empty()) return;
    ++result_.batches;
    write(journal::batch_line(now_s_, batch_, pool_.accounting()));

    config_.replay.measured_time ? compute_measured() : compute_modelled();
    next_result_ += batch_.size();
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

  /// What a registration takes is known once it is computed: all are, each then takes its turn on the worker
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
      const LoopCandidate& candidate = batch_[i];
      RegistrationTask task = task_of(candidate);
      const std::uint64_t task_hash = hash_of(task).low;
      const auto known = known_.find({candidate.from, candidate.to});
      if (known != known_.end() && (known->second.task_hash == task_hash || known->second.task_hash == 0)) {
        results_[i] = known->second;
        results_[i]->candidate = candidate;
        continue;
      }
      task_hashes[{candidate.from, candidate.to}] = task_hash;
      tasks.push_back(std::move(task));
      places.push_back(i);
    }
    const std::size_t before = pool_.accounting().computed;
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

  RegistrationTask task_of(const LoopCandidate& candidate) const {
    RegistrationTask task = make_task(graph_, mission_.robots, candidate, config_.task, config_.replay.seed,
                                      [this](Key key) { return mission_.scans->has(key); });
    const std::size_t from = graph_.index_of(candidate.from), to = graph_.index_of(candidate.to);
    if (config_.task.use_guess && config_.replay.guess == GuessSource::kOdometry) {
      task.guess_from_to = result_.odometry[from].inverse() * result_.odometry[to];
    }
    return task;
  }

  void on_result(std::size_t index) {
    --outstanding_;
    const std::optional<RegistrationResult>& result = results_[index];
    if (result) {  // otherwise a stop request came first; the candidate is given back at the end
      pool_.complete(*result);
      result_.computed.push_back({*result, now_s_, 0.0});
      if (result->reason == RejectionReason::kFailed || result->reason == RejectionReason::kTimeLimit) {
        const bool failed = result->reason == RejectionReason::kFailed;
        result_.problems.add(failed ? "registration failed" : "registration reached its time limit",
                             key_name(result->candidate.from) + " - " + key_name(result->candidate.to) +
                                 ": " + result->message);
      }
      if (result->incomplete) {
        result_.problems.add("neighbour's scan cannot be read",
                             key_name(result->candidate.from) + " - " + key_name(result->candidate.to));
      }
      write(journal::result_line(now_s_, *result, pool_.accounting()));
      if (result->verified()) {
        closure_edges_.push_back({graph_.add_closure(*result->closure), result_.computed.size() - 1});
        new_factors_ = true;
      }
    }
    if (outstanding_ > 0) return;
    // What is left of the batch would end after the mission: it stays in flight until the run ends.
    if (std::none_of(batch_.begin(), batch_.end(), [&](const LoopCandidate& c) { return is_unpaid(c); }))
      batch_.clear();
    optimize();
    show(ReplayMoment::Kind::kBatch);
  }

  bool is_unpaid(const LoopCandidate& candidate) const {
    const auto place = static_cast<std::size_t>(&candidate - batch_.data());
    return !results_[place].has_value();
  }

  // ---- back end
  // ---------------------------------------------------------------------------------------------------

  void optimize() {
    if (!new_factors_) return;
    const Stopwatch watch;
    new_factors_ = false;
    const GncResult gnc = optimizer_.optimize_gnc(graph_, config_.gnc);
    graph_.set_poses(gnc.optimization.poses);
    for (std::size_t e = 0; e < gnc.weights.size(); ++e) graph_.set_weight(e, gnc.weights[e]);
    for (const auto& [edge, computed] : closure_edges_) result_.computed[computed].weight = gnc.weights[edge];
    generator_.on_graph(graph_);
    pool_.on_graph(graph_);
    ++result_.optimizations;
    result_.optimization_s += watch.seconds();
    write(journal::estimate_line(now_s_, gnc, pool_.accounting()));
  }

  void finish() {
    // After a stop request: what the batch had computed by then counts.
    for (const Event& event : events_) {
      if (!result_.interrupted || event.kind != EventKind::kResult || !results_[event.index]) continue;
      now_s_ = event.time_s;
      on_result(event.index);
    }
    pool_.give_back(batch_);
    pool_.expire_waiting();
    optimize();
    result_.accounting = pool_.accounting();
    result_.pruned = pool_.pruned_reasons();
    result_.expired = pool_.expired_reasons();
    for (std::size_t i = 0; i < pool_.queue().prioritizers().size(); ++i) {
      result_.handed_out.emplace_back(pool_.queue().prioritizers()[i]->name(), pool_.queue().handed_out()[i]);
    }
    result_.mission_time_s = now_s_;
    result_.problems.add(mission_.scans->problems());
    result_.problems.add(radio_.problems());
    write(journal::end_line(now_s_, result_.interrupted, pool_.accounting()));
    show(ReplayMoment::Kind::kEnd);
    result_.graph = std::move(graph_);
  }

  // ---- helpers
  // ----------------------------------------------------------------------------------------------------

  void write(const std::string& line) const {
    if (hooks_.journal) hooks_.journal(line);
  }

  void show(ReplayMoment::Kind kind) const {
    if (!hooks_.moment) return;
    hooks_.moment({kind, now_s_, graph_, result_.odometry, result_.computed, pool_.accounting()});
  }

  void report() const { report(pool_.accounting().computed); }

  void report(std::size_t computed) const {
    if (!hooks_.progress) return;
    const CandidateAccounting& a = pool_.accounting();
    std::size_t total = a.computed + a.in_flight + a.pending;
    if (config_.replay.max_registrations > 0) {
      total = std::min(total, static_cast<std::size_t>(config_.replay.max_registrations));
    }
    std::size_t verified = closure_edges_.size();
    hooks_.progress({"registering", computed, std::max(total, computed),
                     std::to_string(verified) + " accepted, " + std::to_string(a.computed - verified) +
                         " rejected, " + std::to_string(key_frames_) + "/" +
                         std::to_string(mission_.graph.nodes().size()) + " key frames"});
  }

  double eigenvalue(Key key) const {
    const auto features = features_.get(key);
    if (!features) return 0.0;
    return config_.observability.variant == ObservabilityVariant::kLamp
               ? features->observability.min_eigenvalue_lamp
               : features->observability.min_eigenvalue;
  }

  const Mission& mission_;
  const Config& config_;
  FeatureCache& features_;
  const Registrar& registrar_;
  ThreadPool& threads_;
  const ReplayHooks& hooks_;
  const KnownOutcomes& known_;

  std::vector<Edge> edges_;
  std::unordered_map<Key, std::vector<std::size_t>> edges_at_;
  std::unordered_map<Key, std::vector<std::size_t>> priors_at_;
  std::unordered_map<Key, std::vector<std::size_t>> ranges_at_;
  std::unordered_map<Key, std::vector<std::size_t>> gravities_at_;
  ProximityGenerator generator_;
  RadioGenerator radio_;
  bool with_radio_ = false;
  std::unordered_map<Key, std::vector<RadioReading>> readings_at_;
  std::unordered_map<Key, std::vector<std::size_t>> drops_at_;
  CandidatePool pool_;
  PoseGraphOptimizer optimizer_;

  PoseGraph graph_;
  std::set<Event> events_;
  double now_s_ = 0.0;
  double end_s_ = 0.0;
  std::vector<LoopCandidate> batch_;  ///< Being computed; empty when the computation is dry.
  std::vector<std::optional<RegistrationResult>> results_;  ///< Of the batch, by place.
  double batch_began_s_ = 0.0;
  std::size_t announced_nodes_ = 0;  ///< Of the graph, when the prioritisers last saw it.
  std::size_t outstanding_ = 0;      ///< Results of the batch still to come.
  std::uint64_t next_result_ = 0;
  std::vector<std::pair<std::size_t, std::size_t>>
      closure_edges_;         ///< Edge of the graph, place in `computed`.
  bool new_factors_ = false;  ///< Since the last estimate: more than odometry, which estimates itself.
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
