// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Judging computed candidates against the truth.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/registration_result.hpp>

namespace loopwise::study {

/// A candidate with what is true of it.
struct StudyPair {
  LoopCandidate candidate;     ///< Both ends.
  double distance_m = 0.0;     ///< True.
  double overlap = 0.0;        ///< Share of the source's points within 0.5 m of the target at the true pose.
  double observability = 0.0;  ///< The lesser of the two scans' λ_min of Σ n nᵀ / N.
  /// Whether a registrar is expected to find it.
  [[nodiscard]] bool overlapping() const { return overlap >= 0.4; }
};

/// Result of one registrar for a candidate.
struct PairOutcome {
  RejectionReason reason = RejectionReason::kNone;  ///< Why it was refused.
  bool accepted = false;                            ///< It was verified.
  double error_m = 0.0;                             ///< Of the translation; NaN unless a pose was found.
  double error_rad = 0.0;                           ///< Of the rotation; NaN unless a pose was found.
  double squared_mahalanobis = 0.0;                 ///< Of the whole error; NaN unless accepted.
  double weak_sigma_m = 0.0;  ///< Largest standard deviation of the translation; NaN unless accepted.
  double weak_error = 0.0;    ///< Error along that direction in standard deviations.
  double features_s = 0.0;    ///< As in RegistrationResult, as the next two.
  double global_s = 0.0;      ///< Of the feature-based stage.
  double refine_s = 0.0;      ///< Of refinement and tests.

  /// Accepted within 0.5 m and 3°.
  [[nodiscard]] bool right() const {
    return accepted && error_m <= 0.5 && error_rad <= 3.0 * 0.0174532925199433;
  }
  /// Accepted, wrong, and outside its own covariance: χ²₆(0.999).
  [[nodiscard]] bool false_accept() const { return accepted && !right() && squared_mahalanobis > 22.4577; }
  /// Of all stages.
  [[nodiscard]] double seconds() const { return features_s + global_s + refine_s; }
};

/// Compares a result with the truth. \pre `truth` is T_from_to of the same pair.
[[nodiscard]] LOOPWISE_EXPORT PairOutcome judge(const RegistrationResult& result,
                                                const Eigen::Isometry3d& truth);

/// Upper end of the one-sided 95 % interval (Clopper and Pearson 1934) of a share seen as `count` of `total`;
/// 1 for a total of 0.
[[nodiscard]] LOOPWISE_EXPORT double upper_bound_95(std::size_t count, std::size_t total);

/// Figures of one registrar over some pairs.
struct PairSummary {
  std::size_t pairs = 0;            ///< Looked at.
  std::size_t overlapping = 0;      ///< Of them, StudyPair::overlapping().
  std::size_t recalled = 0;         ///< Overlapping, and accepted within 0.5 m and 3°.
  std::size_t accepted = 0;         ///< Right or wrong.
  std::size_t wrong = 0;            ///< Accepted beyond 0.5 m or 3°.
  std::size_t false_accepts = 0;    ///< Of these, outside the closure's own covariance.
  double recall = 0.0;              ///< Recalled of the overlapping; NaN if nothing overlaps.
  double false_accept_bound = 0.0;  ///< upper_bound_95() of false accepts.
  double median_m = 0.0;            ///< Translation error of right closures.
  double median_rad = 0.0;          ///< Rotation error of right closures.
  double largest_m = 0.0;           ///< Translation error of right closures.
  /// Right closures' squared Mahalanobis errors, 6 expected: their mean. The next three are the shares beyond
  /// the 5 %, 95 % and 99.9 % points of χ²₆.
  double mean_squared_error = 0.0;
  double beyond_5 = 0.0;    ///< 0.95 of a perfect covariance.
  double beyond_95 = 0.0;   ///< 0.05 of a perfect covariance.
  double beyond_999 = 0.0;  ///< 0.001 of a perfect covariance.
  /// The same along the weakest direction of closures that have one (σ ≥ 0.5 m): how many. All accepted
  /// closures count, right or not.
  std::size_t degenerate = 0;
  double degenerate_beyond_95 = 0.0;  ///< Share of them beyond 1.96 σ: 0.05 if perfect.
  double features_ms = 0.0;           ///< Median.
  double global_ms = 0.0;             ///< Median.
  double refine_ms = 0.0;             ///< Median.
  double accepted_ms = 0.0;           ///< Median of the whole of an accepted pair.
  double rejected_ms = 0.0;           ///< Median of the whole of a rejected pair.
  double mean_ms = 0.0;               ///< Mean of the whole of a pair.
};

/// Figures over the pairs `chosen` (positions in both).
[[nodiscard]] LOOPWISE_EXPORT PairSummary summarize(const std::vector<StudyPair>& pairs,
                                                    const std::vector<PairOutcome>& outcomes,
                                                    const std::vector<std::size_t>& chosen);

/// A property of pairs, cut into ranges.
struct Stratum {
  std::string property;            ///< "distance_m", "overlap" or "observability"
  double from = 0.0;               ///< Least value.
  double to = 0.0;                 ///< All values are below; may be infinite.
  std::vector<std::size_t> pairs;  ///< Positions of those within.
};
/// Ranges by distance, overlap and observability, over the first `count` pairs.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Stratum> strata(const std::vector<StudyPair>& pairs,
                                                          std::size_t count);

}  // namespace loopwise::study
