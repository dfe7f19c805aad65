// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Generalized ICP, alone: refines a guess, and makes no test of the result.
///
///     const loopwise::KdTree tree(target);
///     const auto result = loopwise::gicp({target, target_normals}, tree, {source, source_normals}, guess);
#pragma once

#include <cstddef>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/point_cloud.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Options of gicp(). The defaults suit scans with voxels of 0.25 to 0.5 m and guesses within 1 m and 10
/// degrees.
struct GicpOptions {
  /// Maximum distance of matched points in the first pass, m. Larger than the error of the guess.
  double coarse_reach_m = 2.0;
  /// Maximum distance of matched points in the last pass, m. About the distance of neighbouring points.
  double fine_reach_m = 0.5;
  /// Number of source points in the first three passes. They are drawn evenly from all directions of
  /// surfaces.
  int coarse_points = 300;
  /// Number of source points in the last pass.
  int fine_points = 2000;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("coarse_reach_m", self.coarse_reach_m, above(0.0));
    field("fine_reach_m", self.fine_reach_m, above(0.0));
    field("coarse_points", self.coarse_points, at_least(10.0));
    field("fine_points", self.fine_points, at_least(10.0));
  }
};

/// The result of gicp().
struct GicpResult {
  /// Maps points of the source to the frame of the target: p_target = T_target_source · p_source. The guess,
  /// if it brings fewer than six points to a counterpart.
  Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
  bool converged = false;  ///< The last step was within five times the bounds at which the pass ends.
  int iterations = 0;      ///< Over all passes.
  /// Number of source points with a counterpart in the last iteration, of points_used.
  std::size_t matches = 0;
  std::size_t points_used = 0;  ///< Number of source points that took part in the last iteration.
};

/// Refines a guess by generalized ICP (Segal, Haehnel, Thrun, RSS 2009): Gauss-Newton with analytic Jacobians
/// on
///
///     Σ ρ(dᵀ(C_target + R·C_source·Rᵀ)⁻¹d),      C = I − 0.999·n·nᵀ,
///
/// over source points and their nearest target points, with the normals n and a Geman-McClure kernel ρ of a
/// third of the reach. Pairs whose normals face opposite sides are left out: the two faces of a wall are two
/// surfaces. From coarse to fine: the reach shrinks with few points, then the last pass refines with more
/// points. Source points need a known normal; a target point with an unknown one counts in all directions.
/// Serial; deterministic.
/// \param target the fixed cloud with normals, read in place
/// \param target_tree of the points of the target
/// \param source the cloud that moves, with normals, read in place
/// \param guess_target_source initial T_target_source, within coarse_reach_m of the result
/// \param options reach and number of points
/// \throws OptionError; InputError if the tree is that of another cloud, the guess is not a rigid transform,
/// a normal is not of unit length, or the source has world coordinates in double precision
[[nodiscard]] LOOPWISE_EXPORT GicpResult
gicp(const PointNormalView& target, const KdTree& target_tree, const PointNormalView& source,
     const Eigen::Isometry3d& guess_target_source = Eigen::Isometry3d::Identity(),
     const GicpOptions& options = {});

}  // namespace loopwise
