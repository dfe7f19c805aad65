// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/rssi.hpp>

namespace loopwise {

std::vector<Refusal> RssiPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  std::vector<Refusal> refused;
  for (const LoopCandidate& candidate : candidates) {
    if (candidate.source == CandidateSource::kRadio) {
      ranked_.insert(candidate, 0.0);  // equal scores are ordered by id, i.e. by generation
    } else {
      refused.push_back({candidate.id, "not_radio"});
    }
  }
  return refused;
}

}  // namespace loopwise
