// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <filesystem>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// What a mission can be written as.
enum class MissionFormat {
  kMission,       ///< A mission folder: everything.
  kG2oPcd,        ///< result.g2o and pcd/KEY.pcd, as the NeBula multi-robot data set has them, with keys.csv.
  kTum,           ///< A trajectory for each robot, with stamps.
  kKitti,         ///< A trajectory for each robot, poses alone.
  kHdlGraphSlam,  ///< A dump of hdl_graph_slam, of one robot.
  kHba,           ///< pose.json and pcd/ as HBA reads them, of one robot.
};
[[nodiscard]] inline EnumNames<MissionFormat> enum_names(MissionFormat) {
  return {{MissionFormat::kMission, "mission"},
          {MissionFormat::kG2oPcd, "g2o_pcd"},
          {MissionFormat::kTum, "tum"},
          {MissionFormat::kKitti, "kitti"},
          {MissionFormat::kHdlGraphSlam, "hdl_graph_slam"},
          {MissionFormat::kHba, "hba"}};
}

/// How a mission is written.
struct ConvertOptions {
  PcdEncoding encoding = PcdEncoding::kBinaryCompressed;  ///< Of the clouds.
  int threads = 1;            ///< 0: one per processor. What is written does not depend on it.
  ProgressCallback progress;  ///< Is told how many scans are written.
  StopToken stop;             ///< Ends it early: convert_mission() then throws StoppedError.
};

/// What a conversion came to.
struct ConvertResult {
  std::size_t scans = 0;  ///< Written.
  /// What the format has no place for, by kind: "robot name left out", "radio reading left out", ….
  Problems left_out;
};

/// Writes a mission, one scan per thread in memory. Scans that cannot be read are left out; mission.scans
/// counts them.
///
/// **mission**: see MissionWriter.
/// **g2o_pcd**: result.g2o has full 64-bit keys: where robots are not told apart by the characters of their
/// keys, or landmarks by those of LAMP, each gets one in the order of the mission, which is counted. Nodes,
/// priors and edges as write_g2o() writes them; keys.csv has every node's stamp and cloud; ranges.csv and
/// gravity.csv, if there are such factors, are those of a mission folder; ground_truth/result.g2o the true
/// poses. read_mission() gives all this back.
/// **tum**, **kitti**: ROBOT.tum or ROBOT.kitti, ROBOT_truth.* where the truth is known and ROBOT_reference.*
/// where there is a reference; of each robot the nodes in the order of their keys. No landmarks.
///
/// **hdl_graph_slam**: graph.g2o, special_nodes.csv, NUMBER/data and NUMBER/cloud.pcd. Nodes are numbered by
/// their keys; priors become edges from a fixed node, as read_mission() takes them. Of one robot, in space.
/// **hba**: pose.json and pcd/NUMBER.pcd, of the nodes with a scan; of a mission without scans, such as the
/// results of a replay, all poses alone. Of one robot.
///
/// The folder must not exist or be empty. A target that is not whole is never taken for one: mission.json or
/// result.g2o is written last, trajectories appear all at once, and what was written is removed when this
/// throws. \throws IoError; InputError if the mission contradicts itself; StoppedError
[[nodiscard]] LOOPWISE_EXPORT ConvertResult convert_mission(const Mission& mission,
                                                            const std::filesystem::path& folder,
                                                            MissionFormat format,
                                                            const ConvertOptions& options = {});

}  // namespace loopwise
