// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Missions assembled from parts whose frames were found after reading.
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

/// Robots of a mission that share a frame, and the pose of that frame.
struct MissionPart {
  std::vector<std::size_t> robots;  ///< Their numbers.
  /// Pose of their frame in the common one.
  Eigen::Isometry3d T_common_part = Eigen::Isometry3d::Identity();
  /// Sigmas x y z roll pitch yaw, in m and rad, of a prior that each robot gets at its first key frame
  /// instead of its own priors. Absent: its priors are kept.
  std::optional<std::array<double, 6>> sigmas;
};

/// The mission with its parts moved to the common frame, and with `closures` as edges that robust
/// optimisation may reject. A landmark moves with the part of the first key frame that an edge or a range
/// connects it to. Robots without a part are left out with all their data, counted as "robot left out: its
/// frame is unknown".
/// \param mission as it was read
/// \param parts of the mission; no robot is in two of them
/// \param closures between nodes of the parts
/// \param move_truth whether true poses are in the frames of the parts and move with them
/// \throws InputError on a robot in two parts or an unknown number of a robot; UnknownKeyError
[[nodiscard]] LOOPWISE_EXPORT Mission place_parts(const Mission& mission,
                                                  const std::vector<MissionPart>& parts,
                                                  const std::vector<LoopClosure>& closures, bool move_truth);

}  // namespace loopwise
