// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <array>

#include <Eigen/Geometry>

#include <loopwise/registration/closure_tests.hpp>

#include "side.hpp"

namespace loopwise {

/// Share of the first `count` source points of the order near the target, each counting
/// 1 − (distance / reach)². Normals must agree within 45°.
[[nodiscard]] double near_share(const Side& source, std::size_t count, const Side& target,
                                const Eigen::Isometry3d& T_target_source, float reach);

/// Share of the first `count` source points of the order on the target's surfaces.
[[nodiscard]] double share_on_surface(const Side& source, std::size_t count, const Side& target,
                                      const Eigen::Isometry3d& T_target_source,
                                      const ClosureTestOptions& options);

/// Of the points that fix the translation along each column of `axes` (orthonormal, in the target's frame):
/// the share that would lie on a surface as well if the source were a metre away along it, the larger one of
/// both ways; points that would have no other within 1.5 m do not count. A point weighs the square of (its
/// normal · axis)(the target's normal · axis), and half a percent of the points is taken to fit anywhere, so
/// that an axis that no surface faces has 1. A smooth function of the points.
[[nodiscard]] Eigen::Vector3d undecided_share(const Side& source, std::size_t count, const Side& target,
                                              const Eigen::Isometry3d& T_target_source,
                                              const Eigen::Matrix3d& axes, const ClosureTestOptions& options);

/// A direction of translation, in the target's frame, and the least deviation along it.
struct UndecidedAxis {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();
  double sigma_m = 0.0;
};

/// A Hessian counts every point whose normal looks along a corridor, noise and repeated ribs as well. So the
/// source is moved by a metre along each of the Hessian's three axes of translation. With the odds
/// o = u/(1 − u) of an undecided share u and those of `free_share`, o₀, σ along the axis is at least
/// max_sigma_m · o⁴/(o⁴ + o₀⁴).
[[nodiscard]] std::array<UndecidedAxis, 3> undecided_axes(const Side& source, std::size_t count,
                                                          const Side& target,
                                                          const Eigen::Isometry3d& T_target_source,
                                                          const AlignmentFigures& figures, double free_share,
                                                          const ClosureTestOptions& options);

}  // namespace loopwise
