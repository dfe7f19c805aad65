// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Key frames from continuous recordings of a robot: odometry and sweeps of its lidar.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise {

/// The recording of one robot: odometry, and the stamps of its sweeps. The points are read later.
struct RobotStream {
  std::string name;                           ///< Of the robot; unique among the streams, not empty.
  std::string source;                         ///< File, folder or topic, for problems and errors.
  std::vector<StampedPose> odometry;          ///< T_odom_sensor, in the order of arrival.
  std::vector<std::int64_t> sweep_stamps_ns;  ///< Of each sweep, in the order of arrival.
};

/// Reads a sweep of a stream, both by their number, in the frame of the sensor. It is called when a scan is
/// needed, from several threads at once. \throws InputError or IoError if it cannot be read
using SweepReader = std::function<CloudFile(std::size_t stream, std::size_t sweep)>;

/// A sweep that is part of the scan of a key frame.
struct SubmapSweep {
  std::size_t sweep = 0;                                          ///< Its number in the stream.
  Eigen::Isometry3d T_key_sweep = Eigen::Isometry3d::Identity();  ///< By odometry.
};

/// A sweep that was chosen to be a node.
struct SelectedKeyFrame {
  std::size_t sweep = 0;                                   ///< Its number in the stream.
  std::int64_t stamp_ns = 0;                               ///< Of the sweep.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();  ///< T_odom_sensor at that stamp.
  /// Sweeps of its scan by stamp, including its own. Empty without submaps: only its own sweep.
  std::vector<SubmapSweep> submap;
};

/// The key frames of a stream, by stamp. The first sweep with a pose becomes a key frame, and so does each
/// sweep that is options.keyframe_distance_m or options.keyframe_angle_rad away from the previous key frame.
/// The odometry must have a pose within options.keyframe_max_time_difference_s of the stamp of the sweep. The
/// pose of the sweep is interpolated between the poses before and after it if these are at most 1 s (or twice
/// that option) apart, else it is the nearer one. Each sweep belongs to the submap of the key frame that is
/// nearest in time. A submap keeps the options.submap_sweeps nearest sweeps.
///
/// Counted: "odometry stamps run backwards, sorted", "sweep stamps run backwards, sorted", "odometry pose of
/// a repeated stamp left out", "sweep of a repeated stamp left out", "odometry pose not finite left out",
/// "stamp out of range left out", "sweep without odometry near in time left out", "sweep with the pose of
/// another time" (by more than 1 ms), "odometry pose without a
/// sweep near in time", "gap in the odometry" and "gap in the sweeps" (more than 1 s
/// and ten times the usual interval, in which the sensor has moved by the distance of key frames), "odometry
/// jumps" (by more than 1 m, faster than 50 m/s), "sweep beyond submap_sweeps left out of a submap".
///
/// \throws InputError naming the source if no sweep has a pose, with the range of both stamps
[[nodiscard]] LOOPWISE_EXPORT std::vector<SelectedKeyFrame> choose_key_frames(const RobotStream& stream,
                                                                              const MissionOptions& options,
                                                                              Problems& problems);

/// The mission of one or several streams. Its nodes are the key frames. The steps between them become
/// odometry edges with odometry_information(). The first node of each robot gets a prior at its pose. The
/// streams share one frame; if several begin at the origin, "joined without a frame" is counted. Nodes of a
/// single robot have the keys 0, 1, …; of several a0, a1, …; b0, …, in the order given. Scans are read by
/// `read` when they are needed: no sweep is held. A sweep of a submap that cannot be read is left out and
/// counted among the problems of the scans as "sweep of a submap cannot be read"; without a key frame's own
/// sweep there is no scan.
///
/// The caller sets kind, path, name and provenance. \throws as choose_key_frames(); InputError if there is no
/// stream, more than 26, or a name is empty or not unique; OptionError
[[nodiscard]] LOOPWISE_EXPORT Mission make_key_frame_mission(const std::vector<RobotStream>& streams,
                                                             SweepReader read,
                                                             const MissionOptions& options = {});

}  // namespace loopwise
