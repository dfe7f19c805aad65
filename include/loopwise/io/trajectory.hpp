// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>

namespace loopwise {

/// A pose of a trajectory.
struct StampedPose {
  std::int64_t stamp_ns = 0;                               ///< ns since the epoch of the recording.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();  ///< T_world_body; translation in metres.
};

/// Format of a trajectory, and the identification of its poses.
enum class TrajectoryFormat {
  kTum,    ///< "stamp x y z qx qy qz qw", stamp in seconds: by stamp.
  kKitti,  ///< A row-major 3×4 matrix a line: by row, from 0.
  kG2o,    ///< The vertices of a g2o file: by key.
};
[[nodiscard]] inline EnumNames<TrajectoryFormat> enum_names(TrajectoryFormat) {
  return {
      {TrajectoryFormat::kTum, "tum"}, {TrajectoryFormat::kKitti, "kitti"}, {TrajectoryFormat::kG2o, "g2o"}};
}

/// Poses from a file.
struct Trajectory {
  TrajectoryFormat format = TrajectoryFormat::kTum;  ///< The format of the file.
  std::vector<Eigen::Isometry3d> poses;  ///< Sorted by stamp for TUM, else in the order of the file.
  std::vector<Key> keys;                 ///< One per pose: the key of a g2o vertex, else its number from 0.
  std::vector<std::int64_t> stamps_ns;   ///< One per pose for TUM, else empty.
  Problems problems;                     ///< Tolerable flaws.
};

/// Reads any of the three formats, recognised by the contents. A g2o file needs no edges. Comments start with
/// '#'. Counted: "non-unit quaternion", "rotation not orthonormal" (both repaired); of TUM files "pose with a
/// stamp before the preceding one, sorted", "repeated stamp, perhaps written with too few digits", "stamps
/// that may lack their seconds" (they are in the first second and not ascending).
/// \throws IoError; ParseError naming the line; InputError if there is no pose.
[[nodiscard]] LOOPWISE_EXPORT Trajectory read_trajectory(const std::filesystem::path& path);
/// As read_trajectory(), for this format only.
[[nodiscard]] LOOPWISE_EXPORT Trajectory read_trajectory(const std::filesystem::path& path,
                                                         TrajectoryFormat format);

/// The same for a text in memory; `source` replaces the file's name in errors and problems.
[[nodiscard]] LOOPWISE_EXPORT Trajectory parse_trajectory(std::string_view text, const std::string& source);
/// As parse_trajectory(), for this format only.
[[nodiscard]] LOOPWISE_EXPORT Trajectory parse_trajectory(std::string_view text, const std::string& source,
                                                          TrajectoryFormat format);

/// As read_trajectory() for TUM, in the order of the stamps.
[[nodiscard]] LOOPWISE_EXPORT std::vector<StampedPose> read_tum(const std::filesystem::path& path);
/// As read_trajectory() for KITTI, in the order of the file.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Isometry3d> read_kitti(const std::filesystem::path& path);

/// Stamps in seconds with nine decimals, exactly. Replaces the file as a whole or not at all. \throws IoError
LOOPWISE_EXPORT void write_tum(const std::filesystem::path& path, const std::vector<StampedPose>& poses);
/// Twelve numbers a line. Replaces the file as a whole or not at all. \throws IoError
LOOPWISE_EXPORT void write_kitti(const std::filesystem::path& path,
                                 const std::vector<Eigen::Isometry3d>& poses);

/// Paired poses of two trajectories.
struct PosePairs {
  std::vector<Key> keys;                    ///< Of the estimate.
  std::vector<Eigen::Isometry3d> estimate;  ///< Estimated poses, one per key.
  std::vector<Eigen::Isometry3d> truth;     ///< True poses, one per key.
  Problems problems;                        ///< "pose without truth", "truth without pose".
};

/// Pairs by key (two g2o files), by nearest stamp within `max_time_difference_s` (two TUM files; each truth
/// is used once), otherwise by row, which needs the same number of poses in both. A KITTI file also pairs
/// with a g2o file of another length if the keys are row numbers, that is if the rows hold every key. \throws
/// InputError if no pose has a partner, or the rows are ambiguous.
[[nodiscard]] LOOPWISE_EXPORT PosePairs associate(const Trajectory& estimate, const Trajectory& truth,
                                                  double max_time_difference_s = 0.02);

/// A single rigid transform: 12 or 16 numbers (rows of a 3×4 or 4×4 matrix, on any lines) or 7 (x y z qx qy
/// qz qw). A rotation with rounding errors is orthonormalised. \throws IoError; ParseError
[[nodiscard]] LOOPWISE_EXPORT Eigen::Isometry3d read_transform(const std::filesystem::path& path);
/// The same for a text in memory; `source` replaces the file's name in errors.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Isometry3d parse_transform(std::string_view text,
                                                                const std::string& source);

}  // namespace loopwise
