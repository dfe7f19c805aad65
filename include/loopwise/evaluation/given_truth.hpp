// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Makes the poses of files the ground truth of a mission, in place of a recorded one. Each is the path of a
/// TUM, KITTI or g2o file, or ROBOT=PATH for the nodes of one robot alone.
///
/// - g2o: by key.
/// - TUM: by stamp. A node within 0.02 s of a stamp gets its pose; one between two stamps that are at most
///   options.truth_max_time_difference_s apart gets an interpolated pose. Of one robot.
/// - KITTI: one row for each of the robot's nodes, in the order of their keys. Of one robot.
///
/// A truth that does not begin at the nodes (0.5 m and a tenth of the path, 2 degrees in the mean, over the
/// first 10 m of each robot) is in another frame: the rigid motion of least squares aligns it with the nodes,
/// mission.truth_is_aligned is set, and "truth in another frame" is counted among the mission's problems. The
/// same applies to a truth without the first 10 m of any robot, because its frame is unknown: "truth begins
/// late" is counted for each such robot. Also counted are "node without ground truth" and, of g2o files,
/// "ground truth without node".
///
/// \throws IoError; ParseError naming file and line; OptionError naming an unknown robot; InputError if a
///         file has no pose of any node, does not name the robot of its poses, pairs by stamps that the
///         mission does not have, see require_own_stamps(), or has orientations that are not those of the
///         nodes, as of a camera or of GPS, which has no orientations; also if options.strict and a line of
///         a file had to be repaired
LOOPWISE_EXPORT void set_truth(Mission& mission, const std::vector<std::string>& files,
                               const MissionOptions& options = {});

/// Checks for ground truth before a comparison. \throws InputError with the remedy if the mission, read from
/// `path`, has no ground truth
LOOPWISE_EXPORT void require_truth(const std::string& path, const Mission& mission);

/// Checks the stamps of the nodes before pairing with the poses of `file`. \throws InputError with the remedy
/// if they are not those of the recording: invented by the reader ("no stamps given", "node without stamp"),
/// or moved by options.start_together
LOOPWISE_EXPORT void require_own_stamps(const Mission& mission, const std::string& file,
                                        const MissionOptions& options = {});

}  // namespace loopwise
