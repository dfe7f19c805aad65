// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Copies the accounts of the pool and its prioritisers at the end of a run.
inline void take_account(const CandidatePool& pool, ReplayResult& result) {
  result.accounting = pool.accounting();
  result.pruned = pool.pruned_reasons();
  result.expired = pool.expired_reasons();
  const auto& prioritizers = pool.queue().prioritizers();
  for (std::size_t i = 0; i < prioritizers.size(); ++i) {
    result.handed_out.emplace_back(prioritizers[i]->name(), pool.queue().handed_out()[i]);
    if (const Calibration* calibration = prioritizers[i]->calibration()) {
      result.calibration.emplace_back(prioritizers[i]->name(), *calibration);
    }
  }
}

}  // namespace loopwise
