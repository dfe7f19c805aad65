// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

inline constexpr int kFpfhSize = 33;
using Descriptors = Eigen::Matrix<float, kFpfhSize, Eigen::Dynamic>;

/// Fast point feature histograms (Rusu, Blodow, Beetz, ICRA 2009) of the points `keys` of a cloud with
/// normals, one column each. A column has three histograms of 11 bins over the angles between a point's
/// normal and those of its neighbours within `radius_m`. At most `max_neighbours` neighbours, evenly sampled,
/// are used. Columns are unit vectors of square roots of frequencies, so that their distance is Hellinger's.
/// The column of a point without neighbours is zero.
[[nodiscard]] Descriptors compute_fpfh(const PointCloud& cloud, const KdTree& tree,
                                       const std::vector<std::uint32_t>& keys, double radius_m,
                                       std::size_t max_neighbours);

}  // namespace loopwise
