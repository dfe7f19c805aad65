// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/baselines.hpp>

#include <loopwise/core/random.hpp>

namespace loopwise {

std::vector<Refusal> ArrivalPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  for (const LoopCandidate& candidate : candidates)
    ranked_.insert(candidate, 0.0);  // equal scores are ordered by id
  return {};
}

std::vector<Refusal> RandomPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  for (const LoopCandidate& candidate : candidates) {
    const std::uint64_t bits = pair_seed(seed_, candidate.from, candidate.to);
    ranked_.insert(candidate, static_cast<double>(bits >> 11));
  }
  return {};
}

}  // namespace loopwise
