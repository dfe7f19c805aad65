// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// How much of a run goes into its MCAP file.
struct McapOptions {
  /// Maximum number of points of a scan. They are drawn at random.
  std::int64_t scan_points = 2000;
  /// Number of messages with the path so far, for each robot.
  std::int64_t paths = 100;
  /// Seed of the random draw of points.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("scan_points", self.scan_points, between(1, 10000000));
    field("paths", self.paths, between(1, 1000000));
    field("seed", self.seed, at_least(0));
  }
};

/// The written messages.
struct McapResult {
  std::uint64_t messages = 0;      ///< All of them.
  std::size_t scans = 0;           ///< Clouds.
  std::size_t closures = 0;        ///< Verified closures.
  std::vector<std::string> notes;  ///< Missing or altered data.
};

/// Writes a run as one MCAP file of ROS 2 messages for viewers, over mission time, in the frame of the
/// mission: for each robot `/ROBOT/scan` (sensor_msgs/PointCloud2, at the pose of the estimate),
/// `/ROBOT/path` and `/ROBOT/odometry` (nav_msgs/Path); `/closures` (visualization_msgs/MarkerArray) has a
/// line for each verified closure from the time of its result on, those that robust optimisation excluded in
/// red. Poses are those of the last estimate: estimates on the way are not recorded.
/// \param file is replaced in one step
/// \param run folder of a replay
/// \param mission of that replay, for the scans
/// \param options bounds on the size of the file
/// \param progress is called while scans are written
/// \throws IoError; ParseError; OptionError; InputError if the mission is not the run's
LOOPWISE_EXPORT McapResult write_run_mcap(const std::filesystem::path& file, const std::filesystem::path& run,
                                          const Mission& mission, const McapOptions& options = {},
                                          const ProgressCallback& progress = {});

}  // namespace loopwise
