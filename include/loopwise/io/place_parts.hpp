// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Missions put together from parts whose frames became known after they were read.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Robots of a mission that share a frame, and where that frame lies.
struct MissionPart {
  std::vector<std::size_t> robots;  ///< Their numbers.
  /// Pose of their frame in the common one.
  Eigen::Isometry3d T_common_part = Eigen::Isometry3d::Identity();
  /// Sigmas x y z roll pitch yaw of a prior that each robot gets at its first key frame, in m and rad, in
  /// place of those that it has. Absent: its priors stay as they are.
  std::optional<std::array<double, 6>> sigmas;
};

/// The mission with its parts in their places and these closures as edges that robust optimisation may doubt.
/// Landmarks go with the part of the first key frame that an edge or a range ties them to. Robots of no part
/// are left out with all that is theirs, counted as "robot left out: its frame is not known".
/// \param mission as it was read
/// \param parts no robot in two of them
/// \param closures between nodes of the parts
/// \param move_truth whether true poses stand in the parts' own frames and move along; else they stay
/// \throws InputError on a robot in two parts or an unknown number of a robot; UnknownKeyError
[[nodiscard]] LOOPWISE_EXPORT Mission place_parts(const Mission& mission,
                                                  const std::vector<MissionPart>& parts,
                                                  const std::vector<LoopClosure>& closures, bool move_truth);

}  // namespace loopwise
