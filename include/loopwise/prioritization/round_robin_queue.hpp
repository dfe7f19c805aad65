// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/id_table.hpp>
#include <loopwise/prioritization/prioritizer.hpp>

namespace loopwise {

/// Joins the prioritisers of a method: batches take equal shares from each, best first, in turns (paper
/// §III-E). A candidate taken from one prioritiser is removed from the others; one refused by some stays with
/// the rest. If a prioritiser throws, an Error names it and the function; the original is nested in it.
class LOOPWISE_EXPORT RoundRobinQueue {
 public:
  /// May be empty: then every candidate is refused ("no_prioritizer"). \throws InputError on a null pointer.
  explicit RoundRobinQueue(std::vector<std::unique_ptr<Prioritizer>> prioritizers);

  /// \returns the candidates that every prioritiser refused, with their reasons joined. \throws Error if a
  /// prioritiser throws: then call remove(), because others may still hold the candidates
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates);
  /// Removes expired or withdrawn candidates from all prioritisers, also if one throws.
  void remove(const std::vector<CandidateId>& ids);
  /// Hands on to all prioritisers, also if one throws.
  void on_graph(const PoseGraph& graph);
  /// Hands on to all prioritisers, also if one throws.
  void on_scan(const KeyedScan& scan);
  /// Hands on to all prioritisers, also if one throws.
  void on_result(const RegistrationResult& result);

  /// Lets every prioritiser prepare its share of a batch of `count`, also if one throws, with a bound of
  /// evaluations each; a missing bound means no bound. `used` gets the evaluations of each, see
  /// Prioritizer::improve(); 0 for one that threw.
  void improve(std::size_t count, const StopToken& stop, const std::vector<std::uint64_t>& max_evaluations,
               std::vector<std::uint64_t>& used);

  /// \returns the candidates that prioritisers held back too long, see Prioritizer::give_up(), and that no
  /// other prioritiser holds.
  std::vector<Refusal> give_up(double now_s);

  /// Up to `count` candidates. Turns pass from one prioritiser to the next; empty ones are skipped, and the
  /// next batch begins after the prioritiser with the last turn, so shares stay equal over time. Fewer than
  /// size() if prioritisers hold candidates back. If a prioritiser throws, the candidates of the others go
  /// back to them. \throws Error if a prioritiser hands out too many candidates or candidates that are not
  /// pending
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count);

  /// Candidates that at least one prioritiser holds.
  [[nodiscard]] std::size_t size() const { return holders_.size(); }
  /// In the order of their turns.
  [[nodiscard]] const std::vector<std::unique_ptr<Prioritizer>>& prioritizers() const {
    return prioritizers_;
  }
  /// Number of candidates that each prioritiser has handed out, in their order; candidates that were given
  /// back count again.
  [[nodiscard]] const std::vector<std::size_t>& handed_out() const { return handed_out_; }

 private:
  /// `taken` gets all candidates, also if it throws.
  [[nodiscard]] std::vector<LoopCandidate> take_in_turns(std::size_t count,
                                                         std::vector<LoopCandidate>& taken);
  [[nodiscard]] std::vector<LoopCandidate> share_of(Prioritizer& prioritizer, std::size_t count,
                                                    std::vector<LoopCandidate>& taken);

  std::vector<std::unique_ptr<Prioritizer>> prioritizers_;
  std::vector<std::size_t> handed_out_;
  IdTable<std::size_t> holders_;  // pending candidate -> how many prioritisers hold it
  std::size_t turn_ = 0;
};

}  // namespace loopwise
