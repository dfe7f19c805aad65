// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/prioritization/ranked_candidates.hpp>

namespace loopwise {

/// First generated, first computed: the paper's *Bsln*.
class LOOPWISE_EXPORT ArrivalPrioritizer final : public Prioritizer {
 public:
  [[nodiscard]] std::string_view name() const override { return "arrival"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override { ranked_.erase(ids); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  [[nodiscard]] std::size_t size() const override { return ranked_.size(); }

 private:
  RankedCandidates ranked_;
};

/// Uniformly random order: the paper's *Rand*. A candidate's place depends on (seed, from, to) alone, so all
/// sets are equally likely, independent of the order of arrival.
class LOOPWISE_EXPORT RandomPrioritizer final : public Prioritizer {
 public:
  /// Equal seeds give equal orders.
  explicit RandomPrioritizer(std::uint64_t seed) : seed_(seed) {}
  [[nodiscard]] std::string_view name() const override { return "random"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override { ranked_.erase(ids); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  [[nodiscard]] std::size_t size() const override { return ranked_.size(); }

 private:
  std::uint64_t seed_;
  RankedCandidates ranked_;
};

}  // namespace loopwise
