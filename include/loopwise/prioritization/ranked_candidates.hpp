// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/id_table.hpp>
#include <loopwise/core/loop_candidate.hpp>

namespace loopwise {

/// Candidates by descending score, equal scores by ascending id, for most prioritisers. insert() and erase()
/// take constant time on average, take() O(log n) for each candidate.
class LOOPWISE_EXPORT RankedCandidates {
 public:
  /// \pre the id is not held yet and the score is not NaN.
  void insert(const LoopCandidate& candidate, double score);
  /// Ids that are not held are ignored.
  void erase(const std::vector<CandidateId>& ids);
  /// Removes and returns the first `count`, or all if there are fewer.
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count);
  /// Number of candidates.
  [[nodiscard]] std::size_t size() const { return held_.size(); }

 private:
  struct Entry {
    double score;
    LoopCandidate candidate;
    /// Comes after the other one.
    bool operator<(const Entry& other) const {
      return score != other.score ? score < other.score : candidate.id > other.candidate.id;
    }
  };
  /// Drops erased candidates from the heap.
  void compact();

  std::vector<Entry> heap_;  // erased candidates stay until they come up, or outnumber the others
  IdTable<char> held_;
  IdTable<char> erased_;  // ids of erased candidates that are still in the heap
};

}  // namespace loopwise
