// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/ranked_candidates.hpp>

#include <algorithm>

namespace loopwise {

void RankedCandidates::insert(const LoopCandidate& candidate, double score) {
  if (held_.contains(candidate.id)) return;
  if (erased_.contains(candidate.id)) compact();  // removes its old entry, which would count as the new one
  heap_.push_back({score, candidate});
  try {
    held_.set(candidate.id, 1);
  } catch (...) {
    heap_.pop_back();
    throw;
  }
  std::push_heap(heap_.begin(), heap_.end());
}

void RankedCandidates::erase(const std::vector<CandidateId>& ids) {
  for (const CandidateId id : ids) {
    if (held_.contains(id)) {
      erased_.set(id, 1);
      held_.erase(id);
    }
  }
  if (erased_.size() > held_.size()) compact();
}

std::vector<LoopCandidate> RankedCandidates::take(std::size_t count) {
  std::vector<LoopCandidate> taken;
  taken.reserve(std::min(count, held_.size()));
  while (taken.size() < count && !heap_.empty()) {
    std::pop_heap(heap_.begin(), heap_.end());
    const LoopCandidate candidate = heap_.back().candidate;
    heap_.pop_back();
    if (held_.erase(candidate.id)) {
      taken.push_back(candidate);
    } else {
      erased_.erase(candidate.id);
    }
  }
  return taken;
}

void RankedCandidates::compact() {
  heap_.erase(std::remove_if(heap_.begin(), heap_.end(),
                             [this](const Entry& entry) { return !held_.contains(entry.candidate.id); }),
              heap_.end());
  std::make_heap(heap_.begin(), heap_.end());
  erased_.clear();
}

}  // namespace loopwise
