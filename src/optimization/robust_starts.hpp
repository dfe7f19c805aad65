// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "gnc_solver.hpp"
#include "odometry_scale.hpp"
#include "robust_solver.hpp"

namespace loopwise::detail {

/// A result with its poses, the odometry variances used, and the components of the graph.
struct Solution {
  std::vector<Pose> poses;
  OdometryVariances odometry_variances;
  GncResult result;
  double cost = 0.0;  ///< Truncated at the threshold of the noise
  Freedom freedom;
};

/// A start with closures that the stated odometry rules out may lose this share of the closures kept without
/// them. Closures that agree with each other but not with the others, as from two floors of one plan, would
/// replace more.
inline constexpr double kMostGivenUp = 0.03;

/// The solutions of one problem from several starts; the one of the lowest truncated cost is kept.
class Starts {
 public:
  Starts(const RobustProblem& given, const PoseProblem& problem, NormalEquations& equations);

  /// Starts from the last result. \returns false if the result is in doubt, or information is far too
  /// pessimistic, so that the other starts are needed
  bool from_last(const WarmStart& warm);
  /// For information that is far too pessimistic: from_confirmed() with the measured noise in place of the
  /// stated one, then the minimum with its closures. \returns whether that solution is beyond doubt; only
  /// then is it kept
  bool from_measured_noise();
  /// Starts from the chordal estimate of the confirmed closures. \returns whether the solution is beyond
  /// doubt: the confirmed closures are many, it keeps almost all of them, and it contradicts every closure
  /// that it excludes. If odometry is worse than stated, the solution takes it as uncertain as its closures
  /// show it to be, unless a start from the first estimate costs less without that
  bool from_confirmed();
  /// Graduates from the first estimate, unless from_confirmed() has.
  void from_first_estimate();
  /// Whether the stated information is far too pessimistic, and the noise has a heavy tail.
  [[nodiscard]] bool has_heavy_tail() const { return least_scale_ > 0.0; }
  /// Starts from the chordal estimate of the closures that odometry does not rule out, unless that was tried.
  /// \returns whether the noise has a heavy tail, and its solution is the best, contradicts every closure
  /// that it excludes, and excludes hardly any that others confirm
  bool from_chordal();
  /// Continues from the best solution with odometry as uncertain as its closures show it to be, and admits
  /// closures that then agree: true closures that the stated odometry contradicts. Closures that the
  /// innovation test rules out return only through grow(). Excluded closures do not contribute to the
  /// estimate of the variance factors, so there are two attempts: one starts with the stated odometry, the
  /// other with doubted odometry, which the closures may confirm again. The attempt that keeps more closures
  /// is kept.
  void rescale_odometry();
  /// Starts from the first estimate again, with the closures that odometry allows if it is as uncertain as in
  /// the best solution. If that solution takes odometry as stated, the largest allowed uncertainty is used.
  void from_doubted_odometry();
  /// Estimates variance factors at the best solution and solves again with them, until they no longer change.
  /// \param keep_unmeasured whether chains without redundant measurements keep their factors
  /// \returns false if the covariances for the estimate do not exist, or the optimisation was stopped
  bool refine(bool keep_unmeasured);

  [[nodiscard]] bool has_solution() const { return best_.has_value(); }
  [[nodiscard]] bool excludes_closures() const { return best_->result.outliers > 0; }
  /// Whether the best solution excludes closures that the stated odometry rules out.
  [[nodiscard]] bool excludes_gross_outliers() const;
  /// Number of confirmed closures that the best solution excludes.
  [[nodiscard]] std::size_t left_out_confirmed() const;
  /// Discards the best solution; its iterations still count.
  void forget();
  /// Writes the odometry scales and weights to the best result.
  void report_odometry();
  /// The best solution, with the iterations of all starts.
  [[nodiscard]] Solution best() &&;

 private:
  class Scaled;
  class ConfirmedStart;
  /// When closures in large groups start a solution: before graduation among all confirmed ones; after it, if
  /// it loses many and the groups cost less; not at all.
  enum class Groups { kFirst, kAfterwards, kNot };
  /// A solution that starts from the confirmed closures.
  struct FromConfirmed {
    Solution solution;
    bool settled = false;             ///< Whether truncated least squares has settled
    std::optional<bool> from_groups;  ///< Whether those in large groups started it, if they were tried
    /// Whether it keeps all confirmed closures without any doubt about odometry
    bool plain = false;
    bool explained = false;  ///< Whether every other excluded closure contradicts it, or raises the cost
    bool beyond_doubt = false;
  };

  /// A solution with odometry as uncertain as its closures show it to be.
  struct Doubted {
    Solution solution;
    double restricted_cost = 0.0;  ///< With OdometryEstimate::log_determinant
  };

  /// One round of settled_odometry(), and that which follows it; none if it was the last one.
  struct Round {
    OdometryVariances used;
    std::vector<char> seeds;  ///< Closures that start it, by edge
    Groups groups = Groups::kAfterwards;
    OdometryVariances next_used;
    Groups next_groups = Groups::kAfterwards;
    bool last = true;
  };

  [[nodiscard]] std::optional<OdometryEstimate> estimated_variances(const Solution& at,
                                                                    bool keep_unmeasured) const;
  bool solve_with(OdometryVariances variances);
  [[nodiscard]] double largest_variance() const {
    return given_.gnc.odometry_margin * given_.gnc.odometry_margin;
  }
  [[nodiscard]] OdometryVariances allowed(OdometryVariances variances) const;
  [[nodiscard]] OdometryVariances all_chains_with(double variance) const;
  [[nodiscard]] GrossOutliers gross_outliers_of(const std::vector<double>& d2, double odometry_margin) const;
  [[nodiscard]] std::optional<FromConfirmed> solve_from_confirmed(const OdometryVariances& variances,
                                                                  const GrossOutliers& gross, bool grow,
                                                                  Groups groups);
  [[nodiscard]] bool is_refuted_by_best(const Doubted& other);
  [[nodiscard]] std::optional<Doubted> with_doubted_odometry(const FromConfirmed& stated,
                                                             const OdometryVariances& shown);
  [[nodiscard]] std::optional<Doubted> settled_odometry(OdometryVariances used, double margin,
                                                        std::vector<Round>& tried);
  [[nodiscard]] std::optional<Doubted> with_doubted_test(FromConfirmed& stated);
  [[nodiscard]] std::size_t in_doubt(const RobustProblem& given, const PoseProblem& problem,
                                     const std::vector<Pose>& poses, const std::vector<char>& among);
  [[nodiscard]] std::vector<char> confirmed_of(const RobustProblem& given, const std::vector<char>& wanted,
                                               double scale) const;
  [[nodiscard]] std::vector<char> in_large_groups_of(const RobustProblem& given,
                                                     const std::vector<char>& confirmed,
                                                     const GrossOutliers& gross) const;
  [[nodiscard]] std::vector<char> seeds_among(const RobustProblem& given, std::vector<char> allowed,
                                              const GrossOutliers& gross) const;
  [[nodiscard]] std::vector<char> confirmed_left_out(const RobustProblem& given,
                                                     const std::vector<double>& weights) const;
  [[nodiscard]] double discount_of_groups(const Solution& solution) const;
  Solution chordal_of(PoseProblem& problem, const std::vector<char>& chosen) const;
  void finish(RobustSolver& solver, GncStart start, Solution& out);
  [[nodiscard]] bool gives_up_closures(const GncResult& one, const GncResult& other,
                                       double share = kMostGivenUp) const;
  [[nodiscard]] double judged_cost(const Solution& solution) const;
  [[nodiscard]] static Solution without_counts(Solution copy);
  [[nodiscard]] Solution refined(Solution solution);
  void keep_better(Solution&& other);
  void count_discarded(const GncResult& discarded);

  const RobustProblem& given_;
  const PoseProblem& problem_;
  NormalEquations& equations_;
  const std::vector<std::uint32_t> chains_;  // of odometry, by node
  const std::vector<double> d2_;             // innovations, by edge
  GrossOutliers gross_;
  double least_scale_ = 0.0;  // of measure_noise()
  std::optional<Solution> best_;
  bool first_estimate_tried_ = false, chordal_tried_ = false;
  GncResult discarded_counts_;  // counts of solutions that are not the best
};

}  // namespace loopwise::detail
