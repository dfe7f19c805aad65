// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Judging computed candidates against the truth.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/registration_result.hpp>

namespace loopwise::cli {

/// A candidate with what is true of it.
struct StudyPair {
  LoopCandidate candidate;
  double distance_m = 0.0;     ///< True.
  double overlap = 0.0;        ///< Share of the source's points within 0.5 m of the target at the true pose.
  double observability = 0.0;  ///< The lesser of the two scans' λ_min of Σ n nᵀ / N.
  [[nodiscard]] bool overlapping() const { return overlap >= 0.4; }
};

/// Result of one registrar for a candidate.
struct StudyOutcome {
  RejectionReason reason = RejectionReason::kNone;
  bool accepted = false;
  double error_m = 0.0, error_rad = 0.0;  ///< NaN unless a pose was found.
  double squared_mahalanobis = 0.0;       ///< Of the whole error; NaN unless accepted.
  double weak_sigma_m = 0.0;  ///< Largest standard deviation of the translation; NaN unless accepted.
  double weak_error = 0.0;    ///< Error along that direction in standard deviations.
  double features_s = 0.0, global_s = 0.0, refine_s = 0.0;

  [[nodiscard]] bool right() const {
    return accepted && error_m <= 0.5 && error_rad <= 3.0 * 0.0174532925199433;
  }
  /// Accepted, wrong, and outside its own covariance: χ²₆(0.999).
  [[nodiscard]] bool false_accept() const { return accepted && !right() && squared_mahalanobis > 22.4577; }
  [[nodiscard]] double seconds() const { return features_s + global_s + refine_s; }
};

/// \pre `truth` is T_from_to of the same pair.
[[nodiscard]] StudyOutcome judge(const RegistrationResult& result, const Eigen::Isometry3d& truth);

/// Upper end of the one-sided 95 % interval (Clopper and Pearson 1934) of a share seen as `count` of `total`;
/// 1 for a total of 0.
[[nodiscard]] double upper_bound_95(std::size_t count, std::size_t total);

/// Figures of one registrar over some pairs.
struct StudySummary {
  std::size_t pairs = 0, overlapping = 0;
  std::size_t recalled = 0;  ///< Overlapping, and accepted within 0.5 m and 3°.
  std::size_t accepted = 0;
  std::size_t wrong = 0;          ///< Accepted beyond that.
  std::size_t false_accepts = 0;  ///< Of these, outside the closure's own covariance.
  double recall = 0.0;            ///< NaN if nothing overlaps.
  double false_accept_bound = 0.0;
  double median_m = 0.0, median_rad = 0.0, largest_m = 0.0;  ///< Of right closures.
  /// Right closures' squared Mahalanobis errors, 6 expected: their mean, and the shares beyond the 5 %, 95 %
  /// and 99.9 % points of χ²₆ (0.95, 0.05 and 0.001 of a perfect covariance).
  double mean_squared_error = 0.0, beyond_5 = 0.0, beyond_95 = 0.0, beyond_999 = 0.0;
  /// The same along the weakest direction of closures that have one (σ ≥ 0.5 m): how many, and the share
  /// beyond 1.96 σ (0.05 if perfect). All accepted closures count, right or not.
  std::size_t degenerate = 0;
  double degenerate_beyond_95 = 0.0;
  double features_ms = 0.0, global_ms = 0.0, refine_ms = 0.0;  ///< Medians.
  double accepted_ms = 0.0, rejected_ms = 0.0, mean_ms = 0.0;  ///< Median, median, mean of the whole pair.
};

/// Over the pairs `chosen` (positions in both).
[[nodiscard]] StudySummary summarize(const std::vector<StudyPair>& pairs,
                                     const std::vector<StudyOutcome>& outcomes,
                                     const std::vector<std::size_t>& chosen);

/// A property of pairs, cut into ranges.
struct Stratum {
  std::string property;
  double from = 0.0, to = 0.0;
  std::vector<std::size_t> pairs;
};
/// By distance, overlap and observability, over the first `count` pairs.
[[nodiscard]] std::vector<Stratum> strata(const std::vector<StudyPair>& pairs, std::size_t count);

}  // namespace loopwise::cli
