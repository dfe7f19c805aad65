// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <memory>

#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise {

/// Number of a candidate within a run, from 0 in the order of generation.
using CandidateId = std::uint64_t;

/// Origin of a candidate.
enum class CandidateSource {
  kProximity,   ///< ProximityGenerator
  kRadio,       ///< RadioGenerator
  kUser,        ///< The stack's place recognition.
  kAppearance,  ///< AppearanceGenerator
};
[[nodiscard]] inline EnumNames<CandidateSource> enum_names(CandidateSource) {
  return {{CandidateSource::kProximity, "proximity"},
          {CandidateSource::kRadio, "radio"},
          {CandidateSource::kUser, "user"},
          {CandidateSource::kAppearance, "appearance"}};
}

struct Recognition;

/// A hypothesis that two nodes saw the same place. Most of the cost is in finding the transform; a place
/// recognition may provide a guess. (a, b) and (b, a) are one candidate.
struct LoopCandidate {
  CandidateId id = 0;                                    ///< Assigned by the candidate pool.
  Key from = 0;                                          ///< The newer node.
  Key to = 0;                                            ///< The older node.
  CandidateSource source = CandidateSource::kProximity;  ///< Origin of the candidate.
  double time_s = 0.0;                                   ///< Mission time of its generation.
  double distance_m = 0.0;  ///< Distance of the two nodes in the estimate at that time.
  /// Result of a place recognition, see core/recognition.hpp; null: no result.
  std::shared_ptr<const Recognition> recognition;
};

}  // namespace loopwise
