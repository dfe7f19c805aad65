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
/// §III-E). A candidate taken from one leaves the others; one that is refused by some stays with the rest.
class LOOPWISE_EXPORT RoundRobinQueue {
 public:
  /// May be empty: then every candidate is refused ("no_prioritizer"). \throws InputError on a null pointer.
  explicit RoundRobinQueue(std::vector<std::unique_ptr<Prioritizer>> prioritizers);

  /// \returns the candidates that every prioritiser refused, with their reasons joined. \throws what a
  /// prioritiser throws: then call remove(), or some may still hold them
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates);
  /// Expired or withdrawn: all prioritisers forget them, and all are told, also if one throws.
  void remove(const std::vector<CandidateId>& ids);
  /// Hands on to all prioritisers, also if one throws.
  void on_graph(const PoseGraph& graph);
  /// Hands on to all prioritisers, also if one throws.
  void on_scan(const KeyedScan& scan);
  /// Hands on to all prioritisers, also if one throws.
  void on_result(const RegistrationResult& result);

  /// Lets every prioritiser prepare its share of a batch of `count`, also if one throws, with a bound of
  /// evaluations each; those without a bound are not bound. `used` becomes the evaluations that each used,
  /// see Prioritizer::improve(); 0 for one that threw.
  void improve(std::size_t count, const StopToken& stop, const std::vector<std::uint64_t>& max_evaluations,
               std::vector<std::uint64_t>& used);

  /// \returns the candidates that were held back and are not waited for any longer, as give_up() of the
  /// prioritisers says, and that no other prioritiser holds.
  std::vector<Refusal> give_up(double now_s);

  /// Up to `count` candidates. Turns pass from one prioritiser to the next; whoever is empty is passed over,
  /// and the next batch begins after the one that had the last turn, so shares stay equal over time.
  /// Fewer than size() if prioritisers hold candidates back. If a prioritiser throws, what others had given
  /// goes back to them. \throws Error if one hands out what it was not asked for or what is not pending
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count);

  /// Candidates that at least one prioritiser holds.
  [[nodiscard]] std::size_t size() const { return holders_.size(); }
  /// In the order of their turns.
  [[nodiscard]] const std::vector<std::unique_ptr<Prioritizer>>& prioritizers() const {
    return prioritizers_;
  }
  /// How many candidates each prioritiser has handed out, in their order; one that was given back counts
  /// again.
  [[nodiscard]] const std::vector<std::size_t>& handed_out() const { return handed_out_; }

 private:
  /// All that is taken on the way stands in `taken`, also if it throws.
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
