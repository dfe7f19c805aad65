// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <array>

#include <Eigen/Geometry>

#include <loopwise/registration/closure_tests.hpp>

#include "followed_points.hpp"
#include "side.hpp"

namespace loopwise {

/// Share of source points near the target, among the first `count` points of `source.order`. Each counts 1 −
/// (distance / reach)². Normals must agree within 45°.
[[nodiscard]] double near_share(const Side& source, std::size_t count, const Side& target,
                                const Eigen::Isometry3d& T_target_source, float reach);

/// Share of source points on the target's surfaces, among the first `count` points of `source.order`.
/// \param followed the points of `source.order` at any earlier pose; a near one spares searches
[[nodiscard]] double share_on_surface(const Side& source, std::size_t count, const Side& target,
                                      const Eigen::Isometry3d& T_target_source,
                                      const ClosureTestOptions& options, FollowedPoints& followed);

/// Share of points in the free space of the other scan, both ways added, by `count` points of each side. The
/// shares by which the scans contradict themselves are subtracted: so much is expected of right poses too.
/// The result may be negative.
[[nodiscard]] double contradiction(const Side& source, const Side& target,
                                   const Eigen::Isometry3d& T_target_source, std::size_t count);

/// For each column of `axes` (orthonormal, in the target's frame), the share of points that fit as well after
/// a move of one metre along the axis. Only points that constrain the translation along the axis count: the
/// weight of a point is the square of (its normal · axis)(the target's normal · axis). The result is the
/// larger share of both directions. A point without target points within 1.5 m after the move does not count.
/// Half a percent of the points counts as fitting anywhere, so that the share is 1 for an axis that no
/// surface faces. A smooth function of the points.
[[nodiscard]] Eigen::Vector3d undecided_share(const Side& source, std::size_t count, const Side& target,
                                              const Eigen::Isometry3d& T_target_source,
                                              const Eigen::Matrix3d& axes, const ClosureTestOptions& options);

/// A direction of translation, in the target's frame, and the least standard deviation along it.
struct UndecidedAxis {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();
  double sigma_m = 0.0;
};

/// Lower bounds of σ along the Hessian's three axes of translation. In a corridor the Hessian is too certain,
/// because it counts every point whose normal has a component along the corridor, including noise and
/// repeated ribs. So the bounds come from undecided_share(). With the odds o = u/(1 − u) of an undecided
/// share u, and the odds o₀ of `free_share`, σ along the axis is at least max_sigma_m · o⁴/(o⁴ + o₀⁴).
[[nodiscard]] std::array<UndecidedAxis, 3> undecided_axes(const Side& source, std::size_t count,
                                                          const Side& target,
                                                          const Eigen::Isometry3d& T_target_source,
                                                          const AlignmentFigures& figures, double free_share,
                                                          const ClosureTestOptions& options);

}  // namespace loopwise
