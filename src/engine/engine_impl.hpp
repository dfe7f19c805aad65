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

#include "factor.hpp"
#include "placement.hpp"

namespace loopwise {

using KeyPair = std::pair<Key, Key>;

/// The same for (a, b) and (b, a).
[[nodiscard]] inline KeyPair pair_of(Key a, Key b) {
  return std::minmax(a, b);
}

[[nodiscard]] inline std::string pair_name(const LoopCandidate& candidate) {
  return key_name(candidate.from) + " - " + key_name(candidate.to);
}

/// Whether two poses are the same but for rounding.
[[nodiscard]] bool fits(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b);
/// Whether the pose is at the prior, in the directions that the prior knows.
[[nodiscard]] bool fits(const PriorFactor& prior, const Eigen::Isometry3d& pose);

/// The state of an Engine, and what it does with each event. Defined in engine.cpp (nodes, factors, scans,
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
  ProximityGenerator generator_;
  RadioGenerator radio_;
  CandidatePool pool_;
  bool prioritizes_;
  double now_s_ = 0.0;
  bool wants_estimate_ = false, optimizing_ = false, computing_ = false;
  bool last_wanted_ = false;
  bool estimate_continues_ = false;  // the last one was not made from all starts
  std::multimap<Key, std::pair<double, Factor>> waiting_factors_;  // by a missing node; since when
  std::size_t factors_dropped_ = 0;
  std::unordered_map<CandidateId, LoopCandidate> in_computation_;
  std::vector<std::uint64_t> evaluations_;

 private:
  // ---- helpers

  void emit(Effect&& effect);
  void problem(std::string topic, std::string detail, std::exception_ptr cause = nullptr);

  /// Calls code of a prioritiser, whose failure must not stop the rest.
  template <class Function>
  void guarded(Function&& function) {
    try {
      function();
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      // The queue names prioritiser and function; the cause is what the prioritiser threw.
      const auto* nested = dynamic_cast<const std::nested_exception*>(&error);
      problem("prioritisation", error.what(), nested ? nested->nested_ptr() : std::current_exception());
    }
  }

  /// The graph as it is, shared until it changes.
  std::shared_ptr<const Estimate> snapshot();
  PoseGraph& change_graph();

  // ---- nodes and factors

  void on(KeyFrame& frame);
  void on(Factors& factors) { add_factors(factors_of(factors)); }

  void add_factors(const std::vector<Factor>& factors);
  void drop_old_factors();

  // ---- nodes that move because odometry or a prior came late

  void move(const std::optional<Placement::Move>& asked);

  /// A group is about to move: rejections between it and other nodes say nothing any more, nor will those
  /// that are being computed.
  void forget_outcomes(const std::vector<Key>& group, const Eigen::Isometry3d& correction);

  /// A rejection holds as long as its nodes lie so to each other.
  void keep_rejected(const LoopCandidate& candidate, bool moved_meanwhile);

  /// Proposes what moved nodes are near to now, and again what others than the generator proposed.
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

  /// The prioritisers learn of new nodes and moved poses before they choose.
  void announce_graph();
  void on(event::Improve& event);
  void on(event::Choose& event);
  [[nodiscard]] RegistrationTask task_of(const LoopCandidate& candidate) const;
  void on(RegistrationResult& result);
  void take(const LoopClosure& closure);
  void on(event::BatchDone& event);
  void on(ClosureDecision& decision);
  /// What a person has said of a pair.
  enum class Word { kNone, kAccepted, kRejected };
  [[nodiscard]] Word word_on(Key a, Key b) const;

  // ---- estimates

  void on(event::Settle& settle);
  void start_estimate(bool last = false);
  void on(event::Optimized& event);

  /// Whether factors that came while the estimate was made contradict it.
  [[nodiscard]] bool is_torn(const std::vector<Eigen::Isometry3d>& estimated,
                             std::size_t edges_estimated) const;
  void on(ExternalEstimate& estimate);

  /// Sets the poses of the named nodes; the others of a robot move with the nearest named one before them.
  void move_nodes(const std::unordered_map<Key, Eigen::Isometry3d>& named);
  void publish();

  std::vector<Effect> effects_;
  std::shared_ptr<const Estimate> snapshot_;  // of graph_ as it is; null after a change
  std::uint64_t revision_ = 0;
  bool graph_is_new_ = false;  // to the prioritisers
  bool may_choose_ = false;    // something has changed since the prioritisers held everything back
  std::multimap<double, Key> factor_ages_;                                  // of waiting_factors_
  std::unordered_set<Key> scans_;                                           // announced
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> early_scans_;  // before their nodes
  std::map<KeyPair, bool> decided_;                                         // true: accepted
  std::unordered_set<Key> closed_;           // nodes with a closure, perhaps taken out since
  std::vector<Key> moved_;                   // since their neighbours were proposed
  std::unordered_set<Key> moved_since_job_;  // of the back end
  bool removed_since_job_ = false;           // closures
  // Rejected candidates of nodes that may still move against each other, by each of the two.
  std::unordered_map<Key, std::vector<LoopCandidate>> rejected_apart_;
  std::vector<LoopCandidate> forgotten_;             // rejections that say nothing any more
  std::unordered_set<CandidateId> moved_meanwhile_;  // of in_computation_
};

}  // namespace loopwise
