// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/linalg/factorization.hpp>

namespace loopwise {

/// Source of the first estimate.
enum class Initialization {
  kAuto,      ///< The estimate of lowest cost of the three below; the next one if it does not converge. The
              ///< graph's poses without comparison if they cost little more than noise.
  kFile,      ///< The poses of the graph.
  kOdometry,  ///< Chained along odometry edges from the prior or the first node of each stretch, then across
              ///< the other edges, breadth first.
  kChordal,   ///< Rotations from the chordal relaxation, then translations: one linear solve each. For poor
              ///< initial poses.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<Initialization> enum_names(Initialization);

/// Why an optimisation ended.
enum class Termination {
  kConverged,      ///< The predicted decrease of the next step is below the tolerances.
  kNothingToDo,    ///< No factor acts on any free pose.
  kMaxIterations,  ///< The bound on iterations was reached; the poses are the best found.
  kNoProgress,     ///< No step of any length lowers the cost; the poses are the best found.
  kStopped,        ///< A stop was requested; the poses are the best found.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<Termination> enum_names(Termination);

/// Optimisation: when to stop, where to start, and how to factorise.
struct OptimizerOptions {
  /// Maximum number of steps.
  int max_iterations = 1000;
  /// Converged if the predicted decrease of the cost is below this fraction of the cost and
  /// gradient_tolerance is met too.
  double cost_tolerance = 1e-11;
  /// Converged if the largest element of the gradient is below this fraction of its initial value and
  /// cost_tolerance is met too.
  double gradient_tolerance = 5e-7;
  /// Converged in any case if the largest element of an undamped step (m, rad) is below this.
  double step_tolerance = 1e-9;
  /// Levenberg-Marquardt damping of the first step, relative to the diagonal of the Hessian. 0: Gauss-Newton
  /// steps, with damping only after a step that fails.
  double initial_damping = 0.0;
  /// First estimate: auto, file, odometry or chordal. auto takes the one with the lowest cost.
  Initialization initialization = Initialization::kAuto;
  /// Sparse Cholesky factorisation: automatic, multifrontal, simplicial or supernodal.
  Factorization factorization = Factorization::kAutomatic;
  /// Number of threads. 0: one per processor. It changes the run time, never a result.
  int threads = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_iterations", self.max_iterations, at_least(0));
    field("cost_tolerance", self.cost_tolerance, at_least(0.0));
    field("gradient_tolerance", self.gradient_tolerance, at_least(0.0));
    field("step_tolerance", self.step_tolerance, at_least(0.0));
    field("initial_damping", self.initial_damping, at_least(0.0));
    field("initialization", self.initialization, any_value());
    field("factorization", self.factorization, any_value());
    field("threads", self.threads, between(0, 1024));
  }
};

/// One step of an optimisation, taken or not.
struct IterationRecord {
  int iteration = 0;       ///< From 1.
  double cost = 0.0;       ///< After the step, also if it was refused.
  double decrease = 0.0;   ///< Cost before minus after.
  double predicted = 0.0;  ///< Decrease predicted by the linear model.
  double gradient = 0.0;   ///< Largest element of the gradient before the step.
  double step = 0.0;       ///< Largest element of the step, m or rad.
  double damping = 0.0;    ///< Of the step, relative to the Hessian's diagonal; 0: Gauss-Newton.
  bool accepted = false;   ///< Whether the step was taken.
};

/// The result of an optimisation.
struct OptimizationResult {
  std::vector<Eigen::Isometry3d> poses;  ///< One per node, in graph order.
  double cost_initial = 0.0;             ///< ½ Σ w rᵀΩr over edges and priors at the first estimate.
  double cost = 0.0;                     ///< The same at `poses`.
  double gradient_initial = 0.0;  ///< Largest element of the gradient (free poses) at the first estimate.
  double gradient = 0.0;          ///< The same at `poses`.
  int iterations = 0;             ///< Steps tried.
  int factorizations = 0;         ///< Numeric factorisations, refused steps and initialisation included.
  bool converged = false;         ///< Ended by the tolerances, or no step was needed.
  Termination termination = Termination::kNothingToDo;  ///< Why it ended.
  /// The first estimate that was used; never kAuto.
  Initialization initialization = Initialization::kFile;
  std::string message;         ///< For people; never parse it.
  std::size_t components = 0;  ///< Connected components of the graph, lone nodes included.
  /// Nodes with a fixed pose because their component has no prior. Nodes without any factor keep their pose
  /// as well and are not listed.
  std::vector<Key> held;
  /// True if the factors leave a direction undetermined (semi-definite information): along it the poses stay
  /// near the first estimate, and marginal covariances do not exist.
  bool underdetermined = false;
  std::vector<IterationRecord> trace;  ///< Every step that was tried.
  double seconds = 0.0;                ///< Wall time. For reports only.
};

/// Minimises ½ Σ w rᵀΩr over the poses: edges r = Log(Z⁻¹ T_i⁻¹ T_j), priors r = Log(Z⁻¹ T_i), full SE(3)
/// logarithm, exact Jacobians, the weights of the edges as given (an edge of weight 0 does not take part).
/// Gauss-Newton, damped by Levenberg-Marquardt when a step does not lower the cost; the cost never rises. The
/// components of a disconnected graph are solved together without influence on each other's minimum.
/// \throws OptionError on options out of range; InputError if the cost of the first estimate is not finite.
[[nodiscard]] LOOPWISE_EXPORT OptimizationResult optimize(const PoseGraph& graph,
                                                          const OptimizerOptions& options = {},
                                                          const StopToken& stop = {});

/// ½ Σ w rᵀΩr over edges and priors at the graph's poses.
[[nodiscard]] LOOPWISE_EXPORT double graph_cost(const PoseGraph& graph);

/// Residual r = Log(Z⁻¹ T_from⁻¹ T_to) of an edge, [translation, rotation].
[[nodiscard]] LOOPWISE_EXPORT Vector6d edge_residual(const Edge& edge, const Eigen::Isometry3d& T_w_from,
                                                     const Eigen::Isometry3d& T_w_to);

/// The first estimate for a value of OptimizerOptions::initialization; kFile returns the graph's poses.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Isometry3d> initial_poses(const PoseGraph& graph,
                                                                           Initialization initialization);

struct GncOptions;
struct GncResult;

/// An optimiser that keeps the symbolic analysis between calls, for a graph that grows or whose estimate or
/// weights change. A new ordering is computed when it saves time; results equal those of the free functions
/// up to rounding. Not thread-safe.
class LOOPWISE_EXPORT PoseGraphOptimizer {
 public:
  /// \throws OptionError
  explicit PoseGraphOptimizer(OptimizerOptions options = {});
  ~PoseGraphOptimizer();
  PoseGraphOptimizer(PoseGraphOptimizer&&) noexcept;
  PoseGraphOptimizer& operator=(PoseGraphOptimizer&&) noexcept;

  /// As the free function optimize().
  [[nodiscard]] OptimizationResult optimize(const PoseGraph& graph, const StopToken& stop = {});
  /// As the free function optimize_gnc(). With GncOptions::warm_start a graph that has only grown since the
  /// last call (its first nodes and edges are unchanged) starts from that result. \throws OptionError
  [[nodiscard]] GncResult optimize_gnc(const PoseGraph& graph, const GncOptions& options,
                                       const StopToken& stop = {});

  /// Symbolic analyses made so far.
  [[nodiscard]] std::size_t analyses() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
