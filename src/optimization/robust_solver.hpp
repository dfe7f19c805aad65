// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <unordered_map>
#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "innovation.hpp"
#include "minimize.hpp"
#include "odometry_forest.hpp"
#include "pose_problem.hpp"

namespace loopwise::detail {

/// What the known inliers alone rule out.
struct GrossOutliers {
  std::vector<char> aside;  ///< By edge
  double scale = 1.0;       ///< Of the noise against what information says, squared; at most 1
};

/// Finds the closures to put aside before anything is factorised, by the innovations d² (innovation.hpp).
/// \param odometry_margin how many times its stated deviations odometry's may be
[[nodiscard]] GrossOutliers find_gross_outliers(const PoseGraph& graph, const std::vector<double>& d2,
                                                double probability, double odometry_margin = 1.0);

/// Everything that starts of one robust problem share.
struct RobustProblem {
  const PoseGraph& graph;
  const OdometryForest& forest;
  const std::vector<Pose>& start;  ///< Where what nothing holds stays
  const OptimizerOptions& options;
  const GncOptions& gnc;
  ThreadPool& pool;
  const StopToken& stop;
};

/// Robust optimisation from one start. Leaves the result in `poses`, the weights in `problem` and the
/// components in `equations`.
class RobustSolver {
 public:
  /// \throws InputError if the cost of the poses is not finite
  RobustSolver(const RobustProblem& given, const GrossOutliers& gross, PoseProblem& problem,
               NormalEquations& equations, std::vector<Pose>& poses);

  /// By the kernel of the options, from the poses as they are.
  void solve(GncResult& result);
  /// By truncated least squares from the minimum of a choice of closures (by edge), which stay if they fit
  /// there. Growth tries only closures of `may_grow` (by edge); empty: all.
  void solve_from(const std::vector<char>& chosen, const std::vector<char>& may_grow, GncResult& result);

  /// Of a problem that has grown: the closures kept before, and the new ones that neither odometry
  /// nor the poses and what they rest on contradict. All by edge.
  [[nodiscard]] std::vector<char> plausible(const std::vector<char>& known,
                                            const std::vector<char>& kept) const;
  /// Closures (edges) of some that the result leaves out although what it rests on does not contradict them.
  [[nodiscard]] std::vector<std::size_t> unexplained(const std::vector<char>& among);

 private:
  void evaluate();
  [[nodiscard]] bool set_aside(std::size_t i) const;
  template <class Weight>
  double set_weights(Weight&& weight);
  void descend(StepControl& control);
  void descend_fully();
  [[nodiscard]] bool stopped();
  void graduate();
  void truncate(bool at_minimum = false);
  void grow(const std::vector<char>& may_grow);
  bool let_in(const std::vector<std::size_t>& closures);
  [[nodiscard]] std::vector<std::size_t> agreeing_with_kept(const std::vector<char>& tried);
  void reweight();
  void bring_back();
  void report(GncResult& result);
  [[nodiscard]] double truncated_cost() const;

  [[nodiscard]] OdometryForest forest_of(std::vector<char> closures) const;
  [[nodiscard]] bool factorize_here();
  void test_by_all(const std::vector<std::size_t>& edges);
  [[nodiscard]] bool contradicted_by_all(std::size_t edge) const;
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
  const double c2_;
  std::vector<std::size_t> closures_;             // factors in doubt
  std::vector<double> r2_;                        // by closure
  std::unordered_map<std::size_t, bool> by_all_;  // edges that test_by_all() has looked at, at these poses
  OptimizationResult total_;
  int outer_ = 0;
  bool stopped_ = false;
  /// Growth tries no closure that the covariance of the kept ones contradicts: others cost more than they
  /// bring. Where odometry is worse than it says they may still be right, which the other starts find out.
  bool trusts_information_ = false;
};

}  // namespace loopwise::detail
