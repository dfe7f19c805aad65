// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// How well a scan constrains the motion of a sensor that is aligned to it.
struct Observability {
  /// λ_min of A = Σ HᵀH, H = [(p × n)ᵀ nᵀ], over rotation and translation (paper §III-C). Grows with the
  /// scan.
  double min_eigenvalue = 0.0;
  /// λ_min of Σ n nᵀ / N, over translation alone, in [0, 1/3], as in LAMP.
  double min_eigenvalue_lamp = 0.0;
};

/// A of the paper, order [rotation, translation], about the sensor's origin, metres. Points without a normal
/// (zero) are ignored. One pass, in order, in double.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d observability_matrix(const PointCloud& cloud);

/// Both figures; 0 for a cloud without normals. O(n): a downsampled scan takes well under a millisecond.
[[nodiscard]] LOOPWISE_EXPORT Observability observability(const PointCloud& cloud);

}  // namespace loopwise
