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
  kDoubtedOdometry,  ///< As kFirstEstimate, with closures that odometry of reduced weight allows.
  kChordal,          ///< The chordal estimate of the closures that odometry does not rule out.
  kLastResult,       ///< The last result of the PoseGraphOptimizer.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<GncStart> enum_names(GncStart);

/// Robust optimisation: kernel, threshold and schedule.
struct GncOptions {
  RobustKernel kernel = RobustKernel::kGncTls;
  double inlier_probability = 0.99;
  double mu_step = 1.4;
  int max_outer_iterations = 100;
  int steps_per_iteration = 1;
  double weight_tolerance = 1e-4;
  bool second_start = true;
  double innovation_probability = 0.9999;
  double odometry_margin = 3.0;
  bool growth = true;
  bool warm_start = false;
  double warm_growth = 0.2;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("kernel", self.kernel, any_value(), "Weights: gnc_tls, tls, cauchy or geman_mcclure.");
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 1.0 - 1e-12, true},
          "Share p of true closures that the noise keeps below the threshold: c² = quantile p of chi-squared "
          "with "
          "6 degrees of freedom, on rᵀΩr.");
    field("mu_step", self.mu_step, Bounds{1.0, 100.0, true}, "Factor of mu between outer iterations.");
    field("max_outer_iterations", self.max_outer_iterations, at_least(1), "Bound on outer iterations.");
    field("steps_per_iteration", self.steps_per_iteration, at_least(1),
          "Gauss-Newton steps for each value of mu.");
    field("weight_tolerance", self.weight_tolerance, between(0.0, 0.5),
          "Weights count as settled within this of 0 or 1.");
    field("second_start", self.second_start, any_value(),
          "Several starts, of which the result of the lowest truncated cost is kept. First the closures that "
          "others near them confirm; if they are many, all stay, and every other closure contradicts them, "
          "that is the result. Else also the first estimate, the chordal estimate, and what follows if "
          "odometry is worse than it says, see odometry_margin. Without: the first estimate alone.");
    field("innovation_probability", self.innovation_probability, Bounds{0.0, 1.0, true},
          "Share of true closures that what odometry alone says of their ends does not put aside at first: "
          "quantile "
          "of chi-squared with 6 degrees of freedom, on the innovation. One that the estimate then confirms "
          "comes "
          "back. 1 puts none aside.");
    field("odometry_margin", self.odometry_margin, Bounds{1.0, 1e6, false},
          "How many times larger than stated odometry's deviations may be for second_start. The odometry of "
          "each "
          "robot is weighted down to what the kept closures show of it, as far as this, and closures that it "
          "allows "
          "then are tried. More helps where odometry slips, and lets groups of false closures that agree "
          "with each "
          "other, as from two floors of one plan, bend it. 1: odometry is as it says.");
    field("growth", self.growth, any_value(),
          "At the end of truncated least squares, let closures in that the innovation test has put aside and "
          "that agree with the kept ones around them, as long as that lowers the truncated cost: where "
          "odometry drifts more than its information says that test puts true ones aside.");
    field(
        "warm_start", self.warm_start, any_value(),
        "For a graph that is optimised again and again as it grows: start from the last result, with the new "
        "closures that neither it nor the odometry contradicts. The result of a solution from scratch "
        "replaces it where it did not converge, where a kept closure is lost, where a new one is neither "
        "kept "
        "nor contradicted, and as warm_growth says. For truncated least squares alone. Replays and the live "
        "module do it.");
    field(
        "warm_growth", self.warm_growth, at_least(0.0),
        "For warm_start: a solution from scratch is due when there are this share more closures than at the "
        "last one, or more left-out closures that others confirm. 0: always.");
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
  int outer_iterations = 0;                    ///< Of all starts.
  GncStart start = GncStart::kFirstEstimate;   ///< The start that led to the result.
  bool fresh = true;                           ///< Starts other than the last result were tried.
  std::size_t inliers = 0;   ///< Closures (edges that are not known inliers) of weight > 0.5.
  std::size_t outliers = 0;  ///< The other closures.
  /// ½ Σ w rᵀΩr over priors and known inliers plus Σ min(½ rᵀΩr, ½ c²) over the closures, at the poses.
  double truncated_cost = 0.0;
};

/// Optimisation that detects false loop closures. Odometry, priors and trusted edges are known inliers; every
/// other edge gets a weight in [0, 1] from its residual. The weights of the graph's edges are not used. If
/// the first solution is in doubt, odometry that the closures show to be worse than stated gets a lower
/// weight, chain by chain, see GncOptions::odometry_margin. A closure whose weight has vanished leaves the
/// sparsity structure, and returns when the estimate makes it fit again. The result is that of the start with
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
