// SPDX-License-Identifier: BSD-3-Clause
// Pairs of another place recognition.
#include <cmath>

#include <loopwise/core/recognition.hpp>
#include <loopwise/io/candidates.hpp>

#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(candidates, bytes) {
  using namespace loopwise;
  const auto pairs = fuzz::attempt([&] { return parse_candidates(bytes, "pairs.csv"); });
  if (!pairs) return;
  for (const LoopCandidate& pair : *pairs) {
    fuzz::expect(pair.from != pair.to, "a pair has two nodes");
    if (!pair.recognition) continue;
    const double similarity = pair.recognition->similarity;
    fuzz::expect(std::isnan(similarity) || (similarity >= 0.0 && similarity <= 1.0), "scores are in [0, 1]");
    if (pair.recognition->T_from_to) fuzz::check_pose(*pair.recognition->T_from_to);
  }
}
