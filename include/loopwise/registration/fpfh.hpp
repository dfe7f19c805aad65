// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Descriptors of surfaces, alone.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/point_cloud.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Numbers in a descriptor: three histograms of 11 bins.
inline constexpr int kFpfhSize = 33;

/// Descriptors, one column each: unit vectors, or zero for a point without a descriptor.
using Descriptors = Eigen::Matrix<float, kFpfhSize, Eigen::Dynamic>;

/// Options of fpfh(). The defaults suit scans with a voxel of 0.5 m.
struct FpfhOptions {
  /// Radius of the neighbourhood that a descriptor describes, m. About five voxels.
  double radius_m = 2.5;
  /// Maximum number of neighbours within the radius, evenly sampled, that form a histogram.
  int max_neighbours = 40;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("radius_m", self.radius_m, above(0.0));
    field("max_neighbours", self.max_neighbours, between(3.0, 1000.0));
  }
};

/// Fast point feature histograms (Rusu, Blodow, Beetz, ICRA 2009), one column for each point. A column has
/// three histograms of 11 bins over the angles between a point's normal and those of its neighbours. Columns
/// are unit vectors of square roots of frequencies, so that their distance is Hellinger's. They do not change
/// with the pose of the sensor. The column of a point that is not finite or has no neighbours with known
/// normals is zero. Serial; deterministic.
/// \param cloud points and normals, read in place
/// \param tree of the points
/// \param options radius and neighbours
/// \throws OptionError; InputError if the tree is that of another cloud or a normal is not of unit length
[[nodiscard]] LOOPWISE_EXPORT Descriptors fpfh(const PointNormalView& cloud, const KdTree& tree,
                                               const FpfhOptions& options = {});

/// The same for key points alone: column k describes the point keys[k]. \throws InputError also if a key is
/// not the index of a point
[[nodiscard]] LOOPWISE_EXPORT Descriptors fpfh(const PointNormalView& cloud, const KdTree& tree,
                                               const FpfhOptions& options,
                                               const std::vector<std::uint32_t>& keys);

}  // namespace loopwise
