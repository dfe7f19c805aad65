// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The online system. It takes key frames from a running SLAM stack, and finds, orders and computes loop
/// closures in its own threads.
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
#include <loopwise/features/place.hpp>
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
  AppearanceOptions appearance;          ///< Candidates by appearance.
  PrioritizationOptions prioritization;  ///< Order of the candidates.
  FeatureOptions features;               ///< Preparation of scans.
  FastRegistrarOptions registration;     ///< Computation of candidates.
  BackEndOptions back_end;               ///< Estimates.
  /// Largest number of candidates in a batch. A batch has fewer if the registrar needs more than two seconds
  /// for so many, but at least one for each thread.
  std::int64_t batch = 50;
  /// Number of threads that compute registrations. 0: one per processor.
  int threads = 0;
  /// Capacity of the event queue. A producer blocks while the queue is full.
  std::int64_t queue_capacity = 1024;
  /// Wall time after which a running registration is reported as a problem, s. Its batch continues without
  /// it, and its result still counts when it arrives. 0: never.
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
    field("batch", self.batch, at_least(1));
    field("threads", self.threads, between(0, 1024));
    field("queue_capacity", self.queue_capacity, at_least(1));
    field("overdue_after_s", self.overdue_after_s, at_least(0.0));
  }
};

/// Called from the engine's thread of the module, one at a time, in the order of events. Data that the
/// program's threads share need a lock. Keep callbacks short, because the module waits for them. They may
/// call every function of the module except the destructor and wait(), finish() and stop(), which throw
/// there. Exceptions are reported as problems, except std::bad_alloc, which ends the module. Any callback may
/// be empty.
struct ModuleCallbacks {
  /// A verified closure, not yet optimised.
  std::function<void(const LoopClosure& closure)> on_closure;
  /// Every computed candidate. A pair is computed again, with another id, if one of its nodes was moved, see
  /// KeyFrame.
  std::function<void(const RegistrationResult& result)> on_result;
  /// A new estimate.
  std::function<void(const std::shared_ptr<const Estimate>& estimate)> on_estimate;
  /// Something was left out or has failed; the text has the reason.
  std::function<void(const std::string& problem)> on_problem;
};

/// User-defined parts; empty parts are made from the options.
struct ModuleParts {
  /// Reads the scan of a node on demand; the module then stores no clouds. Each scan must still be announced,
  /// by KeyFrame::cloud or add_scan(), because candidates of a node without an announced scan are not
  /// computed. Empty: the module stores the clouds in memory.
  ScanLoader scans;
  /// Makes the registrar that computes the candidates. The registrar must be thread-safe. It gets the clouds
  /// from `scans`, and may use it until the module ends. It may call the same functions as callbacks.
  std::function<std::shared_ptr<const Registrar>(const ScanLoader& scans)> registrar;
  /// Order the candidates. Several prioritisers take turns. They run in the engine's thread and may call the
  /// same functions as callbacks. An exception is reported as a problem that names prioritiser and function;
  /// candidates that were being added then count as pruned ("prioritizer_failed").
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  /// Finds places of similar appearance, instead of the database that AppearanceOptions::descriptor names. It
  /// must not contain places yet. Place recognition is then on, even without AppearanceOptions::enabled.
  std::unique_ptr<PlaceDatabase> places;
  /// Measures the waiting time of candidates, factors and scans; now() must be thread-safe. Null: seconds
  /// since the construction of the module, by the steady clock.
  std::shared_ptr<const Clock> clock;
  /// Called with each event that the engine has handled, from the module's thread.
  std::function<void(const HandledEvent& handled)> on_event;
};

/// Load of each stage. Counts are since the start of the module.
struct ModuleStatistics {
  std::size_t events_waiting = 0;   ///< Accepted from producers, not yet handled.
  std::size_t events = 0;           ///< Handled.
  std::size_t producer_waits = 0;   ///< Number of times that a full queue blocked a producer.
  std::size_t batches = 0;          ///< Batches handed to the computation.
  std::size_t optimizations = 0;    ///< Estimates of the back end.
  std::size_t improvements = 0;     ///< Number of improvements of the next set by prioritisation.
  std::size_t factors_waiting = 0;  ///< Factors that wait for their nodes.
  std::size_t factors_dropped = 0;  ///< Factors that waited too long for their nodes.
  /// Registrations that ran for longer than ModuleOptions::overdue_after_s, ...
  std::size_t overdue = 0;
  std::size_t overdue_now = 0;    ///< ... and those of them without a result so far, each on a thread.
  double computing_s = 0.0;       ///< Wall time with a batch in computation, ...
  double idle_s = 0.0;            ///< ... and without, since the start.
  double oldest_pending_s = 0.0;  ///< Age of the oldest pending candidate on the module's clock, s.
  double optimizing_s = 0.0;      ///< Wall time of the estimates.
  std::size_t problems = 0;       ///< Number of problems, with or without a callback.
  std::vector<std::string> last_problems;  ///< The last 20 of them, oldest first.
  std::map<std::string, std::size_t>
      handed_out;  ///< By prioritiser; candidates that were given back and taken again count twice.
  CandidateAccounting candidates;  ///< State of every candidate.
};

/// The Engine with threads: one runs the engine, some compute registrations, one optimises.
///
///     add_*() ─► bounded queue ─► engine ─► batches ─► registration ─┐
///                                 ▲ ▲ └──► snapshots ─► back end ─┐  │
///                                 │ └────── estimates ◄───────────┘  │
///                                 └──────── results ◄────────────────┘
///
/// While a batch is computed, the engine's thread improves the next set. External events then wait until the
/// set cannot be improved further, the computation has no more work, or the queue is half full. All functions
/// may be called from any thread at any time, except those that wait for the module, see ModuleCallbacks. A
/// full queue blocks its producer until there is room: no event is dropped. Unlike a replay's, the outcome
/// depends on arrival times and on the speed of the machine; ModuleParts::on_event records a run for
/// repetition.
///
/// Bad input throws in the call and changes nothing. A std::bad_alloc in add_* goes to the caller; in a
/// thread of the module it stops the module with one problem, and wait() returns false. The graph, the
/// estimate and the statistics stay readable.
class LOOPWISE_EXPORT LoopClosureModule {
 public:
  /// \param robots all robots, including later ones; keys of others are refused
  /// \param options of the module; those of a replay have other defaults, see module_options()
  /// \param callbacks receive closures and estimates
  /// \param parts user-defined parts
  /// \throws OptionError, naming "section.field"; InputError if `parts.registrar` returns null; exceptions of
  /// `parts.registrar`
  explicit LoopClosureModule(const Robots& robots, const ModuleOptions& options = {},
                             ModuleCallbacks callbacks = {}, ModuleParts parts = {});
  /// Like stop(). Must not run in a callback, prioritiser, registrar or scan loader of the module: that would
  /// end the program.
  ~LoopClosureModule();
  LoopClosureModule(const LoopClosureModule&) = delete;
  LoopClosureModule& operator=(const LoopClosureModule&) = delete;

  /// Each add_* function \returns false if the module was stopped. The input was then not accepted.

  /// \throws InputError on a repeated key, numbers that are not finite or bad information; UnknownKeyError if
  /// no robot owns the key.
  [[nodiscard]] bool add_key_frame(const KeyFrame& frame);
  /// The cloud of a node, which may come before the node. \throws InputError if the node already has a cloud
  /// or a point is not finite; UnknownKeyError if no robot owns the key.
  [[nodiscard]] bool add_scan(Key key, const std::shared_ptr<const PointCloud>& cloud);
  /// Factors of present or future nodes. \throws InputError like PoseGraph; UnknownKeyError if no robot owns
  /// a key.
  [[nodiscard]] bool add_factors(const Factors& factors);
  /// Received powers. Add all readings of one node and beacon together, in any order with nodes and drops.
  /// They propose candidates with any method, so do not add them if radio is not wanted. Readings of unknown
  /// nodes or beacons wait within RadioOptions' bound. \throws UnknownKeyError if no robot owns a key.
  [[nodiscard]] bool add_radio(const std::vector<RadioReading>& readings);
  /// \throws UnknownKeyError if no robot owns the drop's node.
  [[nodiscard]] bool add_beacon_drop(const BeaconDrop& drop);
  /// Candidates of an external place recognition. The module sets ids; the order of the two keys does not
  /// matter. Candidates wait for missing nodes, see CandidatePoolOptions::max_wait_s. \throws InputError if a
  /// candidate joins a node with itself; UnknownKeyError if no robot owns a key.
  [[nodiscard]] bool add_candidates(const std::vector<LoopCandidate>& candidates);
  /// Poses of an external back end. Unknown keys are ignored. Weights of closures stay 1: report rejected
  /// ones by remove_closure(). Nodes without a pose move with the nearest earlier node of their robot's path
  /// that has a pose. Rounded rotations are orthonormalised. \throws InputError if the internal back end is
  /// on, a number is not finite, or a pose is not a rigid transform to 1e-3.
  [[nodiscard]] bool set_estimate(const ExternalEstimate& estimate);
  /// A user's decision on the closures between two nodes, including later ones and those of the front end.
  /// Rejected closures are removed, and the pair is not proposed again; if it is pending, it is computed and
  /// its closure ignored. Accepted closures are known inliers, which robust optimisation keeps. The last
  /// decision on a pair counts, but a removed closure does not return. The nodes may be added later.
  [[nodiscard]] bool decide(const ClosureDecision& decision);
  /// decide() with a rejection.
  [[nodiscard]] bool remove_closure(Key from, Key to);

  /// Waits until nothing more happens without new input: all input is handled, and the estimate is up to
  /// date, except for reported problems. It does not wait for candidates with missing scans, or for those
  /// that a prioritiser holds back. \returns false if the module was stopped. \throws Error in a callback,
  /// prioritiser, registrar or scan loader of the module, because it would wait for itself.
  [[nodiscard]] bool wait();

  /// Like stop(), but computes a last estimate from scratch if closures have come since the previous one, or
  /// if the previous one continued an earlier one (GncOptions::warm_start). To compute all pending
  /// candidates, call wait() first. \throws Error like wait().
  void finish();
  /// Ends all work soon and joins the threads. Running registrations complete, without a limit of time: a
  /// thread cannot be stopped from outside, see RegistrationTask::time_limit_s. Pending candidates remain
  /// pending in the account. May be called more than once. \throws Error like wait().
  void stop();

  /// The last estimate; null before the first.
  [[nodiscard]] std::shared_ptr<const Estimate> estimate() const;
  /// The current graph: all nodes, factors and verified closures with their last weights.
  [[nodiscard]] PoseGraph graph() const;
  /// Load of each stage, now and since the start.
  [[nodiscard]] ModuleStatistics statistics() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
