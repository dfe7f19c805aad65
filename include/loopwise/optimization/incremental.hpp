// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <memory>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// How closely an incremental estimate follows the minimum.
struct IncrementalOptions {
  /// Steps of a node are postponed until they add up to this share of the standard deviation that the node's
  /// own factors allow (1/√Hjj).
  double tolerance = 0.05;
  /// An update ends after a step whose decrease of the cost matches the linear prediction within this share.
  /// The next update continues from there. 0: an update ends only if all steps are below the tolerance.
  double remainder = 0.05;
  /// A factor is linearised again when the relative pose of its two ends has turned by this much (rad) since
  /// the last linearisation, or moved by this share of its length (at least 1 m).
  double relinearization = 0.005;
  /// Maximum number of steps of one update. The next update continues.
  int max_iterations = 30;

  /// Calls visitor(name, field, bounds, description) for every option.
  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("tolerance", self.tolerance, Bounds{0.0, 1.0, true});
    field("remainder", self.remainder, between(0.0, 1.0));
    field("relinearization", self.relinearization, between(0.0, 1.0));
    field("max_iterations", self.max_iterations, at_least(1));
  }
};

/// The result of one update.
struct IncrementalResult {
  double cost = 0.0;          ///< ½ Σ w rᵀΩr over all factors, at the poses.
  int iterations = 0;         ///< Steps taken.
  bool converged = false;     ///< The last step was below the tolerance, or no step was needed.
  bool reordered = false;     ///< A new order of elimination was computed, and the whole matrix factorised.
  bool from_scratch = false;  ///< The whole graph was optimised as by optimize().
  std::size_t moved = 0;      ///< Poses with a computed step, with repetitions.
  std::size_t relinearized = 0;  ///< Factors linearised again, with repetitions.
  double seconds = 0.0;          ///< Wall time. For reports only.
};

/// Keeps the minimum of a growing pose graph up to date. The cost depends on the part of the graph that new
/// measurements move, and little on its size. It has the cost function and the minimum of optimize(), up to
/// IncrementalOptions::tolerance: the gradient is always exact, and the factorised Hessian, which only
/// affects convergence, is updated in the parts where the estimate has changed.
///
/// The method follows Kaess et al. (iSAM2, IJRR 2012): the part of the elimination tree above changed columns
/// is factorised again, and steps are followed down the tree as far as they are relevant. It uses the weights
/// of the edges; set_weight() takes weights of optimize_gnc(). A graph with an undetermined pose
/// (semi-definite information) is solved from scratch at every update. Memory: several times that of the
/// factor. Not thread-safe.
class LOOPWISE_EXPORT IncrementalOptimizer {
 public:
  /// Optimises a graph like optimize(), and continues from there; `optimization` applies to this and other
  /// solutions from scratch. \throws OptionError; InputError like optimize()
  explicit IncrementalOptimizer(PoseGraph graph = {}, const OptimizerOptions& optimization = {},
                                const IncrementalOptions& options = {});
  ~IncrementalOptimizer();
  IncrementalOptimizer(IncrementalOptimizer&&) noexcept;
  IncrementalOptimizer& operator=(IncrementalOptimizer&&) noexcept;

  /// Adds a node. The next update starts from its pose: usually the present pose of the previous node times
  /// the odometry between both. \returns its number. \throws as PoseGraph::add_node()
  std::size_t add_node(const Node& node);
  /// \returns the edge's number. \throws as PoseGraph::add_edge()
  std::size_t add_edge(const Edge& edge);
  /// \throws as PoseGraph::add_prior()
  std::size_t add_prior(const PriorFactor& prior);
  /// \throws as PoseGraph::add_range()
  std::size_t add_range(const RangeFactor& range);
  /// \throws as PoseGraph::add_gravity()
  std::size_t add_gravity(const GravityFactor& gravity);
  /// \throws InputError unless there is such an edge and the weight lies in [0, 1]
  void set_weight(std::size_t edge, double weight);

  /// Moves the poses to the minimum. A stopped update ends at the poses of its last step.
  /// \throws InputError if the cost of the poses is not finite
  IncrementalResult update(const StopToken& stop = {});

  /// All nodes and factors, with the poses of the last update.
  [[nodiscard]] const PoseGraph& graph() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
