// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/prioritization/ranked_candidates.hpp>

namespace loopwise {

/// The candidates of the radio generator, in the order of the fly-bys (paper §III-D). Refuses all others
/// ("not_radio").
class LOOPWISE_EXPORT RssiPrioritizer final : public Prioritizer {
 public:
  [[nodiscard]] std::string_view name() const override { return "rssi"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override { ranked_.erase(ids); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  [[nodiscard]] std::size_t size() const override { return ranked_.size(); }

 private:
  RankedCandidates ranked_;
};

}  // namespace loopwise
