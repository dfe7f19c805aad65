// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/observability.hpp>

#include <algorithm>

#include <loopwise/core/error.hpp>

namespace loopwise {

ObservabilityPrioritizer::ObservabilityPrioritizer(const ObservabilityPriorityOptions& options, Robots robots,
                                                   Eigenvalue eigenvalue)
    : options_(options), robots_(std::move(robots)), eigenvalue_(std::move(eigenvalue)) {
  validate(options_);
  if (!eigenvalue_) throw InputError("ObservabilityPrioritizer needs a function for the eigenvalue");
}

void ObservabilityPrioritizer::on_scan(const KeyedScan& scan) {
  // An empty or degenerate scan has no smallest eigenvalue; it counts as 0, never as NaN.
  const double found = eigenvalue_(scan);
  const double value = found > 0.0 ? found : 0.0;
  double& largest = largest_[options_.variant == ObservabilityVariant::kLamp ? robots_.of(scan.key) : 0];
  largest = std::max(largest, value);
  scores_.emplace(scan.key, largest > 0.0 ? value / largest : 0.0);
}

double ObservabilityPrioritizer::score(Key key) const {
  const auto found = scores_.find(key);
  return found == scores_.end() ? 0.0 : found->second;
}

std::vector<Refusal> ObservabilityPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  std::vector<Refusal> refused;
  for (const LoopCandidate& candidate : candidates) {
    const double from = score(candidate.from), to = score(candidate.to);
    const bool keep = options_.variant == ObservabilityVariant::kLamp
                          ? std::min(from, to) >= options_.min_score
                          : from + to >= options_.min_sum;
    if (keep) {
      ranked_.insert(candidate, from + to);
    } else {
      refused.push_back({candidate.id, "low_observability"});
    }
  }
  return refused;
}

}  // namespace loopwise
