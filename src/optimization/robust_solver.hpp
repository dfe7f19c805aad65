// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <limits>
#include <unordered_map>
#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "innovation.hpp"
#include "linalg/panels.hpp"
#include "minimize.hpp"
#include "odometry_forest.hpp"
#include "pose_problem.hpp"

namespace loopwise::detail {

/// The closures that the known inliers alone rule out.
struct GrossOutliers {
  std::vector<char> excluded;  ///< By edge
  double scale = 1.0;          ///< Variance of the noise relative to the stated one; at most 1
  /// As scale, but also supported by closures that are near each other: factor on the threshold of truncated
  /// least squares
  double noise = 1.0;
  /// Variance of the noise relative to the stated one, without a margin: the larger of both measures. 1 if
  /// unknown
  double measured = 1.0;
};

/// Finds the closures to exclude before any factorisation, from the innovations d² (innovation.hpp).
/// \param odometry_margin assumed ratio of true to stated standard deviation of odometry
/// \param least_scale lower bound of the scale
[[nodiscard]] GrossOutliers find_gross_outliers(const PoseGraph& graph, const std::vector<double>& d2,
                                                double probability, double odometry_margin = 1.0,
                                                double least_scale = 0.0);

/// Sets GrossOutliers::noise and measured for a scale below 1. The noise must also be that of closures that
/// are near each other, as the threshold of truncated least squares is final. Both stay 1 if too few are.
/// \param c2 stated threshold \returns the least scale of all tests: if the innovations of closures near each
/// other have a heavy tail, where that ends (end_of_tail()), which is `noise` then; otherwise 0
[[nodiscard]] double measure_noise(const PoseGraph& graph, const OdometryForest& forest, double c2,
                                   GrossOutliers& gross);

/// Input that all starts of one robust problem share.
struct RobustProblem {
  const PoseGraph& graph;
  const OdometryForest& forest;
  const std::vector<Pose>& start;  ///< First estimate; it also fixes components without a prior
  const OptimizerOptions& options;
  const GncOptions& gnc;
  ThreadPool& pool;
  const StopToken& stop;
};

/// Robust optimisation from one start. Writes the result to `poses`, the weights to `problem` and the
/// components to `equations`.
class RobustSolver {
 public:
  static constexpr int kAnySteps = std::numeric_limits<int>::max();
  /// Bound on rounds of truncated least squares. Each round lowers the truncated cost, so two or three are
  /// enough.
  static constexpr int kTruncatedRounds = 20;

  /// \throws InputError if the cost of the poses is not finite
  RobustSolver(const RobustProblem& given, const GrossOutliers& gross, PoseProblem& problem,
               NormalEquations& equations, std::vector<Pose>& poses);

  /// Solves with the kernel of the options from the present poses, growth included.
  void solve();
  /// Moves to the minimum with the chosen closures (by edge), in a bounded number of steps.
  /// \returns the number of those that do not fit there; all if the bound was reached
  std::size_t minimize_with(const std::vector<char>& chosen, int max_steps = kAnySteps);
  /// Alternates between weights (1 within the threshold, 0 beyond it) and the minimum for them, until the
  /// weights no longer change. \param at_minimum whether the poses are the minimum for the present weights
  /// \returns false if they changed until the bound on rounds
  bool truncate(bool at_minimum = false, int max_rounds = kTruncatedRounds);
  /// Graduates from the present poses with the chosen closures only (by edge).
  void graduate_with(const std::vector<char>& chosen);
  /// Re-admits excluded closures that agree with the kept ones around them. Tries only closures in `may_grow`
  /// (by edge); empty: all.
  void grow(const std::vector<char>& may_grow);
  /// Moves to the minimum of truncated least squares nearby, up to the tolerances of the options. To be
  /// called last: the functions that truncate or admit stop as soon as they can decide about closures.
  void settle();
  /// Writes the present state to the result, whose factorizations count the ones before.
  void report(GncResult& result);
  /// Takes over the weights of a solution, at the present poses.
  void keep(const std::vector<char>& kept);
  /// Admits excluded closures among some (by edge) that do not contradict the solution, as long as this
  /// lowers the truncated cost. \returns whether every other excluded closure among them contradicts the
  /// solution, or raises the cost
  bool admit_unexplained(const std::vector<char>& among);
  /// With the threshold that follows the noise.
  [[nodiscard]] double truncated_cost() const;

  /// For a problem that has grown: the formerly kept closures, and those new closures that contradict neither
  /// the odometry nor the poses and the closures they rest on. All by edge.
  [[nodiscard]] std::vector<char> plausible(const std::vector<char>& known,
                                            const std::vector<char>& kept) const;
  /// Those closures (edges) among some that the result excludes although they do not contradict it.
  [[nodiscard]] std::vector<std::size_t> unexplained(const std::vector<char>& among);

 private:
  void evaluate();
  [[nodiscard]] bool is_gross_outlier(std::size_t i) const;
  template <class Weight>
  double set_weights(Weight&& weight);
  double set_truncated_weights();
  void descend(StepControl& control);
  void approach_minimum();
  [[nodiscard]] bool stopped();
  void graduate(int steps_at_once);
  bool admit_some(std::vector<std::size_t>& closures, int& attempts);
  bool try_to_admit(const std::vector<std::size_t>& closures);
  [[nodiscard]] std::vector<std::size_t> agreeing_with_kept(const std::vector<char>& tried);
  void reweight();
  void realign_held_components();

  [[nodiscard]] OdometryForest forest_of(std::vector<char> closures) const;
  [[nodiscard]] std::size_t most_exact() const;
  [[nodiscard]] bool factorize_here();
  void test_by_covariance(const std::vector<std::size_t>& edges);
  [[nodiscard]] bool contradicts_covariance(std::size_t edge) const;
  [[nodiscard]] OdometryForest forest_of_kept() const;
  [[nodiscard]] bool contradicted(std::size_t edge, const OdometryForest& rests_on) const;

  const PoseGraph& graph_;
  PoseProblem& problem_;
  NormalEquations& equations_;
  std::vector<Pose>& poses_;
  const std::vector<Pose>& start_;
  const OptimizerOptions& options_;
  const GncOptions& gnc_;
  ThreadPool& pool_;
  const StopToken& stop_;
  const GrossOutliers& gross_;
  NeighbourInnovations neighbours_;
  const double stated_c2_;             // threshold of the stated information
  const double c2_;                    // threshold of the noise: truncates residuals
  const double limit_;                 // threshold of innovations
  std::vector<std::size_t> closures_;  // edges that are not known inliers
  std::vector<double> r2_;             // by closure
  // Innovations d² of test_by_covariance() by edge, at the present poses.
  std::unordered_map<std::size_t, double> covariance_d2_;
  OptimizationResult total_;
  const std::vector<char>* chosen_ = nullptr;  // by edge: others have weight 0; null: none are
  int outer_ = 0;
  bool stopped_ = false;
  bool settled_ = false;  // the poses are the minimum for the weights, up to the tolerances
  /// Growth does not try closures that contradict the covariance of the kept ones: they raise the truncated
  /// cost. They may still be true if odometry is worse than stated; the other starts test this.
  bool trusts_information_ = false;
};

}  // namespace loopwise::detail
