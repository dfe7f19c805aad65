// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/acceptance.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string>
#include <system_error>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

using Vector = Eigen::Matrix<double, AcceptanceModel::kTerms, 1>;
using Matrix = Eigen::Matrix<double, AcceptanceModel::kTerms, AcceptanceModel::kTerms>;

Eigen::Map<const Vector> as_vector(const AcceptanceModel::Terms& terms) {
  return Eigen::Map<const Vector>(terms.data());
}

/// Term of a recognised place in the logit. Correct guesses have similarities of 0.3 to 0.6, i.e. terms of
/// 1.2 to 2.4.
double recognised(const CandidateEvidence& evidence) {
  constexpr double kWeight = 4.0;
  return kWeight * evidence.similarity;
}

double logistic(double x) {
  return 1.0 / (1.0 + std::exp(-std::clamp(x, -30.0, 30.0)));
}

}  // namespace

AcceptanceModel::AcceptanceModel(const Terms& weights, double prior_strength)
    : prior_(weights), strength_(prior_strength), weights_(weights) {
  if (!as_vector(weights).allFinite()) throw OptionError("a weight of the acceptance model is not finite");
  if (!(prior_strength > 0.0) || !std::isfinite(prior_strength)) {
    throw OptionError("prior_strength must be finite and > 0");
  }
}

std::array<const char*, AcceptanceModel::kTerms> AcceptanceModel::term_names() {
  return {"constant", "overlap", "overlap_squared", "overlap_unknown", "distance", "from_outside"};
}

AcceptanceModel::Terms AcceptanceModel::terms(const CandidateEvidence& evidence) {
  if (evidence.from_outside) return {0.0, 0.0, 0.0, 0.0, 0.0, 1.0};
  constexpr double kScale_m = 10.0, kFarthest = 10.0;
  const bool known = std::isfinite(evidence.overlap);
  const double overlap = known ? std::clamp(evidence.overlap, 0.0, 1.0) : 0.0;
  const double distance = std::isfinite(evidence.distance_m)
                              ? std::clamp(evidence.distance_m / kScale_m, 0.0, kFarthest)
                              : kFarthest;
  return {1.0, overlap, overlap * overlap, known ? 0.0 : 1.0, distance, 0.0};
}

const AcceptanceModel::Terms& AcceptanceModel::shipped_verified() {
  static const Terms weights{0.4, 10.1, -3.6, 2.0, -2.7, -1.0};
  return weights;
}

const AcceptanceModel::Terms& AcceptanceModel::shipped_right() {
  static const Terms weights{0.9, 15.8, 0.4, 3.0, -1.5, 1.0};
  return weights;
}

AcceptanceModel::Terms AcceptanceModel::parse(std::string_view text, std::string_view option) {
  Terms weights{};
  std::size_t count = 0;
  for (const char *at = text.data(), *end = at + text.size(); at <= end; ++count) {
    const char* const comma = std::find(at, end, ',');
    double value = 0.0;
    const auto [stop, error] = std::from_chars(at, comma, value);
    if (error != std::errc() || stop != comma || !std::isfinite(value)) {
      throw OptionError(std::string(option) + ": \"" + std::string(at, comma) + "\" is not a number");
    }
    if (count < kTerms) weights[count] = value;
    at = comma + 1;
  }
  if (count != kTerms) {
    throw OptionError(std::string(option) + ": " + std::to_string(count) + " numbers, " +
                      std::to_string(kTerms) + " are needed");
  }
  return weights;
}

double AcceptanceModel::probability(const CandidateEvidence& evidence) const {
  const Terms x = terms(evidence);
  return logistic(as_vector(weights_).dot(as_vector(x)) + recognised(evidence));
}

void AcceptanceModel::fit(const std::vector<std::pair<CandidateEvidence, bool>>& results) {
  // Newton's method on the log posterior, which is concave, from the result of the last fit. A step that
  // would lower it is halved. The information of the prior equals that of strength_ results with probability
  // ½ and a term of 1.
  constexpr int kSteps = 20, kHalvings = 30;
  std::vector<Terms> x;
  x.reserve(results.size());
  for (const auto& result : results) x.push_back(terms(result.first));
  Vector w = as_vector(weights_);
  const Vector w0 = as_vector(prior_);
  const double prior_information = 0.25 * strength_;
  const auto log_posterior = [&](const Vector& at) {
    double sum = -0.5 * prior_information * (at - w0).squaredNorm();
    for (std::size_t i = 0; i < x.size(); ++i) {
      const double logit =
          (results[i].second ? 1.0 : -1.0) * (at.dot(as_vector(x[i])) + recognised(results[i].first));
      sum -= logit > 0.0 ? std::log1p(std::exp(-logit)) : std::log1p(std::exp(logit)) - logit;
    }
    return sum;
  };
  double value = log_posterior(w);
  for (int step = 0; step < kSteps; ++step) {
    Vector gradient = prior_information * (w0 - w);
    Matrix information = prior_information * Matrix::Identity();
    for (std::size_t i = 0; i < x.size(); ++i) {
      const Eigen::Map<const Vector> terms = as_vector(x[i]);
      const double p = logistic(w.dot(terms) + recognised(results[i].first));
      gradient += ((results[i].second ? 1.0 : 0.0) - p) * terms;
      information.noalias() += p * (1.0 - p) * terms * terms.transpose();
    }
    Vector change = information.llt().solve(gradient);
    double next = log_posterior(w + change);
    for (int half = 0; half < kHalvings && !(next >= value); ++half) {
      change *= 0.5;
      next = log_posterior(w + change);
    }
    if (!(next >= value)) break;
    w += change;
    value = next;
    if (!(change.cwiseAbs().maxCoeff() > 1e-6)) break;
  }
  Eigen::Map<Vector>(weights_.data()) = w;
}

void Calibration::add(double probability, bool verified) {
  const double p = std::clamp(probability, 0.0, 1.0);
  Bin& bin = bins_[std::min<std::size_t>(static_cast<std::size_t>(10.0 * p), 9)];
  ++bin.count;
  bin.verified += verified ? 1 : 0;
  bin.expected += p;
  squares_ += (p - (verified ? 1.0 : 0.0)) * (p - (verified ? 1.0 : 0.0));
  ++count_;
}

double Calibration::brier() const {
  return count_ > 0 ? squares_ / static_cast<double>(count_) : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace loopwise
