// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/id_table.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/prioritization/round_robin_queue.hpp>

namespace loopwise {

/// State of every candidate of a run. The invariant at any time:
///
///     generated = pruned + expired + waiting + pending + in_flight + computed
struct CandidateAccounting {
  std::size_t generated = 0;  ///< Distinct proposed pairs; forgotten pairs count again.
  std::size_t pruned = 0;     ///< Refused by every prioritiser.
  std::size_t expired = 0;    ///< Too old, beyond the pool's bound, or without a scan in time.
  std::size_t waiting = 0;    ///< A node's scan is still missing.
  std::size_t pending = 0;    ///< Ready to be handed out.
  std::size_t in_flight = 0;  ///< Handed out, without a result so far.
  std::size_t computed = 0;   ///< With a result.

  /// Generated and not pruned: the denominator of the paper's Table I.
  [[nodiscard]] std::size_t queued() const { return generated - pruned; }
  /// Whether the invariant holds.
  [[nodiscard]] bool balanced() const {
    return generated == pruned + expired + waiting + pending + in_flight + computed;
  }
};

/// Expiry of candidates, and which candidates come last.
struct CandidatePoolOptions {
  /// Pending candidates older than this expire, s. 0: never.
  double max_age_s = 0.0;
  /// Candidates whose scan is missing for longer than this expire, s. 0: never.
  double max_wait_s = 600.0;
  /// Maximum number of pending candidates. Beyond it, the oldest expire. 0: no bound.
  std::int64_t max_pending = 0;
  /// A candidate comes last if both of its ends are within this distance of the ends of a verified closure
  /// between the same robots, m. 0: no such rule.
  double redundant_m = 0.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_age_s", self.max_age_s, at_least(0.0));
    field("max_wait_s", self.max_wait_s, at_least(0.0));
    field("max_pending", self.max_pending, at_least(0.0));
    field("redundant_m", self.redundant_m, at_least(0.0));
  }
};

/// Owns the candidates of a run from their generation to their result. Numbers them, stores those with
/// missing scans, feeds the queue and keeps the account. Not thread-safe.
///
/// Exceptions of a prioritiser are passed on. The candidates that were being added to it are then pruned.
class LOOPWISE_EXPORT CandidatePool {
 public:
  /// `redundant_m` needs `robots`. \throws OptionError, also if they are missing for it.
  CandidatePool(const CandidatePoolOptions& options, RoundRobinQueue queue, Robots robots = {});

  /// Numbers and stores new pairs. (a, b) and (b, a) are one pair. Known pairs are ignored unless they were
  /// forgotten, but a pair that was not handed out yet takes over the recognition. A time before that of an
  /// earlier candidate counts as that time. \returns the number of new pairs.
  std::size_t add(const std::vector<LoopCandidate>& candidates);

  /// A node's scan has arrived: notifies the prioritisers; candidates that waited only for it become pending.
  void on_scan(const KeyedScan& scan);
  /// A new estimate has arrived: notifies the prioritisers.
  void on_graph(const PoseGraph& graph);

  /// Expires candidates that are too old, wait too long, or exceed the bound at mission time `now_s`. The
  /// cost is proportional to the expired candidates.
  void expire(double now_s);
  /// No more scans will come: all waiting candidates expire.
  void expire_waiting();

  /// Lets the prioritisers prepare the next batch, see RoundRobinQueue::improve().
  void improve(std::size_t count, const StopToken& stop, const std::vector<std::uint64_t>& max_evaluations,
               std::vector<std::uint64_t>& used) {
    queue_.improve(count, stop, max_evaluations, used);
  }

  /// The next batch of up to `count` candidates.
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count);
  /// \throws InputError if the result's candidate is not in flight.
  void complete(const RegistrationResult& result);
  /// Reports that the graph has a closure between two nodes: candidates near it are redundant from now on.
  void closure_added(Key from, Key to) { closed_.insert(std::minmax(from, to)); }
  /// Reports that the graph no longer has a closure between two nodes.
  void closure_removed(Key from, Key to) { closed_.erase(std::minmax(from, to)); }
  /// Makes candidates in flight pending again because they will not be computed.
  void give_back(const std::vector<LoopCandidate>& candidates);

  /// Forgets computed candidates whose outcome is obsolete because one of their nodes has moved. The pairs
  /// may then be proposed again.
  void forget(const std::vector<std::pair<Key, Key>>& pairs);

  /// Mission time at which the oldest pending candidate was generated, if one exists.
  [[nodiscard]] std::optional<double> oldest_pending_s() const;
  /// State of every candidate.
  [[nodiscard]] const CandidateAccounting& accounting() const { return accounting_; }
  /// Numbers of pruned candidates, by reason.
  [[nodiscard]] const std::map<std::string, std::size_t>& pruned_reasons() const { return pruned_reasons_; }
  /// Numbers of expired candidates, by reason.
  [[nodiscard]] const std::map<std::string, std::size_t>& expired_reasons() const { return expired_reasons_; }
  /// The queue of prioritisers.
  [[nodiscard]] const RoundRobinQueue& queue() const { return queue_; }

 private:
  struct PairHash {
    std::size_t operator()(const std::pair<Key, Key>& pair) const;
  };

  /// Positions of the two ends, that of the lower robot first; empty if a position is unknown.
  struct Place {
    std::pair<std::size_t, std::size_t> robots;
    Eigen::Vector3d first, second;
  };
  [[nodiscard]] std::optional<Place> place_of(Key from, Key to) const;
  [[nodiscard]] bool redundant(const LoopCandidate& candidate) const;
  void take_recognition(CandidateId id, LoopCandidate from);
  void enqueue(const std::vector<LoopCandidate>& pending);
  void prune(const std::vector<LoopCandidate>& candidates, std::string_view reason);
  void drop_pending(const std::vector<CandidateId>& ids, std::string_view reason);

  CandidatePoolOptions options_;
  RoundRobinQueue queue_;
  Robots robots_;
  CandidateAccounting accounting_;
  CandidateId next_id_ = 0;
  double latest_s_ = 0.0;  // candidates are ordered by id and by time
  std::unordered_map<std::pair<Key, Key>, CandidateId, PairHash> proposed_;
  std::unordered_set<Key> scans_;
  IdTable<LoopCandidate> waiting_;
  std::unordered_map<Key, std::vector<CandidateId>> waiting_for_;  // missing scan -> candidates, in order
  IdTable<LoopCandidate> pending_;
  IdTable<LoopCandidate> in_flight_;
  std::unordered_map<Key, Eigen::Vector3d> positions_;  // in the last estimate; stored only for redundant_m
  std::set<std::pair<Key, Key>> closed_;                // pairs with a closure
  std::deque<LoopCandidate> redundant_;                 // pending, but in no prioritiser any more
  std::map<std::string, std::size_t> pruned_reasons_;
  std::map<std::string, std::size_t> expired_reasons_;
};

}  // namespace loopwise
