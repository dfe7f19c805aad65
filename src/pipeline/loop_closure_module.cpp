// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/loop_closure_module.hpp>

#include <atomic>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <new>
#include <optional>
#include <thread>
#include <unordered_map>
#include <unordered_set>
#include <variant>

#include <loopwise/core/error.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "mailbox.hpp"
#include "registration_crew.hpp"

namespace loopwise {
namespace {

/// What the engine's thread is sent: events, and problems that other threads have met.
using Message = std::variant<Event, effect::Problem>;

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
  return make_queue(config, robots, observability_of(features, config.observability.variant));
}

}  // namespace

EngineOptions engine_options(const Config& config, const ModuleOptions& options) {
  EngineOptions engine = engine_options(module_config(config, options));
  engine.proximity = options.proximity;
  engine.back_end = options.back_end;
  engine.max_factor_wait_s = options.max_factor_wait_s;
  return engine;
}

class LoopClosureModule::Impl {
 public:
  Impl(const Robots& robots, const ModuleOptions& options, const Config& config, ModuleCallbacks callbacks,
       ModuleParts&& parts)
      : robots_(robots),
        options_(options),
        config_(module_config(config, options)),
        callbacks_(std::move(callbacks)),
        scans_(parts.scans),
        on_event_(parts.on_event),
        clock_(parts.clock ? parts.clock : std::make_shared<const RealClock>()),
        features_(std::make_shared<FeatureCache>([this](Key key) { return load(key); }, config.features)),
        registrar_(parts.registrar ? parts.registrar
                                   : make_registrar(RegistrarKind::kFast, config_, features_)),
        inbox_(static_cast<std::size_t>(options.queue_capacity)),
        jobs_(1),
        batches_(1),
        engine_(robots_, engine_options(config_, options),
                module_queue(config_, robots_, *features_, std::move(parts.prioritizers))),
        crew_(*registrar_, options.threads, options.overdue_after_s, crew_hooks()) {
    publish_statistics();
    try {
      computation_ = std::thread([this] { compute(); });
      back_end_ = std::thread([this] { optimize(); });
      engine_thread_ = std::thread([this] { run(); });
    } catch (...) {  // the system has no more threads; the last one has not begun
      batches_.close();
      jobs_.close();
      for (std::thread* thread : {&computation_, &back_end_}) {
        if (thread->joinable()) thread->join();
      }
      throw;
    }
  }

  ~Impl() { stop(); }

  // ---- producers' side

  bool add_key_frame(const KeyFrame& frame) {
    const Key key = frame.node.key;
    Event event = checked(frame);
    if (frame.cloud) check_cloud(key, *frame.cloud);
    {
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      if (nodes_seen_.count(key) != 0) throw InputError("node " + key_name(key) + " was added before");
      if (frame.cloud) keep_scan(key, frame.cloud);
      nodes_seen_.insert(key);
    }
    return post(std::move(event));
  }

  bool add_scan(Key key, std::shared_ptr<const PointCloud> cloud) {
    Event event = checked(event::Scan{{key, 0, cloud}});
    check_cloud(key, *cloud);
    {
      const std::lock_guard<std::mutex> lock(entry_mutex_);
      keep_scan(key, cloud);
    }
    return post(std::move(event));
  }

  /// Any other event from outside.
  bool add(Event event) { return post(checked(std::move(event))); }

  bool set_estimate(const ExternalEstimate& estimate) {
    if (options_.back_end)
      throw InputError("an estimate from outside needs ModuleOptions::back_end to be off");
    return add(estimate);
  }

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
    if (!engine_thread_.joinable()) return;
    stop_source_.request_stop();
    interrupt_improvement();
    inbox_.close();
    engine_thread_.join();
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
    return engine_.graph();
  }

  ModuleStatistics statistics() const {
    ModuleStatistics result;
    {
      const std::lock_guard<std::mutex> lock(statistics_mutex_);
      result = statistics_;
      if (!ended_) (busy_ ? result.computing_s : result.idle_s) += watch_.seconds() - since_s_;
    }
    result.events_waiting = inbox_.size();
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

  [[nodiscard]] Event checked(Event event) const {
    check_event(event, robots_);
    return event;
  }

  bool post(Event event) {
    begin_work();
    bool taken = false;
    try {
      // Callbacks and prioritisers run in the thread that would make room.
      if (std::this_thread::get_id() == engine_thread_id()) {
        taken = inbox_.post_now(std::move(event));
      } else {
        taken = inbox_.post(std::move(event), [this] {
          const std::lock_guard<std::mutex> lock(statistics_mutex_);
          ++statistics_.producer_waits;
        });
        if (half_full()) interrupt_improvement();
      }
    } catch (...) {
      end_work();
      throw;
    }
    if (!taken) end_work();
    return taken;
  }

  void post_inside(Message message) {
    begin_work();
    try {
      inbox_.post_inside(std::move(message));
    } catch (...) {
      end_work();
      throw;
    }
    interrupt_improvement();
  }

  [[nodiscard]] bool half_full() const {
    return 2 * inbox_.size() > static_cast<std::size_t>(options_.queue_capacity);
  }

  [[nodiscard]] std::thread::id engine_thread_id() const {
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    return engine_thread_id_;
  }

  void interrupt_improvement() {
    const std::lock_guard<std::mutex> lock(improvement_mutex_);
    improvement_.request_stop();
  }

  // ---- scans

  /// With entry_mutex_ held.
  void keep_scan(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    if (scans_seen_.count(key) != 0) throw InputError("node " + key_name(key) + " has a scan already");
    if (!scans_) clouds_.emplace(key, cloud);
    scans_seen_.insert(key);
  }

  std::shared_ptr<const PointCloud> load(Key key) {
    if (scans_) return scans_(key);
    const std::lock_guard<std::mutex> lock(entry_mutex_);
    const auto found = clouds_.find(key);
    return found == clouds_.end() ? nullptr : found->second;
  }

  // ---- the engine's thread

  void run() {
    {
      const std::lock_guard<std::mutex> lock(statistics_mutex_);
      engine_thread_id_ = std::this_thread::get_id();
    }
    try {
      while (auto message = next_message()) {
        if (auto* event = std::get_if<Event>(&*message)) {
          if (!std::holds_alternative<RegistrationResult>(*event)) improved_ = improving_ = false;
          feed(std::move(*event));
        } else {
          carry_out(std::get<effect::Problem>(*message));
        }
        keep_busy();
        ++events_;
        publish_statistics();
        end_work();
      }
      publish_statistics();
    } catch (const std::bad_alloc&) {
      out_of_memory_ = true;
    }
    if (out_of_memory_) end_without_memory();
  }

  /// While a batch is computed, the next set is improved. Events from outside wait meanwhile, so that a
  /// prepared set is handed out before they make it old: until the set cannot be improved further, the
  /// computation runs dry, or the inbox is half full.
  std::optional<Message> next_message() {
    while (engine_.computing() && !improved_ && engine_.pool().accounting().pending > 0 &&
           (improving_ ? !half_full() : inbox_.size() == 0) && !stop_source_.stop_requested()) {
      if (auto message = inbox_.try_next_inside()) return message;
      improving_ = true;
      improve();
    }
    return inbox_.next(engine_.computing() || engine_.optimizing() || engine_.in_computation() > 0);
  }

  void improve() {
    StopToken token;
    {
      const std::lock_guard<std::mutex> lock(improvement_mutex_);
      improvement_ = StopSource();
      token = improvement_.token();
    }
    if (inbox_.inside_waits() || half_full() || stop_source_.stop_requested()) return;
    improved_ = true;  // unless it is interrupted
    feed(event::Improve{static_cast<std::size_t>(options_.batch), token, {}});
    improved_ = !token.stop_requested();
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    ++statistics_.improvements;
  }

  /// The one way into the engine.
  void feed(Event event) {
    Event record = on_event_ ? event : Event();
    const double now_s = clock_->now();
    std::vector<Effect> effects;
    try {
      std::unique_lock<std::mutex> lock(graph_mutex_, std::defer_lock);
      // These two may take long, and leave the graph alone.
      const bool chooses =
          std::holds_alternative<event::Choose>(event) || std::holds_alternative<event::Improve>(event);
      if (!chooses) lock.lock();
      effects = engine_.handle(std::move(event), now_s);
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      return problem(error.what());
    }
    if (on_event_) {
      if (auto* improve = std::get_if<event::Improve>(&record)) {
        improve->stop = StopToken();
        improve->max_evaluations = engine_.evaluations();
      }
      call(on_event_, record, now_s);
    }
    for (Effect& effect : effects) std::visit([this](auto& e) { carry_out(e); }, effect);
  }

  /// After each event: starts what there is reason for.
  void keep_busy() {
    constexpr double kTick_s = 1.0;
    if (clock_->now() >= last_tick_s_ + kTick_s) {
      last_tick_s_ = clock_->now();
      feed(event::Tick{});
    }
    if (stop_source_.stop_requested()) return;
    if (engine_.wants_estimate() && !engine_.optimizing() && !engine_.computing()) feed(event::Settle{});
    if (engine_.wants_batch()) feed(event::Choose{static_cast<std::size_t>(options_.batch)});
  }

  // ---- effects

  void carry_out(effect::Compute& compute) {
    improved_ = improving_ = false;
    set_busy(true);
    begin_work();
    batches_.post_inside(std::move(compute.tasks));
  }

  void carry_out(effect::Optimize& optimize) {
    begin_work();
    jobs_.post_inside(std::move(optimize.graph));
  }

  void carry_out(effect::Closure& closure) { call(callbacks_.closure, closure.closure); }
  void carry_out(effect::Computed& computed) { call(callbacks_.result, computed.result); }

  void carry_out(effect::EstimateReady& ready) {
    {
      const std::lock_guard<std::mutex> lock(graph_mutex_);
      estimate_ = ready.estimate;
    }
    call(callbacks_.estimate, ready.estimate);
  }

  void carry_out(effect::Problem& p) { problem(p.topic + ": " + p.detail); }

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

  void problem(const std::string& text) {
    {
      constexpr std::size_t kKept = 20;
      const std::lock_guard<std::mutex> lock(statistics_mutex_);
      ++statistics_.problems;
      statistics_.last_problems.push_back(text);
      if (statistics_.last_problems.size() > kKept)
        statistics_.last_problems.erase(statistics_.last_problems.begin());
    }
    if (!callbacks_.problem) return;
    try {
      callbacks_.problem(text);
    } catch (...) {  // nobody is left to report to
    }
  }

  /// The graph and the account stay readable.
  void end_without_memory() {
    inbox_.close(/*abandon=*/true);
    stop_source_.request_stop();
    problem("out of memory: the module has stopped");
    const std::lock_guard<std::mutex> lock(work_mutex_);
    stopping_ = true;
    work_done_.notify_all();
  }

  void set_busy(bool busy) {
    const double now = watch_.seconds();
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    (busy_ ? statistics_.computing_s : statistics_.idle_s) += now - since_s_;
    if (busy) ++statistics_.batches;
    busy_ = busy;
    since_s_ = now;
  }

  void publish_statistics() {
    const CandidatePool& pool = engine_.pool();
    const std::optional<double> oldest = pool.oldest_pending_s();
    if (busy_ && !engine_.computing()) set_busy(false);
    const std::lock_guard<std::mutex> lock(statistics_mutex_);
    statistics_.events = events_;
    statistics_.factors_waiting = engine_.factors_waiting();
    statistics_.factors_dropped = engine_.factors_dropped();
    statistics_.candidates = pool.accounting();
    statistics_.oldest_pending_s = oldest ? engine_.now_s() - *oldest : 0.0;
    for (std::size_t i = 0; i < pool.queue().prioritizers().size(); ++i) {
      statistics_.handed_out[std::string(pool.queue().prioritizers()[i]->name())] =
          pool.queue().handed_out()[i];
    }
  }

  // ---- the other threads

  /// Without memory to pass on what it has done, a thread ends the module.
  template <class Function>
  void or_end(Function&& function) {
    try {
      function();
    } catch (const std::bad_alloc&) {
      out_of_memory_ = true;
      inbox_.close(/*abandon=*/true);
    }
  }

  void compute() {
    while (auto tasks = batches_.next(false)) {
      or_end(
          [&] { post_inside(Event(event::BatchDone{crew_.run(std::move(*tasks), stop_source_.token())})); });
      end_work();
    }
  }

  [[nodiscard]] RegistrationCrew::Hooks crew_hooks() {
    RegistrationCrew::Hooks hooks;
    hooks.result = [this](RegistrationResult&& result) {
      or_end([&] { post_inside(Event(std::move(result))); });
    };
    hooks.overdue = [this](const LoopCandidate& candidate, double seconds) {
      begin_work();  // wait() waits for it, a batch does not
      {
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.overdue;
        ++statistics_.overdue_now;
      }
      or_end([&] {
        post_inside(effect::Problem{"registration overdue",
                                    key_name(candidate.from) + " - " + key_name(candidate.to) +
                                        " has not come back after " + std::to_string(std::llround(seconds)) +
                                        " s: the others go on without its thread",
                                    nullptr});
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

  void optimize() {
    std::optional<PoseGraphOptimizer> optimizer;
    while (auto graph = jobs_.next(false)) {
      event::Optimized done;
      try {
        if (!optimizer) optimizer.emplace(config_.optimization);
        done.gnc = optimizer->optimize_gnc(**graph, config_.gnc, stop_source_.token());
        done.stopped = done.gnc.optimization.termination == Termination::kStopped;
        const std::lock_guard<std::mutex> lock(statistics_mutex_);
        ++statistics_.optimizations;
      } catch (const std::exception& error) {
        or_end([&] { done.failure = error.what(); });
      }
      or_end([&] { post_inside(Event(std::move(done))); });
      end_work();
    }
  }

  const Robots robots_;
  const ModuleOptions options_;
  const Config config_;
  const ModuleCallbacks callbacks_;
  const ScanLoader scans_;
  const std::function<void(const Event&, double)> on_event_;
  const std::shared_ptr<const Clock> clock_;
  std::shared_ptr<FeatureCache> features_;
  std::shared_ptr<const Registrar> registrar_;

  std::mutex entry_mutex_;  // of what producers are checked against
  std::unordered_set<Key> nodes_seen_, scans_seen_;
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> clouds_;

  StopSource stop_source_;
  std::atomic<bool> out_of_memory_{false};
  Mailbox<Message> inbox_;
  Mailbox<std::shared_ptr<const PoseGraph>> jobs_;
  Mailbox<std::vector<RegistrationTask>> batches_;
  std::mutex improvement_mutex_;
  StopSource improvement_;

  std::mutex work_mutex_;
  std::condition_variable work_done_;
  std::size_t work_ = 0;
  bool stopping_ = false;

  // The engine's thread alone, but for the graph, which others read with the mutex held.
  mutable std::mutex graph_mutex_;
  Engine engine_;
  std::shared_ptr<const Estimate> estimate_;
  bool improving_ = false;  // the next set is being prepared ...
  bool improved_ = false;   // ... and is as good as it can be
  double last_tick_s_ = 0.0;
  std::size_t events_ = 0;  // handled

  mutable std::mutex statistics_mutex_;
  ModuleStatistics statistics_;
  Stopwatch watch_;
  bool busy_ = false, ended_ = false;  // the computation
  double since_s_ = 0.0;               // by watch_
  std::thread::id engine_thread_id_;

  std::mutex stop_mutex_;
  std::thread computation_, back_end_, engine_thread_;
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
  return impl_->add(event::Factors{edges, priors, ranges, gravities});
}
bool LoopClosureModule::add_radio(const std::vector<RadioReading>& readings) {
  return impl_->add(event::Radio{readings});
}
bool LoopClosureModule::add_beacon_drop(const BeaconDrop& drop) {
  return impl_->add(drop);
}
bool LoopClosureModule::add_candidates(const std::vector<LoopCandidate>& candidates) {
  return impl_->add(event::Candidates{candidates});
}
bool LoopClosureModule::set_estimate(const ExternalEstimate& estimate) {
  return impl_->set_estimate(estimate);
}
bool LoopClosureModule::remove_closure(Key from, Key to) {
  return impl_->add(event::Veto{from, to});
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
