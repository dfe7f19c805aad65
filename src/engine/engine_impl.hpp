// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include <loopwise/engine/engine.hpp>
#include <loopwise/optimization/odometry_covariances.hpp>

#include "factor.hpp"
#include "placement.hpp"

namespace loopwise {

using KeyPair = std::pair<Key, Key>;

/// The pair in ascending order, so that (a, b) and (b, a) are equal.
[[nodiscard]] inline KeyPair pair_of(Key a, Key b) {
  return std::minmax(a, b);
}

[[nodiscard]] inline std::string pair_name(const LoopCandidate& candidate) {
  return key_name(candidate.from) + " - " + key_name(candidate.to);
}

/// Whether two poses are equal up to rounding.
[[nodiscard]] bool fits(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b);
/// Whether the pose agrees with the prior, in the directions for which the prior has information.
[[nodiscard]] bool fits(const PriorFactor& prior, const Eigen::Isometry3d& pose);

/// The state of an Engine and its handlers of events. Defined in engine.cpp (nodes, factors, scans,
/// candidates), moves.cpp, computation.cpp and estimates.cpp.
class Engine::Impl {
 public:
  Impl(const Robots& robots, const EngineOptions& options, RoundRobinQueue queue)
      : robots_(robots),
        options_(options),
        placement_(robots),
        generator_(options.generation, robots),
        radio_(options.radio, robots),
        pool_(options.pool, std::move(queue), robots),
        prioritizes_(!pool_.queue().prioritizers().empty()) {}

  std::vector<Effect> handle(Event event, double now_s);
  [[nodiscard]] bool wants_batch() const;

  Robots robots_;
  EngineOptions options_;
  PoseGraph graph_;
  Placement placement_;
  OdometryCovariances covariances_;
  ProximityGenerator generator_;
  RadioGenerator radio_;
  CandidatePool pool_;
  bool prioritizes_;
  double now_s_ = 0.0;
  bool wants_estimate_ = false, optimizing_ = false, computing_ = false;
  bool last_wanted_ = false;
  bool estimate_continues_ = false;  // the last estimate did not use all starts
  std::multimap<Key, std::pair<double, Factor>>
      waiting_factors_;  // by a missing node: time of arrival, factor
  std::size_t factors_dropped_ = 0;
  std::unordered_map<CandidateId, LoopCandidate> in_computation_;
  std::vector<std::uint64_t> evaluations_;

 private:
  // ---- helpers

  void emit(Effect&& effect);
  void problem(std::string topic, std::string detail, std::exception_ptr cause = nullptr);

  /// Calls code of a prioritiser. Its failure is reported as a problem and does not stop the engine.
  template <class Function>
  void guarded(Function&& function) {
    try {
      function();
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      // The queue's error names prioritiser and function; its cause is the exception of the prioritiser.
      const auto* nested = dynamic_cast<const std::nested_exception*>(&error);
      problem("prioritisation", error.what(), nested ? nested->nested_ptr() : std::current_exception());
    }
  }

  /// The present graph, shared until it changes.
  std::shared_ptr<const Estimate> snapshot();
  PoseGraph& change_graph();

  // ---- nodes and factors

  void on(KeyFrame& frame);
  void on(Factors& factors) { add_factors(factors_of(factors)); }

  void add_factors(const std::vector<Factor>& factors);
  void drop_old_factors();

  // ---- nodes that move because odometry or a prior came late

  void move(const std::optional<Placement::Move>& asked);

  /// Called before a group moves: rejections between it and other nodes are no longer valid, including those
  /// of registrations in progress.
  void forget_outcomes(const std::vector<Key>& group, const Eigen::Isometry3d& correction);

  /// Remembers a rejection; it is valid as long as the relative pose of its nodes does not change.
  void keep_rejected(const LoopCandidate& candidate, bool moved_meanwhile);

  /// Proposes the new neighbours of moved nodes, and again forgotten candidates that did not come from the
  /// generator.
  void propose_moved();

  // ---- scans and candidates

  void on(event::Scan& event);
  void announce(const KeyedScan& scan);
  void on(event::NoMoreScans&) { pool_.expire_waiting(); }
  void on(event::Radio& event) { propose(radio_.on_radio(graph_, event.readings, now_s_)); }
  void on(BeaconDrop& drop) { propose(radio_.on_drop(graph_, drop, now_s_)); }

  void on(event::Candidates& event);

  void propose(std::vector<LoopCandidate> candidates);

  // ---- choosing and computing

  void on(event::Tick&);

  /// Informs the prioritisers of new nodes and moved poses before they choose.
  void announce_graph();
  void on(event::Improve& event);
  void on(event::Choose& event);
  [[nodiscard]] RegistrationTask task_of(const LoopCandidate& candidate) const;
  void on(RegistrationResult& result);
  void take(const LoopClosure& closure);
  void on(event::BatchDone& event);
  void on(ClosureDecision& decision);
  /// A person's decision on a pair.
  enum class Verdict { kNone, kAccepted, kRejected };
  [[nodiscard]] Verdict verdict_on(Key a, Key b) const;

  // ---- estimates

  void on(event::Settle& settle);
  void start_estimate(bool last = false);
  void on(event::Optimized& event);

  /// Whether the estimate contradicts factors that arrived while it was computed.
  [[nodiscard]] bool contradicts_new_factors(const std::vector<Eigen::Isometry3d>& estimated,
                                             std::size_t edges_estimated) const;
  void on(ExternalEstimate& estimate);

  /// Sets the poses of the named nodes. Every other node of a robot moves with the last named node before it.
  void move_nodes(const std::unordered_map<Key, Eigen::Isometry3d>& named);
  void publish();

  std::vector<Effect> effects_;
  std::shared_ptr<const Estimate> snapshot_;  // of the present graph_; null after a change
  std::uint64_t revision_ = 0;
  bool graph_is_new_ = false;  // the prioritisers have not seen the present graph
  bool may_choose_ = false;    // something has changed since the prioritisers held back all candidates
  std::multimap<double, Key> factor_ages_;                                  // of waiting_factors_
  std::unordered_set<Key> scans_;                                           // announced
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> early_scans_;  // before their nodes
  std::map<KeyPair, bool> decided_;                                         // true: accepted
  std::unordered_set<Key> closed_;           // nodes that have or had a closure
  std::vector<Key> moved_;                   // since the last proposal of their neighbours
  std::unordered_set<Key> moved_since_job_;  // since the last job of the back end began
  bool removed_since_job_ = false;           // whether closures were removed since then
  // Rejected candidates whose nodes may still move relative to each other, by each of the two nodes.
  std::unordered_map<Key, std::vector<LoopCandidate>> revocable_rejections_;
  std::vector<LoopCandidate> forgotten_;             // rejections that are no longer valid
  std::unordered_set<CandidateId> moved_meanwhile_;  // of in_computation_
};

}  // namespace loopwise
