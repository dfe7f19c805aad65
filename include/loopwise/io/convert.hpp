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

/// Output formats of a mission.
enum class MissionFormat {
  kMission,       ///< A mission folder: all data.
  kG2oPcd,        ///< result.g2o and pcd/KEY.pcd, as in the NeBula multi-robot data set, with keys.csv.
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
  int threads = 1;            ///< 0: one per processor. Does not change the output.
  ProgressCallback progress;  ///< Gets the number of written scans.
  StopToken stop;             ///< Ends it early: convert_mission() then throws StoppedError.
};

/// The result of a conversion.
struct ConvertResult {
  std::size_t scans = 0;  ///< Written.
  /// Data that the format cannot hold, by kind: "robot name left out", "radio reading left out", ….
  Problems left_out;
};

/// Writes a mission, one scan per thread in memory. Scans that cannot be read are left out; mission.scans
/// counts them.
///
/// **mission**: see MissionWriter.
/// **g2o_pcd**: result.g2o has full 64-bit keys: if the characters of the keys do not distinguish the robots,
/// or LAMP's characters the landmarks, each gets a new character in the order of the mission, which is
/// counted. Nodes, priors and edges are as from write_g2o(); keys.csv has every node's stamp and cloud;
/// ranges.csv and gravity.csv, if there are such factors, are those of a mission folder;
/// ground_truth/result.g2o has the true poses. read_mission() reads all of it.
/// **tum**, **kitti**: ROBOT.tum or ROBOT.kitti, ROBOT_truth.* if the truth is known and ROBOT_reference.* if
/// there is a reference; the nodes of each robot are in the order of their keys. Landmarks are left out.
///
/// **hdl_graph_slam**: graph.g2o, special_nodes.csv, NUMBER/data and NUMBER/cloud.pcd. Nodes are numbered by
/// their keys; priors become edges from a fixed node, as read_mission() takes them. For one robot and 3D
/// graphs only.
/// **hba**: pose.json and pcd/NUMBER.pcd of the nodes with a scan. A mission without scans, such as the
/// result of a replay, gives all poses and no clouds. For one robot only.
///
/// The folder must not exist or be empty. An incomplete target is never read as complete: mission.json or
/// result.g2o is written last, trajectories appear all at once, and all output is removed if this throws.
/// \throws IoError; InputError if the mission contradicts itself; StoppedError
[[nodiscard]] LOOPWISE_EXPORT ConvertResult convert_mission(const Mission& mission,
                                                            const std::filesystem::path& folder,
                                                            MissionFormat format,
                                                            const ConvertOptions& options = {});

}  // namespace loopwise
