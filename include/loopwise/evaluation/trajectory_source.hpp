// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Trajectories to compare, from files of poses, runs or recordings.
#pragma once

#include <filesystem>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise {

/// An estimate and the truth, for associate().
struct TrajectoryPair {
  Trajectory estimate;  ///< Estimated poses.
  Trajectory truth;     ///< True poses.
  Robots robots;        ///< Of the recording if pairs have its keys. Empty: one robot for each character.
  /// The odometry of a recorded truth equals it: errors against it then say nothing about a map.
  bool odometry_is_truth = false;
};

/// Reads an estimate and its truth. Each may be a file of read_trajectory() or a recording of read_mission():
/// the graph of a recording is an estimate, its ground truth a truth. The estimate may also be the folder of
/// a run. A recording is paired with the other trajectory by key, or by stamp if that is a TUM file.
/// \throws as read_trajectory(), read_mission() and require_own_stamps(); InputError if a recording has no
/// ground truth
[[nodiscard]] LOOPWISE_EXPORT TrajectoryPair read_trajectory_pair(const std::filesystem::path& estimate,
                                                                  const std::filesystem::path& truth,
                                                                  const MissionOptions& options = {},
                                                                  const ProgressCallback& progress = {},
                                                                  const StopToken& stop = {});

}  // namespace loopwise
