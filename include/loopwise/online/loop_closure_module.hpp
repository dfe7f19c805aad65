// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The online system: fed by a SLAM stack as its robots drive, it finds, orders and computes loop closures
/// beside the stack's own work.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/engine/events.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/generation/appearance.hpp>
#include <loopwise/optimization/back_end.hpp>
#include <loopwise/prioritization/method.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// All options of a module.
struct ModuleOptions {
  EngineOptions engine;                  ///< Decisions.
  AppearanceOptions appearance;          ///< Candidates by what places look like.
  PrioritizationOptions prioritization;  ///< Order of the candidates.
  FeatureOptions features;               ///< Preparation of scans.
  FastRegistrarOptions registration;     ///< Computation of candidates.
  BackEndOptions back_end;               ///< Estimates.
  std::int64_t batch = 50;
  int threads = 0;
  std::int64_t queue_capacity = 1024;
  double overdue_after_s = 60.0;

  /// Calls visitor(name, section) for these options and those of the parts.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    EngineOptions::visit_sections(self.engine, visitor);
    visitor("appearance", self.appearance);
    PrioritizationOptions::visit_sections(self.prioritization, visitor);
    visitor("features", self.features);
    visitor("fast_registrar", self.registration);
    BackEndOptions::visit_sections(self.back_end, visitor);
    visitor("module", self);
  }

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("batch", self.batch, at_least(1), "Candidates handed out each time the computation runs dry.");
    field("threads", self.threads, between(0, 1024), "That compute registrations; 0: one per processor.");
    field("queue_capacity", self.queue_capacity, at_least(1),
          "Events that wait to be taken in; whoever adds more is held until there is room.");
    field("overdue_after_s", self.overdue_after_s, at_least(0.0),
          "A registration that has run for so long, s of wall time, is reported as a problem, and its batch "
          "goes on without it and its thread; its result still counts when it comes. 0: never.");
  }
};

/// Called from the engine's thread of the module, one at a time, in the order of events: what they share with
/// the stack's own threads needs a lock. They may call everything but wait(), finish(), stop() and the
/// destructor. Keep them short: the module waits for them. What they throw is reported as a problem, but for
/// std::bad_alloc, which ends the module. Any may be empty.
struct ModuleCallbacks {
  /// A verified closure, not yet optimised.
  std::function<void(const LoopClosure& closure)> on_closure;
  /// Every computed candidate; a pair again, with another id, after one of its nodes was moved, see KeyFrame.
  std::function<void(const RegistrationResult& result)> on_result;
  /// A new estimate.
  std::function<void(const std::shared_ptr<const Estimate>& estimate)> on_estimate;
  /// Something was left out or has failed, and why.
  std::function<void(const std::string& problem)> on_problem;
};

/// Parts that a stack may bring of its own; what is left empty is made from the options.
struct ModuleParts {
  /// Reads the scan of a node again when it is needed; the module then keeps no clouds. Each scan must still
  /// be announced, by KeyFrame::cloud or add_scan(): candidates of a node without an announced scan are not
  /// computed. Empty: the module keeps the clouds that it is given in memory.
  ScanLoader scans;
  /// Makes the registrar that computes the candidates. The registrar must be thread-safe. It gets the clouds
  /// by `scans`, wherever they are kept, and may use it until the module ends.
  std::function<std::shared_ptr<const Registrar>(const ScanLoader& scans)> registrar;
  /// Order the candidates; several take turns. They run in the engine's thread, and may call back add_*,
  /// set_estimate() and remove_closure() alone.
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  /// Tells when candidates, factors and scans have waited too long; must allow now() from another thread.
  /// Null: seconds since the module was made, by the steady clock.
  std::shared_ptr<const Clock> clock;
  /// Is called with each event that the engine has handled, from the module's thread.
  std::function<void(const HandledEvent& handled)> on_event;
};

/// How busy each stage is. Counts are since the start.
struct ModuleStatistics {
  std::size_t events_waiting = 0;   ///< Taken from producers, not handled yet.
  std::size_t events = 0;           ///< Handled.
  std::size_t producer_waits = 0;   ///< Times that a producer was held because of a full queue.
  std::size_t batches = 0;          ///< Batches handed to the computation.
  std::size_t optimizations = 0;    ///< Estimates made by the back end.
  std::size_t improvements = 0;     ///< Times that prioritisation improved its next set meanwhile.
  std::size_t factors_waiting = 0;  ///< For their nodes.
  std::size_t factors_dropped = 0;  ///< Waited too long for their nodes.
  /// Registrations that ran for longer than ModuleOptions::overdue_after_s, ...
  std::size_t overdue = 0;
  std::size_t overdue_now = 0;    ///< ... and those of them that have not come back, each on a thread.
  double computing_s = 0.0;       ///< Wall time with a batch in computation, ...
  double idle_s = 0.0;            ///< ... and without, since the start.
  double oldest_pending_s = 0.0;  ///< Age of the oldest pending candidate by the module's clock, s.
  double optimizing_s = 0.0;      ///< Wall time of the estimates.
  std::size_t problems = 0;       ///< Reported, whether or not there is a callback for them.
  std::vector<std::string> last_problems;  ///< The last 20 of them, oldest first.
  std::map<std::string, std::size_t>
      handed_out;                  ///< By prioritiser; given back and taken again counts twice.
  CandidateAccounting candidates;  ///< Where every candidate is.
};

/// The Engine with threads: one runs the engine, some compute registrations, one optimises.
///
///     add_*() ─► bounded queue ─► engine ─► batches ─► registration ─┐
///                                 ▲ ▲ └──► snapshots ─► back end ─┐  │
///                                 │ └────── estimates ◄───────────┘  │
///                                 └──────── results ◄────────────────┘
///
/// While a batch is computed, the engine's thread improves the next set. Events from outside then wait: until
/// the set cannot be improved further, the computation runs dry, or the queue is half full. All functions may
/// be called from any thread at any moment, but see ModuleCallbacks. A full queue holds its producer until
/// there is room: nothing is dropped. Unlike a replay's, the outcome depends on when things arrive and on how
/// fast the machine is; see ModuleParts::on_event for how a run is repeated.
///
/// Bad input throws where it is handed over and changes nothing. A std::bad_alloc in add_* goes to the
/// caller; in a thread of the module it stops the module with one problem, and wait() returns false. The
/// graph, the estimate and the statistics stay readable.
class LOOPWISE_EXPORT LoopClosureModule {
 public:
  /// \param robots all that will ever take part; keys of others are refused
  /// \param options of the module; a replay's have other defaults, see module_options()
  /// \param callbacks that tell the stack of closures and estimates
  /// \param parts of the stack's own
  /// \throws OptionError, naming "section.field"; InputError if `parts.registrar` makes none; what it throws
  explicit LoopClosureModule(const Robots& robots, const ModuleOptions& options = {},
                             ModuleCallbacks callbacks = {}, ModuleParts parts = {});
  /// As stop().
  ~LoopClosureModule();
  LoopClosureModule(const LoopClosureModule&) = delete;
  LoopClosureModule& operator=(const LoopClosureModule&) = delete;

  /// Each add_* function \returns false if the module was stopped: then nothing was taken.

  /// \throws InputError on a repeated key, numbers that are not finite or bad information; UnknownKeyError if
  /// no robot owns the key.
  [[nodiscard]] bool add_key_frame(const KeyFrame& frame);
  /// The cloud of a node, before or after the node itself. \throws InputError if it has one already or a
  /// point is not finite; UnknownKeyError if no robot owns the key.
  [[nodiscard]] bool add_scan(Key key, const std::shared_ptr<const PointCloud>& cloud);
  /// Factors of nodes that have come or will. \throws InputError as PoseGraph does; UnknownKeyError if no
  /// robot owns a key.
  [[nodiscard]] bool add_factors(const Factors& factors);
  /// Received powers, all of one node and beacon together, in any order with nodes and drops. They
  /// propose candidates whatever the method is: do not add them if radio is not wanted. Readings of
  /// unknown nodes or beacons wait within RadioOptions' bound. \throws UnknownKeyError if no robot owns a
  /// key.
  [[nodiscard]] bool add_radio(const std::vector<RadioReading>& readings);
  /// \throws UnknownKeyError if no robot owns the drop's node.
  [[nodiscard]] bool add_beacon_drop(const BeaconDrop& drop);
  /// From a place recognition of the stack's own; ids are given by the module, the order of the two keys does
  /// not matter. Nodes that have not come are waited for, see CandidatePoolOptions::max_wait_s. \throws
  /// InputError if a candidate joins a node with itself; UnknownKeyError if no robot owns a key.
  [[nodiscard]] bool add_candidates(const std::vector<LoopCandidate>& candidates);
  /// Poses of a back end of the stack's own. Keys that have not come are ignored. Weights of closures stay 1:
  /// tell rejected ones by remove_closure(). Nodes that are not named move with the nearest named one before
  /// them on their robot's path. Rotations that were rounded are made rotations again. \throws InputError if
  /// our back end is on, a number is not finite, or a pose is no rigid transform to 1e-3.
  [[nodiscard]] bool set_estimate(const ExternalEstimate& estimate);
  /// Takes out every closure between two nodes, as after a human's veto, the front end's too, and takes in
  /// none that is computed later. Keys that have not come are ignored.
  [[nodiscard]] bool remove_closure(Key from, Key to);

  /// Waits until nothing more would happen without new input: all that was added is handled, and the estimate
  /// is up to date, but for what was told as a problem. Candidates whose scan has not come, or that a
  /// prioritiser holds back, are not waited for. \returns false if the module was stopped instead.
  [[nodiscard]] bool wait();

  /// As stop(), but with a last estimate if closures have come since the one before. For all pending
  /// candidates to be computed, call wait() before it.
  void finish();
  /// Ends all work soon and joins the threads; what was being computed is finished, however long it takes (a
  /// thread cannot be taken from a registrar: see RegistrationTask::time_limit_s), what was pending stays so
  /// in the account. May be called more than once and from any thread but the callbacks'.
  void stop();

  /// The last estimate; null before the first.
  [[nodiscard]] std::shared_ptr<const Estimate> estimate() const;
  /// The graph as it is now: all nodes, factors and verified closures with their last weights.
  [[nodiscard]] PoseGraph graph() const;
  /// How busy each stage is, now and since the start.
  [[nodiscard]] ModuleStatistics statistics() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
