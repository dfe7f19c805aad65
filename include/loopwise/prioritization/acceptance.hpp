// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How likely a candidate becomes a closure, learned while a mission runs.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>
#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// What is known of a candidate before it is computed.
struct CandidateEvidence {
  /// predicted_overlap() of the two scans at the guess, in [0, 1]; NaN if a scan is missing.
  double overlap = std::numeric_limits<double>::quiet_NaN();
  double distance_m = 0.0;  ///< Between the nodes, by the estimate.
  /// A radio beacon, or a place recognition without a guess of the pose, proposed it: then neither distance
  /// nor overlap at the graph's pose say much.
  bool from_outside = false;
  /// Recognition::similarity where a place recognition has guessed the pose that overlap and distance are of;
  /// else 0. It adds to the logit with a fixed weight, which is not learned.
  double similarity = 0.0;
};

/// A logistic model of the probability that a candidate succeeds. Its weights start from a prior and are
/// fitted to the results of the run (maximum a posteriori). The prior counts for `prior_strength` results.
/// The same results in the same order give the same model. ExpectedPrioritizer has two: one predicts whether
/// a candidate is verified, the other whether robust optimisation keeps a verified closure.
class LOOPWISE_EXPORT AcceptanceModel {
 public:
  static constexpr std::size_t kTerms = 6;          ///< Of the model, the constant one included.
  using Terms = std::array<double, kTerms>;         ///< One number a term.
  static constexpr double kDefaultStrength = 50.0;  ///< Results that the prior counts for.

  /// With weights to begin with: shipped_verified(), shipped_right(), or others. \throws OptionError on one
  /// that is not finite, or a strength that is not finite and > 0
  explicit AcceptanceModel(const Terms& weights, double prior_strength = kDefaultStrength);

  /// The chance, in (0, 1).
  [[nodiscard]] double probability(const CandidateEvidence& evidence) const;

  /// Fits the weights anew. `results` has the evidence and the outcome of all that counts.
  void fit(const std::vector<std::pair<CandidateEvidence, bool>>& results);

  /// The weights as they stand, one for each term.
  [[nodiscard]] const Terms& weights() const { return weights_; }
  /// The terms that the evidence comes to.
  [[nodiscard]] static Terms terms(const CandidateEvidence& evidence);
  /// Names of the terms, in order.
  [[nodiscard]] static std::array<const char*, kTerms> term_names();
  /// That a candidate is verified, fitted to simulated missions, see docs/prioritization.md.
  [[nodiscard]] static const Terms& shipped_verified();
  /// That a verified closure is right, likewise.
  [[nodiscard]] static const Terms& shipped_right();
  /// Weights as an option has them, by commas: "0.4,10.1,-3.6,2,-2.7,-1". \throws OptionError that names
  /// `option`
  [[nodiscard]] static Terms parse(std::string_view text, std::string_view option);

 private:
  Terms prior_;
  double strength_;
  Terms weights_;
};

/// How well chances that were said beforehand agree with what came.
class LOOPWISE_EXPORT Calibration {
 public:
  /// Chances of one tenth.
  struct Bin {
    std::size_t count = 0;     ///< Of results.
    std::size_t verified = 0;  ///< Of them, verified.
    double expected = 0.0;     ///< Sum of the chances that were said.
  };

  /// A result of which `probability` was said.
  void add(double probability, bool verified);
  /// Mean squared difference between chance and outcome, in [0, 1]; NaN without results.
  [[nodiscard]] double brier() const;
  /// The reliability table: chances of [0, 0.1), [0.1, 0.2), …
  [[nodiscard]] const std::array<Bin, 10>& bins() const { return bins_; }

 private:
  std::array<Bin, 10> bins_{};
  double squares_ = 0.0;
  std::size_t count_ = 0;
};

}  // namespace loopwise
