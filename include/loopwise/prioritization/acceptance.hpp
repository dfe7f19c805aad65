// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Probability that a candidate becomes a closure, learned during a mission.
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

/// Evidence on a candidate before its registration.
struct CandidateEvidence {
  /// predicted_overlap() of the two scans at the guess, in [0, 1]; NaN if a scan is missing.
  double overlap = std::numeric_limits<double>::quiet_NaN();
  double distance_m = 0.0;  ///< Between the nodes, by the estimate.
  /// Proposed by a radio beacon, or by a place recognition without a guess of the pose: distance and overlap
  /// at the graph's pose are then uninformative.
  bool from_outside = false;
  /// Recognition::similarity if a place recognition guessed the pose from which overlap and distance are
  /// computed; else 0. It adds to the logit with a fixed weight, which is not learned.
  double similarity = 0.0;
};

/// A logistic model of the probability that a candidate succeeds. Its weights start from a prior and are
/// fitted to the results of the run (maximum a posteriori). The prior counts for `prior_strength` results.
/// The same results in the same order give the same model. ExpectedPrioritizer has two: one predicts whether
/// a candidate is verified, the other whether robust optimisation keeps a verified closure.
class LOOPWISE_EXPORT AcceptanceModel {
 public:
  static constexpr std::size_t kTerms = 6;          ///< Terms of the model, including the constant.
  using Terms = std::array<double, kTerms>;         ///< One number a term.
  static constexpr double kDefaultStrength = 50.0;  ///< Weight of the prior, in results.

  /// A model with initial weights: shipped_verified(), shipped_right(), or others. \throws OptionError on a
  /// weight that is not finite, or a strength that is not finite and > 0
  explicit AcceptanceModel(const Terms& weights, double prior_strength = kDefaultStrength);

  /// The probability, in (0, 1).
  [[nodiscard]] double probability(const CandidateEvidence& evidence) const;

  /// Fits the weights again. `results` has the evidence and the outcome of all results.
  void fit(const std::vector<std::pair<CandidateEvidence, bool>>& results);

  /// The present weights, one for each term.
  [[nodiscard]] const Terms& weights() const { return weights_; }
  /// The terms of the evidence.
  [[nodiscard]] static Terms terms(const CandidateEvidence& evidence);
  /// Names of the terms, in order.
  [[nodiscard]] static std::array<const char*, kTerms> term_names();
  /// Initial weights for the probability that a candidate is verified, fitted to simulated missions, see
  /// docs/prioritization.md.
  [[nodiscard]] static const Terms& shipped_verified();
  /// Initial weights for the probability that robust optimisation keeps a verified closure, fitted in the
  /// same way.
  [[nodiscard]] static const Terms& shipped_right();
  /// Weights from the text of an option, separated by commas: "0.4,10.1,-3.6,2,-2.7,-1". \throws OptionError
  /// that names `option`
  [[nodiscard]] static Terms parse(std::string_view text, std::string_view option);

 private:
  Terms prior_;
  double strength_;
  Terms weights_;
};

/// Agreement of predicted probabilities with outcomes.
class LOOPWISE_EXPORT Calibration {
 public:
  /// Probabilities within one tenth.
  struct Bin {
    std::size_t count = 0;     ///< Of results.
    std::size_t verified = 0;  ///< Verified results.
    double expected = 0.0;     ///< Sum of the predicted probabilities.
  };

  /// Adds a result with its predicted `probability`.
  void add(double probability, bool verified);
  /// Mean squared difference between probability and outcome, in [0, 1]; NaN without results.
  [[nodiscard]] double brier() const;
  /// The reliability table: probabilities of [0, 0.1), [0.1, 0.2), …
  [[nodiscard]] const std::array<Bin, 10>& bins() const { return bins_; }

 private:
  std::array<Bin, 10> bins_{};
  double squares_ = 0.0;
  std::size_t count_ = 0;
};

}  // namespace loopwise
