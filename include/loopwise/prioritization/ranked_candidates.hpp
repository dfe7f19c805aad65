// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>

namespace loopwise {

/// Candidates by falling score, equal scores by rising id: what most prioritisers need. O(log n) a change.
class LOOPWISE_EXPORT RankedCandidates {
 public:
  /// \pre the id is not held yet and the score is not NaN.
  void insert(const LoopCandidate& candidate, double score);
  /// Ids that are not held are ignored.
  void erase(const std::vector<CandidateId>& ids);
  /// Removes and returns the first `count`, or all if there are fewer.
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count);
  /// How many are held.
  [[nodiscard]] std::size_t size() const { return held_.size(); }

 private:
  std::set<std::pair<double, CandidateId>> order_;  // (−score, id)
  std::unordered_map<CandidateId, std::pair<LoopCandidate, double>> held_;
};

}  // namespace loopwise
