// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/loop_closure_module.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <iterator>
#include <mutex>
#include <new>
#include <optional>
#include <set>
#include <thread>
#include <type_traits>
#include <unordered_map>
#include <unordered_set>
#include <variant>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>

#include "mailbox.hpp"
#include "path_groups.hpp"
#include "registration_crew.hpp"

namespace loopwise {
namespace {

using SharedGraph = std::shared_ptr<const PoseGraph>;

// ---- what the graph's thread is told

struct ScanEvent {
  KeyedScan scan;
};
using Factor = std::variant<Edge, PriorFactor, RangeFactor, GravityFactor>;
struct FactorEvent {
  std::vector<Factor> factors;
};
struct RadioEvent {
  std::vector<RadioReading> readings;
};
struct CandidateEvent {
  std::vector<LoopCandidate> candidates;
};
struct RemovalEvent {
  Key from, to;
};
struct BatchEvent {  // prioritisation has chosen
  std::vector<LoopCandidate> candidates;
};
struct BatchDoneEvent {
  std::vector<LoopCandidate> not_computed;
};
struct EstimateEvent {  // the back end is done
  GncResult gnc;
  std::uint64_t removals;
  bool stopped;
};
struct GraphWantedEvent {};  // prioritisation holds candidates of nodes that it does not know
struct ProblemEvent {
  std::string text;
};
using Event = std::variant<KeyFrame, ScanEvent, FactorEvent, RadioEvent, BeaconDrop, CandidateEvent,
                           ExternalEstimate, RemovalEvent, BatchEvent, RegistrationResult, BatchDoneEvent,
                           EstimateEvent, GraphWantedEvent, ProblemEvent>;

// ---- what prioritisation is told

struct AddCommand {
  std::vector<LoopCandidate> candidates;
};
struct ScanCommand {
  KeyedScan scan;
};
struct GraphCommand {
  SharedGraph graph;
};
struct ForgetCommand {  // pairs that were computed where one of them lay before
  std::vector<std::pair<Key, Key>> pairs;
};
struct ResultCommand {
  RegistrationResult result;
};
struct TimeCommand {
  double now_s;
};
struct DryCommand {  // the computation has nothing to do
  std::vector<LoopCandidate> not_computed;
};
using Command = std::variant<AddCommand, ScanCommand, GraphCommand, ForgetCommand, ResultCommand, TimeCommand,
                             DryCommand>;

struct BackEndJob {
  PoseGraph graph;
  std::uint64_t removals;
};

template <class... Functions>
struct Overloaded : Functions... {
  using Functions::operator()...;
};
template <class... Functions>
Overloaded(Functions...) -> Overloaded<Functions...>;

std::vector<Key> keys_of(const Factor& factor) {
  return std::visit(Overloaded{[](const PriorFactor& prior) { return std::vector<Key>{prior.key}; },
                               [](const GravityFactor& gravity) { return std::vector<Key>{gravity.key}; },
                               [](const auto& between) {
                                 return std::vector<Key>{between.from, between.to};
                               }},
                    factor);
}

void add(PoseGraph& graph, const Factor& factor) {
  std::visit(Overloaded{[&](const Edge& edge) { graph.add_edge(edge); },
                        [&](const PriorFactor& prior) { graph.add_prior(prior); },
                        [&](const RangeFactor& range) { graph.add_range(range); },
                        [&](const GravityFactor& gravity) { graph.add_gravity(gravity); }},
             factor);
}

/// Throws what the graph would.
void check(const Factor& factor) {
  PoseGraph scratch;
  for (const Key key : keys_of(factor)) {
    Node node;
    node.key = key;
    if (!scratch.contains(key)) scratch.add_node(node);
  }
  add(scratch, factor);
}

std::vector<Factor> factors_of(const std::vector<Edge>& edges, const std::vector<PriorFactor>& priors,
                               const std::vector<RangeFactor>& ranges,
                               const std::vector<GravityFactor>& gravities) {
  std::vector<Factor> factors(edges.begin(), edges.end());
  factors.insert(factors.end(), priors.begin(), priors.end());
  factors.insert(factors.end(), ranges.begin(), ranges.end());
  factors.insert(factors.end(), gravities.begin(), gravities.end());
  return factors;
}

std::vector<Factor> factors_of(const KeyFrame& frame) {
  return factors_of(frame.factors, frame.priors, frame.ranges, frame.gravities);
}
void check_cloud(Key key, const PointCloud& cloud) {
  for (const Eigen::Vector3f& p : cloud.points) {
    if (!p.allFinite()) throw InputError("scan of node " + key_name(key) + ": a point is not finite");
  }
}

Config module_config(Config config, const ModuleOptions& options) {
  config.replay = ReplayOptions();
  config.replay.method = options.method;
  config.replay.batch = options.batch;
  config.replay.seed = options.seed;
  return config;
}

RoundRobinQueue module_queue(const Config& config, const Robots& robots, FeatureCache& features,
                             std::vector<std::unique_ptr<Prioritizer>> own) {
  if (!own.empty()) return RoundRobinQueue(std::move(own));
  return make_queue(config, robots, [&features, &config](const KeyedScan& scan) {
    const auto of_scan = features.get(scan.key);
    if (!of_scan) return 0.0;
    return config.observability.variant == ObservabilityVariant::kLamp
               ? of_scan->observability.min_eigenvalue_lamp
               : of_scan->observability.min_eigenvalue;
  });
}

}  // namespace

class LoopClosureModule::Impl {
 public:
  Impl(const Robots& robots, const ModuleOptions& options, const Config& config, ModuleCallbacks callbacks,
       ModuleParts&& parts)
      : robots_(robots),
        options_(options),
        config_(module_config(config, options)),
        callbacks_(std::move(callbacks)),
        scans_(parts.scans),
        features_(std::make_shared<FeatureCache>([this](Key key) { return load(key); }, config.features)),
        registrar_(parts.registrar ? parts.registrar
                                   : make_registrar(RegistrarKind::kFast, config_, features_)),
        patience_(stop_source_.token()),
        inbox_(static_cast<std::size_t>(options.queue_capacity), patience_),
        commands_(static_cast<std::size_t>(options.queue_capacity), patience_),
        jobs_(1, patience_),
        batches_(1, patience_),
        groups_(robots_),
        generator_(config_.generation, robots_),
        radio_(config_.radio, robots_),
        pool_(config_.pool, module_queue(config_, robots_, *features_, std::move(parts.prioritizers)),
              robots_),
        crew_(*registrar_, options.threads, options.overdue_after_s, crew_hooks()) {
    prioritizes_ = !pool_.queue().prioritizers().empty();
    for (const auto& prioritizer : pool_.queue().prioritizers()) {
      names_.emplace_back(prioritizer->name());
      statistics_.handed_out[names_.back()] = 0;
    }
    try {
      computation_ = std::thread([this] { compute(); });
      back_end_ = std::thread([this] { optimize(); });
      prioritization_ = std::thread([this] { prioritize(); });
      graph_thread_ = std::thread([this] { handle_events(); });
    } catch (...) {  // the system has no more threads; the last one has not begun
      commands_.close();
      batches_.close();
      jobs_.close();
      for (std::thread* thread : {&computation_, &back_end_, &prioritization_}) {
        if (thread->joinable()) thread->join();
      }
      throw;
    }
  }

  ~Impl() { stop(); }

  // ---- producers' side

  bool add_key_frame(const KeyFrame& frame) {
    const Key key = frame.node.key;
    static_cast<void>(robots_.of(key));
    PoseGraph scratch;
    scratch.add_node(frame.node);
    for (const Factor& factor : factors_of(frame)) check(factor);
    if (frame.cloud) check_cloud(key, *frame.cloud);
    {
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      if (nodes_seen_.count(key) != 0) throw InputError("node " + key_name(key) + " was added before");
      nodes_seen_.insert(key);
      try {
        if (frame.cloud) keep_scan(key, frame.cloud);
      } catch (...) {
        nodes_seen_.erase(key);
        throw;
      }
    }
    try {
      return post(frame);
    } catch (...) {  // no memory: whoever tries again is not to be told that it is here
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      nodes_seen_.erase(key);
      if (frame.cloud) let_scan_go(key);
      throw;
    }
  }

  bool add_scan(Key key, std::shared_ptr<const PointCloud> cloud) {
    static_cast<void>(robots_.of(key));
    if (!cloud) throw InputError("scan of node " + key_name(key) + " is a null pointer");
    check_cloud(key, *cloud);
    {
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      keep_scan(key, cloud);
    }
    try {
      return post(ScanEvent{{key, 0, std::move(cloud)}});
    } catch (...) {
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      let_scan_go(key);
      throw;
    }
  }

  bool add_factors(std::vector<Factor> factors) {
    for (const Factor& factor : factors) {
      check(factor);
      for (const Key key : keys_of(factor)) static_cast<void>(robots_.of(key));
    }
    return post(FactorEvent{std::move(factors)});
  }

  bool add_radio(const std::vector<RadioReading>& readings) {
    for (const RadioReading& reading : readings) static_cast<void>(robots_.of(reading.key));
    return post(RadioEvent{readings});
  }

  bool add_beacon_drop(const BeaconDrop& drop) {
    static_cast<void>(robots_.of(drop.drop_key));
    return post(drop);
  }

  bool add_candidates(const std::vector<LoopCandidate>& candidates) {
    for (const LoopCandidate& candidate : candidates) {
      static_cast<void>(robots_.of(candidate.from));
      static_cast<void>(robots_.of(candidate.to));
      if (candidate.from == candidate.to) {
        throw InputError("candidate from node " + key_name(candidate.from) + " to itself");
      }
    }
    return post(CandidateEvent{candidates});
  }

  bool set_estimate(const ExternalEstimate& estimate) {
    if (options_.back_end)
      throw InputError("an estimate from outside needs ModuleOptions::back_end to be off");
    ExternalEstimate rigid = estimate;
    for (auto& [key, pose] : rigid.poses) {
      const std::string what = "estimate of node " + key_name(key);
      if (!pose.matrix().allFinite()) throw InputError(what + " is not finite");
      const double off = se3::rotation_defect(pose.linear());
      if (off > 1e-3) throw InputError(what + " is not a rigid transform");
      if (off > 1e-9) pose = se3::normalized(pose);  // rounded on its way here
    }
    for (const auto& [key, covariance] : estimate.covariances) {
      if (!covariance.allFinite()) throw InputError("covariance of node " + key_name(key) + " is not finite");
    }
    return post(std::move(rigid));
  }

  bool remove_closure(Key from, Key to) { return post(RemovalEvent{from, to}); }

  bool wait() {
    std::unique_lock<std::mutex> lock(work_mutex_);
    work_done_.wait(lock, [this] { return work_ == 0 || stopping_; });
    return !stopping_;
  }

  void stop() {
    {
      const std::lock_guard<std::mutex> lock(work_mutex_);
      stopping_ = true;
      work_done_.notify_all();
    }
    const std::lock_guard<std::mutex> lock(stop_mutex_);
    if (!graph_thread_.joinable()) return;
    stop_source_.request_stop();
    interrupt_improvement();
    inbox_.close();
    graph_thread_.join();  // ends after all others but these two
    batches_.close();
    jobs_.close();
    computation_.join();
    back_end_.join();
    const std::lock_guard<std::mutex> statistics_lock(statistics_mutex_);
    statistics_.idle_s += watch_.seconds() - since_s_;
    ended_ = true;
  }

  std::shared_ptr<const Estimate> estimate() const {
    const std::lock_guard<std::mutex> lock(graph_mutex_);
    return estimate_;
  }

  PoseGraph graph() const {
    const std::lock_guard<std::mutex> lock(graph_mutex_);
    return graph_;
  }

  ModuleStatistics statistics() const {
    ModuleStatistics result;
    {
      const std::lock_guard<std::mutex> lock(statistics_mutex_);
      result = statistics_;
      if (!ended_) (busy_ ? result.computing_s : result.idle_s) += watch_.seconds() - since_s_;
    }
    result.events_waiting = inbox_.size();
    result.commands_waiting = commands_.size();
    return result;
  }

 private:
  // ---- work that is under way: zero means that nothing will happen unless somebody adds something

  void begin_work() {
    const std::lock_guard<std::mutex> lock(work_mutex_);
    ++work_;
  }
  void end_work() {
    const std::lock_guard<std::mutex> lock(work_mutex_);
    if (--work_ == 0) work_done_.notify_all();
  }

  bool post(Event event) {
    return as_work([&] {
      // A callback runs in the thread that would make room.
      if (std::this_thread::get_id() == graph_thread_id()) return inbox_.post_now(std::move(event));
      return inbox_.post(std::move(event), [this] {
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.producer_waits;
      });
    });
  }

  /// Work that begins if `post` is taken, and does not if it is refused or finds no memory.
  template <class Post>
  bool as_work(Post&& post) {
    begin_work();
    bool taken = false;
    try {
      taken = post();
    } catch (...) {
      end_work();
      throw;
    }
    if (!taken) end_work();
    return taken;
  }

  void post_inside(Event event) { hand_on(inbox_, std::move(event)); }

  /// Work that begins unless there is no memory for it and patience is given up.
  template <class Message>
  void hand_on(Mailbox<Message>& mailbox, Message message) {
    as_work([&] { return mailbox.post_inside(std::move(message)); });
  }

  [[nodiscard]] std::thread::id graph_thread_id() const {
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    return graph_thread_id_;
  }

  /// To prioritisation. Waits for memory and for room; an improvement that would let too much wait ends
  /// early.
  void tell(Command command) {
    const bool dry = std::holds_alternative<DryCommand>(command);
    if (dry || 2 * commands_.size() >= static_cast<std::size_t>(options_.queue_capacity))
      interrupt_improvement();
    if (dry) {
      hand_on(commands_, std::move(command));
      interrupt_improvement();  // also one that has begun in between
      return;
    }
    until_memory([&] {
      as_work([&] { return commands_.post(std::move(command), [this] { interrupt_improvement(); }); });
    });
  }

  void interrupt_improvement() {
    const std::lock_guard<std::mutex> lock(improvement_mutex_);
    improvement_.request_stop();
  }

  // ---- scans

  /// With entry_mutex_ held.
  void keep_scan(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    if (!scans_seen_.insert(key).second) throw InputError("node " + key_name(key) + " has a scan already");
    try {
      if (!scans_) clouds_.emplace(key, cloud);
    } catch (...) {
      scans_seen_.erase(key);
      throw;
    }
  }

  /// With entry_mutex_ held.
  void let_scan_go(Key key) {
    scans_seen_.erase(key);
    clouds_.erase(key);
  }

  std::shared_ptr<const PointCloud> load(Key key) {
    if (scans_) return scans_(key);
    const std::lock_guard<std::mutex> lock(entry_mutex_);
    const auto found = clouds_.find(key);
    return found == clouds_.end() ? nullptr : found->second;
  }

  bool has_scan(Key key) {
    const std::lock_guard<std::mutex> lock(entry_mutex_);
    return scans_seen_.count(key) != 0;
  }

  // ---- the graph's thread

  void handle_events() {
    {
      const std::lock_guard<std::mutex> lock(statistics_mutex_);
      graph_thread_id_ = std::this_thread::get_id();
    }
    while (auto event = inbox_.next(/*expect_inside=*/computing_ || optimizing_ || being_computed_ > 0)) {
      tell_if_fails([&] { std::visit([this](auto&& e) { on(e); }, *event); });
      tell_if_fails([this] { propose_moved(); });
      tell_if_fails([this] { keep_busy(); });
      {
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.events;
        statistics_.factors_waiting = waiting_factors_.size();
        statistics_.factors_dropped = factors_dropped_;
      }
      end_work();
    }
    // Stopped. A batch that was chosen at the last moment goes back.
    commands_.close();
    prioritization_.join();
    while (auto event = inbox_.next(false)) {
      if (const auto* batch = std::get_if<BatchEvent>(&*event))
        tell_if_fails([&] { until_memory([&] { pool_.give_back(batch->candidates); }); });
      if (const auto* left = std::get_if<ProblemEvent>(&*event)) on(*left);
      end_work();
    }
    tell_if_fails([this] { until_memory([this] { publish_account(); }); });
    if (patience_.given_up()) problem(given_up_);
  }

  template <class Function>
  void tell_if_fails(Function&& function) {
    try {
      function();
    } catch (const std::exception& error) {
      problem(error);
    }
  }

  /// For what must not be left half done. \param function can be called again after std::bad_alloc
  template <class Function>
  std::invoke_result_t<Function&> until_memory(Function&& function) {
    constexpr int kTellAfter = 100;  // a second, and the time that it takes to find no memory
    Patience::Asked asked;
    for (int tried = 1;; ++tried) {
      try {
        return function();
      } catch (const std::bad_alloc&) {
        if (!patience_.wait(asked)) throw;
        if (tried == kTellAfter) tell_waiting();
      }
    }
  }

  /// For what may ask for more memory than there will ever be, as it depends on data or on code from outside:
  /// for a second, or a few times where others wait, and once where a stop is requested.
  template <class Function, class OthersWait>
  std::invoke_result_t<Function&> for_a_second(Function&& function, OthersWait&& others_wait) {
    constexpr int kTries = 4;
    std::optional<Patience::Clock::time_point> first;
    for (int tried = 1;; ++tried) {
      try {
        return function();
      } catch (const std::bad_alloc&) {
        const auto now = Patience::Clock::now();
        if (!first) first = now;
        if (now - *first > std::chrono::seconds(1) || (tried >= kTries && others_wait()) ||
            stop_source_.stop_requested()) {
          throw;
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
    }
  }
  template <class Function>
  std::invoke_result_t<Function&> for_a_second(Function&& function) {
    return for_a_second(std::forward<Function>(function), [] { return false; });
  }

  void tell_waiting() {
    if (std::this_thread::get_id() == graph_thread_id()) return problem(waiting_);
    tell_problem([this] { return waiting_; });
  }

  template <class Function>
  void change_graph(Function&& function) {
    const std::lock_guard<std::mutex> lock(graph_mutex_);
    function();
  }

  template <class Callback, class... Arguments>
  void call(const Callback& callback, const Arguments&... arguments) {
    if (!callback) return;
    try {
      callback(arguments...);
    } catch (const std::exception& error) {
      problem(std::string("a callback threw: ") + error.what());
    } catch (...) {
      problem("a callback threw something that is not a std::exception");
    }
  }

  void problem(const std::exception& error) {
    try {
      problem(std::string(error.what()));
    } catch (const std::bad_alloc&) {
      problem("out of memory");  // a text that needs none
    }
  }

  void problem(const std::string& text) {
    if (!callbacks_.problem) return;
    try {
      callbacks_.problem(text);
    } catch (...) {  // nobody is left to tell
    }
  }

  void on(const KeyFrame& frame) {
    Node node = frame.node;
    node.covariance.reset();
    std::vector<Factor> own, factors;
    until_memory([&] {
      own = factors_of(frame);
      factors = own;
      for (auto [i, end] = waiting_factors_.equal_range(node.key); i != end; ++i)
        factors.push_back(i->second.second);
    });
    const Place place = place_of(node, factors);
    node.pose = place.pose;
    if (graph_.empty()) first_stamp_ns_ = node.stamp_ns;
    now_s_ = std::max(now_s_, static_cast<double>(node.stamp_ns - first_stamp_ns_) * 1e-9);
    until_memory([&] { groups_.add(node.key, place.group, place.known); });
    try {
      until_memory([&] { change_graph([&] { graph_.add_node(node); }); });
    } catch (...) {
      groups_.take_back(node.key);
      throw;
    }
    graph_is_new_ = true;
    add_factors_now(own);
    retry_factors(node.key);

    tell_if_fails([&] { propose(until_memory([&] { return radio_.on_node(graph_, node.key, now_s_); })); });
    tell_if_fails([&] {
      if (!options_.proximity || !prioritizes_) return;
      propose(until_memory([&] { return generator_.on_node(graph_, node.key, now_s_); }));
    });
    if (const auto early = early_scans_.find(node.key); early != early_scans_.end()) {
      announce({node.key, node.stamp_ns, early->second});
      early_scans_.erase(early);
    } else if (frame.cloud) {
      announce({node.key, node.stamp_ns, frame.cloud});
    }
    drop_old_factors();
    if (prioritizes_) tell(TimeCommand{now_s_});
  }

  void on(const ScanEvent& event) {
    if (const auto node = graph_.find(event.scan.key)) {
      announce({event.scan.key, graph_.nodes()[*node].stamp_ns, event.scan.cloud});
    } else {
      until_memory([&] { early_scans_.emplace(event.scan.key, event.scan.cloud); });
    }
  }

  void announce(const KeyedScan& scan) {
    if (prioritizes_) until_memory([&] { tell(ScanCommand{scan}); });
  }

  void on(const FactorEvent& event) { add_factors_now(event.factors); }

  // ---- where nodes lie: odometry and priors place them, whether they come with their nodes, before or after

  struct Place {
    Eigen::Isometry3d pose;
    std::optional<Key> group;  ///< Any node of it.
    PathGroups::Known known;
  };

  /// Of a node that is not in the graph yet, by what is known of it.
  [[nodiscard]] Place place_of(const Node& node, const std::vector<Factor>& factors) const {
    Place place{node.pose, std::nullopt,
                groups_.has(robots_.of(node.key)) ? PathGroups::Known::kGiven : PathGroups::Known::kFirst};
    for (const Factor& factor : factors) {
      const auto* prior = std::get_if<PriorFactor>(&factor);
      if (prior != nullptr && prior->key == node.key && places(*prior)) {
        return {prior->pose, std::nullopt, PathGroups::Known::kFixed};
      }
    }
    for (const Factor& factor : factors) {
      const auto* edge = std::get_if<Edge>(&factor);
      if (edge == nullptr || edge->kind != EdgeKind::kOdometry) continue;
      const bool forward = edge->to == node.key;
      if (!forward && edge->from != node.key) continue;
      const Key other = forward ? edge->from : edge->to;
      const auto at = graph_.find(other);
      if (!at || (place.group && groups_.known(other) <= groups_.known(*place.group))) continue;
      place.group = other;
      place.pose =
          se3::normalized(graph_.nodes()[*at].pose * (forward ? edge->T_from_to : edge->T_from_to.inverse()));
    }
    return place;
  }

  /// Odometry between two nodes of the graph: of two groups that did not know of each other, that which knows
  /// less of its place moves to the other.
  void tie(const Edge& edge) {
    if (edge.kind != EdgeKind::kOdometry) return;
    const PathGroups::Tie tie = until_memory([&] { return groups_.tie(edge.from, edge.to); });
    if (tie.moved.empty()) return;
    const bool second = tie.second_moves;
    const Eigen::Isometry3d& fixed = graph_.node(second ? edge.from : edge.to).pose;
    const Eigen::Isometry3d pose =
        se3::normalized(fixed * (second ? edge.T_from_to : edge.T_from_to.inverse()));
    until_memory([&] { move_group(tie.moved, second ? edge.to : edge.from, pose); });
  }

  /// One of the position alone says nothing of the path's direction.
  [[nodiscard]] static bool places(const PriorFactor& prior) {
    return prior.information.diagonal().minCoeff() > 0.0;
  }

  void settle(const PriorFactor& prior) {
    if (!places(prior)) return;
    const std::vector<Key> moved = until_memory([&] { return groups_.fix(prior.key); });
    if (!moved.empty()) until_memory([&] { move_group(moved, prior.key, prior.pose); });
  }

  /// As one, so that `key` lies at `pose`. Without memory nothing has moved yet, and it can be tried again.
  void move_group(const std::vector<Key>& group, Key key, const Eigen::Isometry3d& pose) {
    // Also where nothing moves: an estimate that is under way does not know that it is held there.
    moved_since_job_.insert(group.begin(), group.end());
    const Eigen::Isometry3d correction = pose * graph_.node(key).pose.inverse();
    if ((correction.matrix() - Eigen::Matrix4d::Identity()).cwiseAbs().maxCoeff() < 1e-9) return;
    std::vector<Eigen::Isometry3d> poses;
    poses.reserve(group.size());
    for (const Key other : group)
      poses.push_back(other == key ? pose : se3::normalized(correction * graph_.node(other).pose));
    moved_.insert(moved_.end(), group.begin(), group.end());
    forget_outcomes(group, correction);
    change_graph([&] {
      for (std::size_t i = 0; i < group.size(); ++i) graph_.set_pose(group[i], poses[i]);
    });
    graph_is_new_ = true;
    // What closures have tied to it lies elsewhere than they say now.
    if (std::any_of(group.begin(), group.end(), [this](Key other) { return closed_.count(other) != 0; }))
      wants_estimate_ = true;
  }

  /// A group is about to move: what came of its candidates with others says nothing any more. That of those
  /// that are being computed will not either.
  void forget_outcomes(const std::vector<Key>& group, const Eigen::Isometry3d& correction) {
    constexpr double kSame_m = 0.01, kSame_rad = 0.002;  // to a registration
    const bool turns = se3::rotation_angle(correction) > kSame_rad;
    const std::unordered_set<Key> moving(group.begin(), group.end());
    const auto parted = [&](const LoopCandidate& c) {
      const bool from = moving.count(c.from) != 0, to = moving.count(c.to) != 0;
      if (from == to) return false;
      const Eigen::Vector3d t = graph_.node(from ? c.from : c.to).pose.translation();
      return turns || (correction * t - t).norm() > kSame_m;
    };
    std::vector<LoopCandidate> forgotten;
    std::set<CandidateId> under_way;
    for (const Key key : group) {
      const auto found = rejected_apart_.find(key);
      if (found == rejected_apart_.end()) continue;
      std::copy_if(found->second.begin(), found->second.end(), std::back_inserter(forgotten), parted);
    }
    for (const auto& [id, candidate] : in_computation_) {
      if (parted(candidate)) under_way.insert(id);
    }
    forgotten_.reserve(forgotten_.size() + forgotten.size());
    // From here on nothing asks for memory.
    moved_meanwhile_.merge(under_way);
    for (const LoopCandidate& candidate : forgotten) {
      forgotten_.push_back(candidate);
      for (const Key end : {candidate.from, candidate.to}) {
        const auto at = rejected_apart_.find(end);
        if (at == rejected_apart_.end()) continue;
        std::vector<LoopCandidate>& kept = at->second;
        kept.erase(std::remove_if(kept.begin(), kept.end(),
                                  [&](const LoopCandidate& c) { return c.id == candidate.id; }),
                   kept.end());
        if (kept.empty()) rejected_apart_.erase(at);
      }
    }
  }

  /// An outcome without a closure: of use as long as its nodes lie so to each other.
  void keep_rejected(const LoopCandidate& candidate, bool moved_meanwhile) {
    if (moved_meanwhile) {
      until_memory([&] { moved_.push_back(candidate.from); });
      until_memory([&] { forgotten_.push_back(candidate); });
    } else if (groups_.apart(candidate.from, candidate.to)) {
      for (const Key end : {candidate.from, candidate.to})
        until_memory([&] { rejected_apart_[end].push_back(candidate); });
    }
  }

  /// What nodes that moved since are near to now; what others than the generator proposed, whatever is near.
  void propose_moved() {
    if (!forgotten_.empty()) {
      ForgetCommand forget;
      std::vector<LoopCandidate> again;
      until_memory([&] {
        forget.pairs.reserve(forgotten_.size());
        again.reserve(forgotten_.size());
      });
      for (const LoopCandidate& candidate : forgotten_) {
        if (vetoed_.count(std::minmax(candidate.from, candidate.to)) != 0) continue;
        forget.pairs.emplace_back(candidate.from, candidate.to);
        if (candidate.source == CandidateSource::kProximity) continue;
        again.push_back(candidate);
        again.back().time_s = now_s_;
        again.back().distance_m =
            (graph_.node(candidate.from).pose.translation() - graph_.node(candidate.to).pose.translation())
                .norm();
      }
      tell(std::move(forget));
      propose(std::move(again));
      forgotten_.clear();
    }
    if (moved_.empty()) return;
    std::sort(moved_.begin(), moved_.end());
    moved_.erase(std::unique(moved_.begin(), moved_.end()), moved_.end());
    if (options_.proximity && prioritizes_)
      propose(until_memory([&] { return generator_.on_moved(graph_, moved_, now_s_); }));
    moved_.clear();
  }

  void add_factors_now(const std::vector<Factor>& factors) {
    for (const Factor& factor : factors) {
      const std::vector<Key> keys = until_memory([&] { return keys_of(factor); });
      const auto missing =
          std::find_if(keys.begin(), keys.end(), [this](Key key) { return !graph_.contains(key); });
      if (missing != keys.end()) {
        until_memory([&] { waiting_factors_.emplace(*missing, std::pair(now_s_, factor)); });
        continue;
      }
      until_memory([&] { change_graph([&] { add(graph_, factor); }); });
      const Edge* edge = std::get_if<Edge>(&factor);
      if (edge != nullptr) tie(*edge);
      if (const auto* prior = std::get_if<PriorFactor>(&factor)) settle(*prior);
      if (edge != nullptr && edge->kind != EdgeKind::kOdometry) wants_estimate_ = true;
    }
  }

  void retry_factors(Key key) {
    std::vector<Factor> factors;
    until_memory([&] {
      factors.clear();
      for (auto [i, end] = waiting_factors_.equal_range(key); i != end; ++i)
        factors.push_back(i->second.second);
    });
    waiting_factors_.erase(key);
    add_factors_now(factors);
  }

  void drop_old_factors() {
    constexpr double kCheckEvery = 1.0;  // s; a check looks at all that wait
    if (options_.max_factor_wait_s <= 0.0 || now_s_ < next_factor_check_s_) return;
    next_factor_check_s_ = now_s_ + kCheckEvery;
    for (auto i = waiting_factors_.begin(); i != waiting_factors_.end();) {
      if (now_s_ - i->second.first <= options_.max_factor_wait_s) {
        ++i;
        continue;
      }
      problem("a factor of node " + key_name(i->first) + " was dropped: the node did not come");
      i = waiting_factors_.erase(i);
      ++factors_dropped_;
    }
  }

  void on(const RadioEvent& event) {
    propose(until_memory([&] { return radio_.on_radio(graph_, event.readings, now_s_); }));
  }

  void on(const BeaconDrop& drop) {
    propose(until_memory([&] { return radio_.on_drop(graph_, drop, now_s_); }));
  }

  void on(CandidateEvent& event) {
    for (LoopCandidate& candidate : event.candidates) {
      candidate.source = CandidateSource::kUser;
      candidate.time_s = now_s_;
      const auto from = graph_.find(candidate.from), to = graph_.find(candidate.to);
      if (from && to && graph_.nodes()[*from].stamp_ns < graph_.nodes()[*to].stamp_ns) {
        std::swap(candidate.from, candidate.to);
      }
    }
    propose(std::move(event.candidates));
  }

  void propose(std::vector<LoopCandidate> candidates) {
    if (candidates.empty() || !prioritizes_) return;
    tell(AddCommand{std::move(candidates)});
  }

  void on(BatchEvent& event) {
    std::vector<RegistrationTask> tasks;
    being_computed_ += event.candidates.size();
    try {
      until_memory([&] { tasks.reserve(event.candidates.size()); });
    } catch (const std::bad_alloc&) {  // they become pending again
      post_inside(BatchDoneEvent{std::move(event.candidates)});
      throw;
    }
    for (const LoopCandidate& candidate : event.candidates) {
      try {
        until_memory([&] {
          RegistrationTask task = make_task(graph_, robots_, candidate, config_.task, options_.seed,
                                            [this](Key key) { return has_scan(key); });
          in_computation_.emplace(candidate.id, candidate);
          tasks.push_back(std::move(task));
        });
      } catch (const std::exception& error) {  // a prioritiser hands out what it was not given
        post_inside(failed_result(candidate, error.what()));
      }
    }
    computing_ = true;
    set_busy(true);
    hand_on(batches_, std::move(tasks));
  }

  void on(const RegistrationResult& result) {
    --being_computed_;
    const bool moved_meanwhile = moved_meanwhile_.erase(result.candidate.id) != 0;
    const bool was_begun = in_computation_.erase(result.candidate.id) != 0;
    tell_if_fails([&] { take(result); });                // the account counts it all the same
    until_memory([&] { tell(ResultCommand{result}); });  // or the candidate would be in flight for ever
    if (was_begun && !result.verified()) keep_rejected(result.candidate, moved_meanwhile);
  }

  void take(const RegistrationResult& result) {
    if (result.verified() && vetoed_.count(std::minmax(result.candidate.from, result.candidate.to)) == 0) {
      until_memory([&] { change_graph([&] { graph_.add_closure(*result.closure); }); });
      until_memory([&] { closed_.insert({result.candidate.from, result.candidate.to}); });
      wants_estimate_ = true;
      call(callbacks_.closure, *result.closure);
    }
    call(callbacks_.result, result);
    if (result.incomplete) {
      problem("registration " + key_name(result.candidate.from) + " - " + key_name(result.candidate.to) +
              ": a neighbour's scan cannot be read");
    }
    if (result.reason == RejectionReason::kFailed || result.reason == RejectionReason::kTimeLimit) {
      problem("registration " + key_name(result.candidate.from) + " - " + key_name(result.candidate.to) +
              ": " + (result.reason == RejectionReason::kFailed ? "failed: " : "time limit: ") +
              result.message);
    }
  }

  void on(BatchDoneEvent& event) {
    computing_ = false;
    being_computed_ -= event.not_computed.size();
    for (const LoopCandidate& candidate : event.not_computed) {
      in_computation_.erase(candidate.id);
      moved_meanwhile_.erase(candidate.id);
    }
    set_busy(false);
    try {
      if (graph_is_new_) tell(GraphCommand{snapshot()});
    } catch (const std::bad_alloc& error) {  // without the next batch all would stand still
      problem(error);
    }
    tell(DryCommand{std::move(event.not_computed)});
  }

  void on(const RemovalEvent& event) {
    until_memory([&] { vetoed_.insert(std::minmax(event.from, event.to)); });
    std::size_t removed = 0;
    const auto is_it = [&](const Edge& edge) {
      return edge.kind == EdgeKind::kLoopClosure &&
             std::minmax(edge.from, edge.to) == std::minmax(event.from, event.to);
    };
    until_memory([&] { change_graph([&] { removed = graph_.remove_edges_if(is_it); }); });
    if (removed == 0) return;
    ++removals_;
    wants_estimate_ = true;
  }

  void on(const EstimateEvent& event) {
    optimizing_ = false;
    // One made with edges that were taken out since is not worth keeping: the next is already wanted.
    if (event.stopped || event.removals != removals_) {
      wants_estimate_ = wants_estimate_ || !event.stopped;
      return;
    }
    const std::vector<Eigen::Isometry3d>& poses = event.gnc.optimization.poses;
    std::map<Key, Eigen::Isometry3d> named;
    until_memory([&] {
      for (std::size_t i = 0; i < poses.size(); ++i) {
        // What odometry or a prior has moved since lies where these say, and goes along with what it was
        // tied to.
        const Key key = graph_.nodes()[i].key;
        if (moved_since_job_.count(key) == 0) named.emplace(key, poses[i]);
      }
    });
    change_graph([&] {
      for (std::size_t e = 0; e < event.gnc.weights.size(); ++e) graph_.set_weight(e, event.gnc.weights[e]);
    });
    until_memory([&] { move_nodes(named); });
    if (is_torn(poses, event.gnc.weights.size())) wants_estimate_ = true;
    publish();
  }

  /// Whether what came while the estimate was made does not fit it: what odometry or priors have placed since
  /// lies elsewhere than the estimate has it, or they do not hold between that and the rest.
  [[nodiscard]] bool is_torn(const std::vector<Eigen::Isometry3d>& estimated,
                             std::size_t edges_estimated) const {
    if (moved_since_job_.empty()) return false;
    constexpr double kFits = 1e-6;  // m and rad
    const auto fits = [](const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
      return se3::log(a.inverse() * b).cwiseAbs().maxCoeff() < kFits;
    };
    const auto placed = [this](Key key) { return moved_since_job_.count(key) != 0; };
    // Of what odometry alone had tied together, it says no more than where it lay.
    for (std::size_t e = 0; e < edges_estimated; ++e) {
      const Edge& edge = graph_.edges()[e];
      if (edge.kind == EdgeKind::kOdometry) continue;
      for (const Key end : {edge.from, edge.to}) {
        if (placed(end) && !fits(graph_.node(end).pose, estimated[*graph_.find(end)])) return true;
      }
    }
    const bool edges_fit = std::all_of(graph_.edges().begin(), graph_.edges().end(), [&](const Edge& edge) {
      if (edge.kind != EdgeKind::kOdometry || placed(edge.from) == placed(edge.to)) return true;
      return fits(graph_.node(edge.from).pose * edge.T_from_to, graph_.node(edge.to).pose);
    });
    return !edges_fit ||
           std::any_of(graph_.priors().begin(), graph_.priors().end(), [&](const PriorFactor& prior) {
             return places(prior) && placed(prior.key) && !fits(prior.pose, graph_.node(prior.key).pose);
           });
  }

  void on(const ExternalEstimate& estimate) {
    std::map<Key, Eigen::Isometry3d> named;
    until_memory([&] {
      for (const auto& [key, pose] : estimate.poses) {
        if (graph_.contains(key)) named.emplace(key, pose);
      }
    });
    until_memory([&] { move_nodes(named); });
    for (const auto& [key, pose] : named)
      until_memory([&, node = key] { static_cast<void>(groups_.fix(node)); });
    change_graph([&] {
      for (const auto& [key, covariance] : estimate.covariances) {
        if (const auto node = graph_.find(key)) graph_.set_covariance(*node, covariance);
      }
    });
    publish();
  }

  void on(const GraphWantedEvent&) {
    if (graph_is_new_) tell(GraphCommand{snapshot()});
  }

  void on(const ProblemEvent& event) { problem(event.text); }

  /// Sets the poses of the named nodes; the others of a robot move with the nearest named one before them.
  void move_nodes(const std::map<Key, Eigen::Isometry3d>& named) {
    std::vector<std::pair<std::size_t, std::size_t>> order;  // robot, node
    order.reserve(graph_.nodes().size());
    for (std::size_t i = 0; i < graph_.nodes().size(); ++i)
      order.emplace_back(robots_.of(graph_.nodes()[i].key), i);
    std::sort(order.begin(), order.end(), [this](const auto& a, const auto& b) {
      return std::pair(a.first, graph_.nodes()[a.second].key) <
             std::pair(b.first, graph_.nodes()[b.second].key);
    });
    std::vector<Eigen::Isometry3d> poses = graph_.poses();
    Eigen::Isometry3d correction = Eigen::Isometry3d::Identity();
    for (std::size_t k = 0; k < order.size(); ++k) {
      const auto [robot, i] = order[k];
      if (k == 0 || order[k - 1].first != robot) correction.setIdentity();
      if (const auto found = named.find(graph_.nodes()[i].key); found != named.end()) {
        correction = found->second * poses[i].inverse();
        poses[i] = found->second;
      } else {
        poses[i] = se3::normalized(correction * poses[i]);
      }
    }
    change_graph([&] { graph_.set_poses(poses); });
  }

  void publish() {
    const auto estimate = until_memory([this] {
      auto copy = std::make_shared<Estimate>();
      copy->graph = graph_;
      return copy;
    });
    for (const Edge& edge : graph_.edges()) {
      if (edge.kind != EdgeKind::kLoopClosure) continue;
      ++estimate->closures;
      if (edge.weight > 0.5) ++estimate->inliers;
    }
    until_memory([this] { generator_.on_graph(graph_); });
    {
      const std::lock_guard<std::mutex> lock(graph_mutex_);
      estimate->revision = estimate_ ? estimate_->revision + 1 : 1;
      estimate_ = estimate;
    }
    graph_is_new_ = false;
    if (prioritizes_) tell(GraphCommand{SharedGraph(estimate, &estimate->graph)});
    call(callbacks_.estimate, std::shared_ptr<const Estimate>(estimate));
  }

  [[nodiscard]] SharedGraph snapshot() {
    auto graph = until_memory([this] { return std::make_shared<const PoseGraph>(graph_); });
    graph_is_new_ = false;
    return graph;
  }

  /// After each event: starts what there is reason for.
  void keep_busy() {
    const bool stopping = stop_source_.stop_requested();
    if (wants_estimate_ && options_.back_end && !optimizing_ && !computing_ && !stopping) {
      BackEndJob job = until_memory([this] { return BackEndJob{graph_, removals_}; });
      moved_since_job_.clear();
      wants_estimate_ = false;
      optimizing_ = true;
      hand_on(jobs_, std::move(job));
    }
  }

  void set_busy(bool busy) {
    const double now = watch_.seconds();
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    (busy_ ? statistics_.computing_s : statistics_.idle_s) += now - since_s_;
    if (busy) ++statistics_.batches;
    busy_ = busy;
    since_s_ = now;
  }

  // ---- computation

  void compute() {
    while (auto tasks = batches_.next(false)) {
      BatchDoneEvent done;
      try {
        until_memory([&] { done.not_computed = crew_.run(*tasks, stop_source_.token()); });
      } catch (const std::bad_alloc&) {  // before any was begun
        for (const RegistrationTask& task : *tasks)
          post_inside(failed_result(task.candidate, "out of memory"));
      }
      post_inside(std::move(done));
      end_work();
    }
  }

  [[nodiscard]] RegistrationCrew::Hooks crew_hooks() {
    RegistrationCrew::Hooks hooks;
    hooks.result = [this](RegistrationResult&& result) { post_inside(std::move(result)); };
    hooks.overdue = [this](const LoopCandidate& candidate, double seconds) {
      begin_work();  // wait() waits for it, a batch does not
      {
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.overdue;
        ++statistics_.overdue_now;
      }
      tell_problem([&] {
        return "registration " + key_name(candidate.from) + " - " + key_name(candidate.to) +
               " has not come back after " + std::to_string(std::llround(seconds)) +
               " s: the others go on without its thread";
      });
    };
    hooks.back = [this] {
      {
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        --statistics_.overdue_now;
      }
      end_work();
    };
    return hooks;
  }

  /// A problem that another thread than the graph's has met. Without memory for its words there are fewer of
  /// them.
  template <class Words>
  void tell_problem(Words&& words) {
    ProblemEvent event;
    try {
      event.text = words();
    } catch (const std::bad_alloc&) {
      event.text = "out of memory";
    }
    post_inside(std::move(event));
  }

  // ---- back end

  void optimize() {
    std::optional<PoseGraphOptimizer> optimizer;
    while (auto job = jobs_.next(false)) {
      EstimateEvent done{{}, job->removals, true};
      try {
        if (!optimizer) optimizer.emplace(config_.optimization);
        done.gnc = for_a_second(
            [&] { return optimizer->optimize_gnc(job->graph, config_.gnc, stop_source_.token()); });
        done.stopped = done.gnc.optimization.termination == Termination::kStopped;
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.optimizations;
      } catch (const std::exception& error) {
        tell_problem([&] { return std::string("the back end failed: ") + error.what(); });
      }
      post_inside(std::move(done));
      end_work();
    }
  }

  // ---- prioritisation

  void prioritize() {
    bool dry = true;        // the computation waits for a batch
    bool improved = false;  // nothing has changed since the last improvement came to its end
    while (auto first = commands_.next(false)) {
      std::optional<Command> command = std::move(first);
      std::size_t handled = 0;
      // All that waits is delivered before the next set; but a prepared set is handed out before what came
      // while it was being prepared makes it old. What comes meanwhile is left for the next turn: where more
      // keeps coming, the account would never be told.
      const std::size_t waiting = commands_.size();
      while (command) {
        apply(*command, dry);
        ++handled;
        command.reset();
        if (handled <= waiting && commands_.size() > 0) command = commands_.next(false);
      }
      improved = false;
      hand_out(dry);
      guarded([this] { publish_account(); });
      for (; handled > 0; --handled) end_work();

      while (!dry && !improved && commands_.size() == 0 && pool_.accounting().pending > 0) {
        improved = true;
        StopToken token;
        bool can_be_stopped = false;
        guarded([&] {
          const std::lock_guard<std::mutex> lock(improvement_mutex_);
          improvement_ = StopSource();
          token = improvement_.token();
          can_be_stopped = true;
        });
        if (!can_be_stopped) break;
        if (commands_.size() > 0 || stop_source_.stop_requested()) break;
        guarded([&] { pool_.improve(static_cast<std::size_t>(options_.batch), token); });
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.improvements;
      }
    }
  }

  template <class Function>
  void guarded(Function&& function) {
    try {
      function();
    } catch (const std::exception& error) {
      tell_problem([&] { return std::string("prioritisation: ") + error.what(); });
    } catch (...) {
      tell_problem(
          [] { return std::string("prioritisation: something that is not a std::exception was thrown"); });
    }
  }

  void apply(Command& command, bool& dry) {
    guarded([&] {
      std::visit(Overloaded{[&](AddCommand& c) { until_memory([&] { pool_.add(c.candidates); }); },
                            [&](ScanCommand& c) { take_scan(c.scan); },
                            [&](GraphCommand& c) { take_graph(std::move(c.graph)); },
                            [&](ForgetCommand& c) { pool_.forget(c.pairs); },
                            [&](ResultCommand& c) { pool_.complete(c.result); },
                            [&](TimeCommand& c) {
                              now_of_pool_s_ = std::max(now_of_pool_s_, c.now_s);
                              pool_.expire(c.now_s);
                            },
                            [&](DryCommand& c) {
                              dry = true;
                              until_memory([&] { pool_.give_back(c.not_computed); });
                              hand_out(dry);
                            }},
                 command);
    });
  }

  /// A scan whose features ask for more memory than there is must not hold all that comes after it.
  void take_scan(const KeyedScan& scan) {
    try {
      for_a_second([&] { pool_.on_scan(scan); });
    } catch (const std::bad_alloc&) {
      until_memory([&] { pool_.on_scan(scan, /*whatever_fails=*/true); });
      throw;
    }
  }

  void take_graph(SharedGraph graph) {
    graph_owed_ = std::move(graph);
    try {
      for_a_second([this] { pool_.on_graph(*graph_owed_); });
    } catch (const std::bad_alloc&) {
      throw;
    } catch (...) {  // another try would end no better
      graph_owed_.reset();
      throw;
    }
    graph_owed_.reset();
  }

  /// An estimate that there was no memory for, before the next batch is chosen without it.
  void try_graph_again() {
    if (!graph_owed_) return;
    guarded([this] {
      try {
        pool_.on_graph(*graph_owed_);
      } catch (const std::bad_alloc&) {  // has been told
        return;
      } catch (...) {
        graph_owed_.reset();
        throw;
      }
      graph_owed_.reset();
    });
  }

  void hand_out(bool& dry) {
    if (!dry || pool_.accounting().pending == 0 || stop_source_.stop_requested()) return;
    try_graph_again();
    guarded([&] {
      std::vector<LoopCandidate> batch = choose();
      if (batch.empty()) return post_inside(GraphWantedEvent{});
      dry = false;
      post_inside(BatchEvent{std::move(batch)});
    });
  }

  std::vector<LoopCandidate> choose() {
    return for_a_second([&] { return pool_.take(static_cast<std::size_t>(options_.batch)); },
                        [this] { return commands_.size() > 0; });
  }

  void publish_account() {
    const std::optional<double> oldest = pool_.oldest_pending_s();
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    statistics_.candidates = pool_.accounting();
    statistics_.oldest_pending_s = oldest ? now_of_pool_s_ - *oldest : 0.0;
    for (std::size_t i = 0; i < names_.size(); ++i)
      statistics_.handed_out[names_[i]] = pool_.queue().handed_out()[i];
  }

  const Robots robots_;
  const ModuleOptions options_;
  const Config config_;
  const ModuleCallbacks callbacks_;
  const ScanLoader scans_;
  std::shared_ptr<FeatureCache> features_;
  std::shared_ptr<const Registrar> registrar_;

  std::mutex entry_mutex_;  // of what producers are checked against
  std::unordered_set<Key> nodes_seen_, scans_seen_;
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> clouds_;

  StopSource stop_source_;
  Patience patience_;
  const std::string waiting_ = "out of memory: waiting until there is some";
  const std::string given_up_ = "out of memory: what was under way when it was stopped is lost";
  Mailbox<Event> inbox_;
  Mailbox<Command> commands_;
  Mailbox<BackEndJob> jobs_;
  Mailbox<std::vector<RegistrationTask>> batches_;
  std::mutex improvement_mutex_;
  StopSource improvement_;

  std::mutex work_mutex_;
  std::condition_variable work_done_;
  std::size_t work_ = 0;
  bool stopping_ = false;

  mutable std::mutex graph_mutex_;  // of graph_ and estimate_; the graph's thread alone writes
  PoseGraph graph_;
  std::shared_ptr<const Estimate> estimate_;

  // The graph's thread alone.
  PathGroups groups_;
  std::vector<Key> moved_;                   // since their neighbours were proposed
  std::unordered_set<Key> moved_since_job_;  // of the back end
  std::unordered_set<Key> closed_;           // nodes with a closure, perhaps taken out since
  // Candidates of nodes that may still move against each other: without a closure, by each of the two ...
  std::unordered_map<Key, std::vector<LoopCandidate>> rejected_apart_;
  std::vector<LoopCandidate> forgotten_;                 // ... and those of them that have moved since
  std::map<CandidateId, LoopCandidate> in_computation_;  // with their guess
  std::set<CandidateId> moved_meanwhile_;                // of these
  ProximityGenerator generator_;
  RadioGenerator radio_;
  bool prioritizes_ = true;
  bool graph_is_new_ = false;
  bool computing_ = false, optimizing_ = false, wants_estimate_ = false;
  std::size_t being_computed_ = 0;  // results that will still come, also of batches that are done
  std::uint64_t removals_ = 0;
  std::int64_t first_stamp_ns_ = 0;
  double now_s_ = 0.0, next_factor_check_s_ = 0.0;
  std::multimap<Key, std::pair<double, Factor>>
      waiting_factors_;  // by a missing node; with the time of arrival
  std::size_t factors_dropped_ = 0;
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> early_scans_;  // before their nodes
  std::set<std::pair<Key, Key>> vetoed_;

  // Prioritisation's thread alone.
  CandidatePool pool_;
  SharedGraph graph_owed_;  // there was no memory for a prioritiser's view of it
  double now_of_pool_s_ = 0.0;
  std::vector<std::string> names_;

  mutable std::mutex statistics_mutex_;
  ModuleStatistics statistics_;
  Stopwatch watch_;
  bool busy_ = false, ended_ = false;  // the computation
  double since_s_ = 0.0;               // by watch_
  std::thread::id graph_thread_id_;

  std::mutex stop_mutex_;
  std::thread computation_, back_end_, prioritization_, graph_thread_;
  RegistrationCrew crew_;  // last: its threads may still be on their way out of the hooks
};

LoopClosureModule::LoopClosureModule(const Robots& robots, const ModuleOptions& options, const Config& config,
                                     ModuleCallbacks callbacks, ModuleParts parts) {
  validate(options);
  validate_config(config);
  impl_ = std::make_unique<Impl>(robots, options, config, std::move(callbacks), std::move(parts));
}

LoopClosureModule::~LoopClosureModule() = default;

bool LoopClosureModule::add_key_frame(const KeyFrame& frame) {
  return impl_->add_key_frame(frame);
}
bool LoopClosureModule::add_scan(Key key, std::shared_ptr<const PointCloud> cloud) {
  return impl_->add_scan(key, std::move(cloud));
}
bool LoopClosureModule::add_factors(const std::vector<Edge>& edges, const std::vector<PriorFactor>& priors,
                                    const std::vector<RangeFactor>& ranges,
                                    const std::vector<GravityFactor>& gravities) {
  return impl_->add_factors(factors_of(edges, priors, ranges, gravities));
}
bool LoopClosureModule::add_radio(const std::vector<RadioReading>& readings) {
  return impl_->add_radio(readings);
}
bool LoopClosureModule::add_beacon_drop(const BeaconDrop& drop) {
  return impl_->add_beacon_drop(drop);
}
bool LoopClosureModule::add_candidates(const std::vector<LoopCandidate>& candidates) {
  return impl_->add_candidates(candidates);
}
bool LoopClosureModule::set_estimate(const ExternalEstimate& estimate) {
  return impl_->set_estimate(estimate);
}
bool LoopClosureModule::remove_closure(Key from, Key to) {
  return impl_->remove_closure(from, to);
}
bool LoopClosureModule::wait() {
  return impl_->wait();
}
void LoopClosureModule::stop() {
  impl_->stop();
}
std::shared_ptr<const Estimate> LoopClosureModule::estimate() const {
  return impl_->estimate();
}
PoseGraph LoopClosureModule::graph() const {
  return impl_->graph();
}
ModuleStatistics LoopClosureModule::statistics() const {
  return impl_->statistics();
}

}  // namespace loopwise
