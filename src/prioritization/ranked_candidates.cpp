// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/ranked_candidates.hpp>

#include <algorithm>

namespace loopwise {

void RankedCandidates::insert(const LoopCandidate& candidate, double score) {
  const auto [held, is_new] = held_.emplace(candidate.id, std::make_pair(candidate, score));
  if (!is_new) return;
  try {
    order_.emplace(-score, candidate.id);
  } catch (...) {  // held, but never handed out
    held_.erase(held);
    throw;
  }
}

void RankedCandidates::erase(const std::vector<CandidateId>& ids) {
  for (const CandidateId id : ids) {
    const auto held = held_.find(id);
    if (held == held_.end()) continue;
    order_.erase({-held->second.second, id});
    held_.erase(held);
  }
}

std::vector<LoopCandidate> RankedCandidates::take(std::size_t count) {
  std::vector<LoopCandidate> taken;
  taken.reserve(std::min(count, held_.size()));
  while (taken.size() < count && !order_.empty()) {
    const auto held = held_.find(order_.begin()->second);
    taken.push_back(held->second.first);
    held_.erase(held);
    order_.erase(order_.begin());
  }
  return taken;
}

}  // namespace loopwise
