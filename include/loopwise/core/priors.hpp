// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Priors that anchor a graph at the present poses of its nodes.
#pragma once

#include <cstddef>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// Standard deviation of a prior that fixes a pose for all practical purposes, in m and in rad.
inline constexpr double kAnchorSigma = 1e-4;

/// A prior at the present pose of a node, with one standard deviation for all axes of the translation and
/// one for those of the rotation. \throws UnknownKeyError
[[nodiscard]] LOOPWISE_EXPORT PriorFactor prior_at(const PoseGraph& graph, Key key,
                                                   double sigma_m = kAnchorSigma,
                                                   double sigma_rad = kAnchorSigma);

/// Reads KEY[:SIGMA_M[:SIGMA_RAD]], such as "a0" or "625:0.1:0.02", as prior_at(). `name` is that of the
/// option in errors. \throws OptionError on another form, on a standard deviation that is not a positive
/// number, and on a key that the graph does not have
[[nodiscard]] LOOPWISE_EXPORT PriorFactor parse_prior(const std::string& name, const std::string& text,
                                                      const PoseGraph& graph);

/// Adds a prior to the first node of each connected component. \returns the number of components
LOOPWISE_EXPORT std::size_t anchor_components(PoseGraph& graph, double sigma_m = kAnchorSigma,
                                              double sigma_rad = kAnchorSigma);

}  // namespace loopwise
