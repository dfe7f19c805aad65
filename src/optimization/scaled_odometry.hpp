// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the sources of Starts share.
#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <vector>

#include "confirmed_closures.hpp"
#include "robust_starts.hpp"

namespace loopwise::detail {

/// Costs that differ by less than this share are equal; the result of the earlier start is then kept.
inline constexpr double kEqual = 1e-9;

/// Variance factors whose ratio is below this count as equal.
inline constexpr double kSameVariance = 1.1;

/// Whether variance factors differ by more than kSameVariance.
inline bool differ(const OdometryVariances& a, const OdometryVariances& b) {
  const auto beyond = [](const OdometryVariances& some, const OdometryVariances& others) {
    return std::any_of(some.begin(), some.end(), [&](const auto& entry) {
      const auto found = others.find(entry.first);
      return entry.second > kSameVariance * (found == others.end() ? 1.0 : found->second);
    });
  };
  return beyond(a, b) || beyond(b, a);
}

/// Number of flags that are set.
inline std::size_t count(const std::vector<char>& flags) {
  return static_cast<std::size_t>(std::count(flags.begin(), flags.end(), 1));
}

/// Flags of the weights that keep an edge.
inline std::vector<char> kept_by(const std::vector<double>& weights) {
  std::vector<char> kept(weights.size());
  for (std::size_t k = 0; k < kept.size(); ++k) kept[k] = weights[k] > kKept ? 1 : 0;
  return kept;
}

/// The problem with more uncertain odometry.
class Starts::Scaled {
 public:
  Scaled(const Starts& starts, const OdometryVariances& variances) {
    const RobustProblem& stated = starts.given_;
    if (!variances.empty()) {
      graph_.emplace(with_odometry_variances(stated.graph, starts.chains_, variances));
      forest_.emplace(joined_forest(
          *graph_, chi_squared_quantile(stated.gnc.inlier_probability, graph_->degrees_of_freedom())));
    }
    given_.emplace(RobustProblem{graph_ ? *graph_ : stated.graph, forest_ ? *forest_ : stated.forest,
                                 stated.start, stated.options, stated.gnc, stated.pool, stated.stop});
    problem_.emplace(graph_ ? PoseProblem(*graph_) : starts.problem_);
  }
  Scaled(const Scaled&) = delete;
  Scaled& operator=(const Scaled&) = delete;

  [[nodiscard]] const RobustProblem& given() const { return *given_; }
  [[nodiscard]] PoseProblem& problem() { return *problem_; }

 private:
  std::optional<PoseGraph> graph_;
  std::optional<OdometryForest> forest_;
  std::optional<RobustProblem> given_;
  std::optional<PoseProblem> problem_;
};

}  // namespace loopwise::detail
