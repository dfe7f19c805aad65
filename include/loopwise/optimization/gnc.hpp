// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// Weight of a closure as a function of its residual.
enum class RobustKernel {
  kGncTls,  ///< Truncated least squares reached through graduated non-convexity (Yang et al., RA-L 2020).
  kTls,     ///< Truncated least squares from the first estimate at once, without graduation.
  kCauchy,  ///< w = 1 / (1 + r²/c²)
  kGemanMcClure,  ///< w = 1 / (1 + r²/c²)²
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<RobustKernel> enum_names(RobustKernel);

/// Where a robust solution started.
enum class GncStart {
  kFirstEstimate,    ///< The estimate of OptimizerOptions::initialization, graduated.
  kConfirmed,        ///< The chordal estimate of the closures that others near them confirm.
  kDoubtedOdometry,  ///< As kFirstEstimate, plus closures that odometry of reduced weight allows.
  kChordal,          ///< The chordal estimate of the closures that odometry does not rule out.
  kLastResult,       ///< The last result of the PoseGraphOptimizer.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<GncStart> enum_names(GncStart);

/// Robust optimisation: kernel, threshold and schedule.
struct GncOptions {
  /// Weights: gnc_tls, tls, cauchy or geman_mcclure.
  RobustKernel kernel = RobustKernel::kGncTls;
  /// Share p of true closures whose noise stays below the threshold c². The threshold is the quantile p of
  /// chi-squared with 6 degrees of freedom, and it applies to rᵀΩr. It is lower if the closures show their
  /// stated deviations to be more than twenty times too large.
  double inlier_probability = 0.99;
  /// Factor of mu between outer iterations.
  double mu_step = 1.4;
  /// Maximum number of outer iterations.
  int max_outer_iterations = 100;
  /// Gauss-Newton steps for each value of mu.
  int steps_per_iteration = 1;
  /// Weights count as settled within this distance of 0 or 1.
  double weight_tolerance = 1e-4;
  /// Try several starts and keep the result with the lowest truncated cost. The first start keeps the
  /// closures that other closures near them confirm. If these are many, and the solution contradicts every
  /// closure that it excludes, its result is final. Otherwise the other starts are the first estimate, the
  /// chordal estimate, and odometry of reduced weight (see odometry_margin). Off: the first estimate only.
  bool second_start = true;
  /// Probability p of the innovation test: closures above the quantile p of chi-squared with 6 degrees of
  /// freedom are excluded at first, and return if the estimate confirms them. 1: no test.
  double innovation_probability = 0.9999;
  /// For second_start: largest ratio of the true to the stated standard deviation of odometry. The odometry
  /// of each robot loses weight as far as the kept closures show that it is worse than stated. Closures that
  /// this odometry allows are then tried. Larger values help where odometry slips. But they let groups of
  /// consistent false closures, such as from two floors with the same plan, bend the odometry. 1: odometry is
  /// as good as stated.
  double odometry_margin = 3.0;
  /// At the end of truncated least squares, re-admit closures that the innovation test excluded and that
  /// agree with the kept closures around them, as long as this lowers the truncated cost. Helps where
  /// odometry drifts more than stated.
  bool growth = true;
  /// For a graph that is optimised repeatedly as it grows: start from the last result, with the new closures
  /// that contradict neither this result nor the odometry. The graph is solved from scratch if the warm start
  /// does not converge, if it loses more kept closures than chance explains (one in a hundred, by
  /// inlier_probability), if it excludes closures that it neither contradicts nor shows to raise the cost,
  /// and as warm_growth says. Truncated least squares only. Replays and the live module use it.
  bool warm_start = false;
  /// For warm_start: solve from scratch when the number of closures has grown by this share since the last
  /// solution from scratch, or the number of excluded closures that others confirm; for the latter, one in a
  /// hundred of the kept ones (1 - inlier_probability) does not count. 0: always.
  double warm_growth = 0.2;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("kernel", self.kernel, any_value());
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 0.999999, true});
    field("mu_step", self.mu_step, Bounds{1.0, 100.0, true});
    field("max_outer_iterations", self.max_outer_iterations, at_least(1));
    field("steps_per_iteration", self.steps_per_iteration, at_least(1));
    field("weight_tolerance", self.weight_tolerance, between(0.0, 0.5));
    field("second_start", self.second_start, any_value());
    field("innovation_probability", self.innovation_probability, Bounds{0.0, 1.0, true});
    field("odometry_margin", self.odometry_margin, Bounds{1.0, 1e6, false});
    field("growth", self.growth, any_value());
    field("warm_start", self.warm_start, any_value());
    field("warm_growth", self.warm_growth, at_least(0.0));
  }
};

/// Ratio of true to stated deviations of the odometry of one chain (usually: robot). Edges of kind odometry
/// join the nodes of a chain.
struct OdometryScale {
  Key first = 0;       ///< The first of its nodes, in the order of the graph.
  double scale = 1.0;  ///< Ratio of true to stated deviations.
};

/// The result of robust optimisation.
struct GncResult {
  /// Poses, cost with the final weights; cost_initial is the plain cost, all weights 1, at the first
  /// estimate.
  OptimizationResult optimization;
  /// One per edge, in graph order. Odometry has 1/scale² by odometry_scales, other trusted edges 1.
  std::vector<double> weights;
  std::vector<OdometryScale> odometry_scales;  ///< For chains with worse odometry than stated.
  /// Standard deviation of the noise relative to the stated one, where the stated one is far too large and
  /// closures were selected by the measured noise. Otherwise 1.
  double noise_scale = 1.0;
  int outer_iterations = 0;                   ///< Of all starts.
  GncStart start = GncStart::kFirstEstimate;  ///< The start that led to the result.
  bool fresh = true;                          ///< Starts other than the last result were tried.
  std::size_t inliers = 0;   ///< Closures (edges that are not known inliers) of weight > 0.5.
  std::size_t outliers = 0;  ///< The other closures.
  /// ½ Σ w rᵀΩr over priors and known inliers plus Σ min(½ rᵀΩr, ½ c²) over the closures, at the poses.
  double truncated_cost = 0.0;
};

/// Optimisation that detects false loop closures. Odometry, priors and trusted edges are known inliers; every
/// other edge gets a weight in [0, 1] from its residual. The weights of the graph's edges are not used. If
/// the first solution is in doubt, odometry that the closures show to be worse than stated gets a lower
/// weight, chain by chain, see GncOptions::odometry_margin. A closure of weight 0 leaves the sparsity
/// structure, and returns if the estimate agrees with it again. The result is that of the start with
/// the lowest truncated cost (GncOptions::second_start). If all closures are false, the result is that of
/// odometry, and each separate component keeps the pose of its first node. \throws OptionError, InputError as
/// optimize() does.
[[nodiscard]] LOOPWISE_EXPORT GncResult optimize_gnc(const PoseGraph& graph,
                                                     const OptimizerOptions& options = {},
                                                     const GncOptions& gnc = {}, const StopToken& stop = {});

/// True for edges that robust optimisation always keeps: odometry and trusted ones.
[[nodiscard]] inline bool known_inlier(const Edge& edge) {
  return edge.kind == EdgeKind::kOdometry || edge.trusted;
}

/// Quantile of the chi-squared distribution: P(χ² ≤ result) = probability. \throws OptionError outside (0,
/// 1).
[[nodiscard]] LOOPWISE_EXPORT double chi_squared_quantile(double probability, int degrees_of_freedom);

}  // namespace loopwise
