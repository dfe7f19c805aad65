// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/online/loop_closure_module.hpp>

#include <cmath>
#include <exception>
#include <mutex>
#include <new>
#include <optional>
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/engine/scan_insight.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "engine_thread.hpp"
#include "intake.hpp"
#include "job_thread.hpp"
#include "open_work.hpp"
#include "registration_crew.hpp"
#include "reporter.hpp"
#include "statistics_board.hpp"

namespace loopwise {
class LoopClosureModule::Impl {
 public:
  Impl(const Robots& robots, const ModuleOptions& options, ModuleCallbacks callbacks, ModuleParts&& parts)
      : robots_(robots),
        options_(options),
        intake_(parts.scans),
        features_(
            std::make_shared<FeatureCache>([this](Key key) { return intake_.load(key); }, options.features)),
        registrar_(make_registrar(parts)),
        reporter_(std::move(callbacks), statistics_),
        appearance_(make_appearance(std::move(parts.places))),
        engine_thread_(settings(options, parts), work_, statistics_, reporter_),
        crew_(*registrar_, options.threads, options.overdue_after_s, crew_hooks()),
        computation_([this](std::vector<RegistrationTask>&& tasks) { compute(std::move(tasks)); }),
        back_end_([this](effect::Optimize&& job) { optimize(job); }) {
    EngineThread::Workers workers;
    workers.compute = [this](std::vector<RegistrationTask> tasks) { computation_.post(std::move(tasks)); };
    workers.optimize = [this](effect::Optimize job) { back_end_.post(std::move(job)); };
    engine_thread_.start(Engine(robots_, options_.engine, make_queue(std::move(parts.prioritizers))),
                         std::move(workers));
  }

  ~Impl() { stop(); }

  // ---- producers' side

  bool add_key_frame(const KeyFrame& frame) {
    Event event = checked(frame);
    if (frame.cloud) Intake::check_cloud(frame.node.key, *frame.cloud);
    intake_.add_node(frame.node.key, frame.cloud);
    return engine_thread_.post(std::move(event));
  }

  bool add_scan(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    Event event = checked(event::Scan{{key, 0, cloud}});
    Intake::check_cloud(key, *cloud);
    intake_.add_scan(key, cloud);
    return engine_thread_.post(std::move(event));
  }

  /// Adds any other event from outside.
  bool add(Event event) { return engine_thread_.post(checked(std::move(event))); }

  bool set_estimate(const ExternalEstimate& estimate) {
    if (options_.engine.use_back_end)
      throw InputError("an external estimate needs the option engine.use_back_end to be off");
    return add(estimate);
  }

  [[nodiscard]] bool wait() {
    refuse_own_threads("wait");
    return work_.wait();
  }

  void stop() {
    refuse_own_threads("stop");
    stop_source_.request_stop();  // also ends a last estimate
    end();
  }

  void finish() {
    refuse_own_threads("finish");
    end();
  }

  [[nodiscard]] std::shared_ptr<const Estimate> estimate() const { return engine_thread_.estimate(); }
  [[nodiscard]] PoseGraph graph() const { return engine_thread_.graph(); }

  [[nodiscard]] ModuleStatistics statistics() const {
    ModuleStatistics result = statistics_.read();
    result.events_waiting = engine_thread_.waiting();
    return result;
  }

 private:
  /// Throws if one of the module's own threads makes this call, which would wait for that thread.
  void refuse_own_threads(const char* call) {
    if (!engine_thread_.is_own_thread() && !crew_.is_own_thread()) return;
    throw Error(std::string(call) +
                "() would wait for its own caller: call it from another thread, not from a "
                "callback, prioritiser, registrar or scan loader of the module");
  }

  void end() {
    work_.stop();
    const std::lock_guard<std::mutex> lock(stop_mutex_);
    if (std::exchange(ended_, true)) return;
    engine_thread_.end();
    computation_.stop();
    back_end_.stop();
    statistics_.end();
  }

  [[nodiscard]] EngineThread::Settings settings(const ModuleOptions& options, const ModuleParts& parts) {
    EngineThread::Settings settings{static_cast<std::size_t>(options.batch),
                                    static_cast<std::size_t>(resolve_threads(options.threads)),
                                    static_cast<std::size_t>(options.queue_capacity),
                                    parts.clock ? parts.clock : std::make_shared<const RealClock>(),
                                    parts.on_event,
                                    {}};
    if (appearance_) {
      settings.recognise = [this](const PoseGraph& graph, Key key, double now_s) {
        return appearance_->on_node(graph, key, now_s);
      };
    }
    return settings;
  }

  [[nodiscard]] std::unique_ptr<AppearanceGenerator> make_appearance(std::unique_ptr<PlaceDatabase> own) {
    if (!options_.appearance.enabled && own == nullptr) return nullptr;
    return std::make_unique<AppearanceGenerator>(
        options_.appearance, robots_, [this](Key key) { return intake_.load(key); }, std::move(own));
  }

  [[nodiscard]] std::shared_ptr<const Registrar> make_registrar(const ModuleParts& parts) {
    if (!parts.registrar) return std::make_shared<FastRegistrar>(features_, options_.registration);
    auto own = parts.registrar([this](Key key) { return intake_.load(key); });
    if (!own) throw InputError("ModuleParts::registrar has returned no registrar");
    return own;
  }

  [[nodiscard]] RoundRobinQueue make_queue(std::vector<std::unique_ptr<Prioritizer>> own) {
    if (!own.empty()) return RoundRobinQueue(std::move(own));
    ScanInsight insight = scan_insight(*features_, options_.prioritization.observability.variant);
    insight.eigenvalue = [this, of = std::move(insight.eigenvalue)](const KeyedScan& scan) {
      const double value = of(scan);
      engine_thread_.note_observability(value);
      return value;
    };
    insight.signature = [this, of = std::move(insight.signature)](const KeyedScan& scan) {
      ScanSignature signature = of(scan);
      engine_thread_.note_signature(signature);
      return signature;
    };
    return RoundRobinQueue(
        make_prioritizers(options_.prioritization, options_.engine.seed, robots_, insight));
  }

  [[nodiscard]] Event checked(Event event) const {
    check_event(event, robots_);
    return event;
  }

  // ---- the threads other than the engine's

  void compute(std::vector<RegistrationTask>&& tasks) {
    try {
      event::BatchDone done{crew_.run(std::move(tasks), engine_thread_.no_more_batches())};
      engine_thread_.post_inside(Event(std::move(done)));
    } catch (const std::bad_alloc&) {
      engine_thread_.give_up();
    }
    work_.end();
  }

  [[nodiscard]] RegistrationCrew::Hooks crew_hooks() {
    RegistrationCrew::Hooks hooks;
    hooks.result = [this](RegistrationResult&& result) {
      engine_thread_.post_inside(Event(std::move(result)));
    };
    hooks.overdue = [this](const LoopCandidate& candidate, double seconds) {
      work_.begin();  // wait() waits for this registration, a batch does not
      statistics_.registration_overdue();
      engine_thread_.post_inside(effect::Problem{
          "registration overdue",
          key_name(candidate.from) + " - " + key_name(candidate.to) + " is still running after " +
              std::to_string(std::llround(seconds)) + " s: the others continue without its thread",
          nullptr});
    };
    hooks.back = [this] {
      statistics_.overdue_registration_back();
      work_.end();
    };
    return hooks;
  }

  void optimize(const effect::Optimize& job) {
    const Stopwatch watch;
    event::Optimized done;
    try {
      if (!optimizer_) optimizer_.emplace(options_.back_end.optimization);
      GncOptions options = options_.back_end.gnc;
      if (job.from_scratch) options.warm_growth = 0.0;
      done.gnc = optimizer_->optimize_gnc(*job.graph, options, stop_source_.token());
      done.stopped = done.gnc.optimization.termination == Termination::kStopped;
      statistics_.optimized(watch.seconds());
    } catch (const std::bad_alloc&) {
      engine_thread_.give_up();
      return;
    } catch (const std::exception& error) {
      done.failure = error.what();
    }
    engine_thread_.post_inside(Event(std::move(done)));
    work_.end();
  }

  const Robots robots_;
  const ModuleOptions options_;
  Intake intake_;
  std::shared_ptr<FeatureCache> features_;
  std::shared_ptr<const Registrar> registrar_;
  std::optional<PoseGraphOptimizer> optimizer_;  // only the back end's thread uses it

  StatisticsBoard statistics_;
  Reporter reporter_;
  OpenWork work_;
  StopSource stop_source_;  // of the back end
  std::mutex stop_mutex_;
  bool ended_ = false;
  std::unique_ptr<AppearanceGenerator> appearance_;  // only the engine's thread uses it; null if not enabled
  // The threads. Each may use those declared before it.
  EngineThread engine_thread_;
  RegistrationCrew crew_;
  JobThread<std::vector<RegistrationTask>> computation_;
  JobThread<effect::Optimize> back_end_;
};

LoopClosureModule::LoopClosureModule(const Robots& robots, const ModuleOptions& options,
                                     ModuleCallbacks callbacks, ModuleParts parts) {
  validate_sections(options);
  impl_ = std::make_unique<Impl>(robots, options, std::move(callbacks), std::move(parts));
}

LoopClosureModule::~LoopClosureModule() = default;

bool LoopClosureModule::add_key_frame(const KeyFrame& frame) {
  return impl_->add_key_frame(frame);
}
bool LoopClosureModule::add_scan(Key key, const std::shared_ptr<const PointCloud>& cloud) {
  return impl_->add_scan(key, cloud);
}
bool LoopClosureModule::add_factors(const Factors& factors) {
  return impl_->add(factors);
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
bool LoopClosureModule::decide(const ClosureDecision& decision) {
  return impl_->add(decision);
}

bool LoopClosureModule::remove_closure(Key from, Key to) {
  return decide({from, to, false});
}
bool LoopClosureModule::wait() {
  return impl_->wait();
}
void LoopClosureModule::finish() {
  impl_->finish();
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
