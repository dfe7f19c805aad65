// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Matches of descriptors between two clouds, alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/point_cloud.hpp>
#include <loopwise/registration/consensus.hpp>
#include <loopwise/registration/fpfh.hpp>

namespace loopwise {

/// A source descriptor and the most similar target descriptor.
struct DescriptorMatch {
  std::uint32_t source = 0;     ///< Column of the source's descriptor.
  std::uint32_t target = 0;     ///< Column of the target's descriptor.
  std::int32_t similarity = 0;  ///< Scalar product of both, rounded, 2^28 for equal ones.
  bool mutual = false;          ///< The source's descriptor is also the most similar one to the target's.
};

/// For each source descriptor the most similar target descriptor, by comparison of all pairs with SIMD:
/// mutual matches first, then the others, each by falling similarity; equal ones in the order of the source.
/// Zero columns have no match. Deterministic, with the same matches on every processor.
/// \param target descriptors of the target, see fpfh()
/// \param source descriptors of the source
/// \param max_matches length of the result at most
[[nodiscard]] LOOPWISE_EXPORT std::vector<DescriptorMatch> match_descriptors(const Descriptors& target,
                                                                             const Descriptors& source,
                                                                             std::size_t max_matches = 1000);

/// Points and normals of matches, for consensus(). Columns of descriptors are points, as fpfh() of all points
/// gives them; replace them by the indices of points if they are key points.
/// \throws InputError if a match names a point that a cloud does not have
[[nodiscard]] LOOPWISE_EXPORT std::vector<Match> matched_points(const PointNormalView& target,
                                                                const PointNormalView& source,
                                                                const std::vector<DescriptorMatch>& matches);

}  // namespace loopwise
