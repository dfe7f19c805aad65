// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/registration/closure_tests.hpp>
#include <loopwise/registration/registrar.hpp>

#include "submap.hpp"

namespace loopwise {

/// The part of a closure's covariance that comes from odometry within the submaps: a step of it moves all
/// members beyond, and the closure follows them as far as they hold the overlapping points. First order. Over
/// the right perturbation of T_from_to; zero for single scans.
/// \param T_target_source the closure's pose, T_from_to⁻¹
/// \param figures of that pose
[[nodiscard]] LOOPWISE_EXPORT Matrix6d submap_errors(const Submap& source, const Submap& target,
                                                     const RegistrationTask& task,
                                                     const Eigen::Isometry3d& T_target_source,
                                                     const AlignmentFigures& figures,
                                                     const ClosureTestOptions& options);

}  // namespace loopwise
