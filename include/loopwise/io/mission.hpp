// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/radio.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/scan_store.hpp>

namespace loopwise {

/// What a mission was read from.
enum class MissionKind {
  kMission,  ///< A folder with mission.json.
  kSession,  ///< A folder with Scans/ and poses in KITTI's form, as single-robot SLAM programs write it.
  kG2o,      ///< A g2o file alone: no scans.
};
[[nodiscard]] inline EnumNames<MissionKind> enum_names(MissionKind) {
  return {{MissionKind::kMission, "mission"}, {MissionKind::kSession, "session"}, {MissionKind::kG2o, "g2o"}};
}

/// A robot is out of range in [begin_s, end_s) of mission time: what it makes inside arrives at end_s.
struct CommunicationGap {
  std::size_t robot = 0;  ///< Number of the robot.
  double begin_s = 0.0;   ///< Out of range from here, s.
  double end_s = 0.0;     ///< Back in range, s.
};

/// Everything recorded of a run of a team of robots, in one common frame.
struct Mission {
  std::string name;                          ///< Of the folder or as mission.json says.
  std::filesystem::path path;                ///< Where it was read from.
  MissionKind kind = MissionKind::kMission;  ///< What it was read from.
  Robots robots;                             ///< Own every node of the graph.
  PoseGraph graph;  ///< Nodes with stamps, priors, odometry; closures only if the files hold some.
  std::shared_ptr<const ScanStore> scans = std::make_shared<ScanStore>();  ///< Never null.
  std::map<Key, Eigen::Isometry3d> ground_truth;                           ///< Empty if not known.
  std::vector<CommunicationGap> gaps;                                      ///< By robot, then begin.
  std::vector<RadioReading> radio;                                         ///< In the order of the file.
  std::vector<BeaconDrop> beacons;                                         ///< In the order of the file.
  std::int64_t start_ns = 0;  ///< Stamp of mission time 0: the earliest, unless mission.json says otherwise.
  std::string frame = "map";  ///< Name of the common frame.
  std::string provenance_json = "{}";  ///< A JSON object: where the mission comes from.
  Problems problems;                   ///< Of all files but the scans, whose own are in scans->problems().

  /// Mission time of a stamp, s.
  [[nodiscard]] double time_s(std::int64_t stamp_ns) const {
    return static_cast<double>(stamp_ns - start_ns) * 1e-9;
  }
};

/// How a mission is read, and what is put in where its files say nothing.
struct MissionOptions {
  /// As parse_robots() takes it. Empty: as mission.json says, or one robot per character of the keys.
  std::string robots;
  double scan_cache_mb = 512.0;
  /// Sigmas of odometry made from a session's poses: per metre of the step, but never below the minimum.
  double odometry_sigma_m_per_m = 0.02;
  double odometry_sigma_rad_per_m = 0.002;
  double odometry_min_sigma_m = 0.01;
  double odometry_min_sigma_rad = 0.001;
  /// Sigmas of the prior that a mission without any is given, x y z and roll pitch yaw. Those of LAMP.
  std::vector<double> prior_sigmas = {0.0016, 0.0016, 0.0016, 0.041, 0.041, 0.00041};
  double node_interval_s = 2.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("robots", self.robots, any_value(),
          "Robots and their keys, as \"0-624,625-1249\" or \"husky=0-624,spot=625-1249\" or \"a,b\"; "
          "empty: as the files say.");
    field("scan_cache_mb", self.scan_cache_mb, at_least(0.0), "Memory for scans kept after use, MB.");
    field("odometry_sigma_m_per_m", self.odometry_sigma_m_per_m, at_least(0.0),
          "Sessions: translation sigma of an odometry edge per metre of its length.");
    field("odometry_sigma_rad_per_m", self.odometry_sigma_rad_per_m, at_least(0.0),
          "Sessions: rotation sigma of an odometry edge per metre of its length.");
    field("odometry_min_sigma_m", self.odometry_min_sigma_m, above(0.0),
          "Sessions: least translation sigma of an odometry edge, m.");
    field("odometry_min_sigma_rad", self.odometry_min_sigma_rad, above(0.0),
          "Sessions: least rotation sigma of an odometry edge, rad.");
    field("prior_sigmas", self.prior_sigmas, above(0.0),
          "Sigmas of the prior given to a mission without one: x, y, z in m, roll, pitch, yaw in rad.");
    field("node_interval_s", self.node_interval_s, above(0.0),
          "Time between a robot's nodes where the files hold no stamps, s.");
  }
};

/// Information of an odometry edge over a step T, by the session sigmas of the options.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d odometry_information(const Eigen::Isometry3d& T,
                                                            const MissionOptions& options = {});

/// What lies at the path. \throws InputError saying what was looked for if it is nothing that read_mission()
/// reads; IoError if it does not exist.
[[nodiscard]] LOOPWISE_EXPORT MissionKind mission_kind(const std::filesystem::path& path);

/// Reads a mission folder (or its mission.json), a session folder or a g2o file. Scans are found, not read.
///
/// **Mission folder**: the files below; all but the first two may be missing. Keys are decimal numbers of 64
/// bits (or a letter and an index), in JSON as text.
///
/// - mission.json: `{"format": "loopwise-mission", "version": 1, "name", "frame", "clock": {"start_ns"},
///   "robots": [{"name", "first", "last", "landmarks"}], "communication_gaps": [{"robot", "begin_s",
///   "end_s"}], "provenance": {...}, "files": {"graph", "stamps", "priors", "scans", "radio", "beacons",
///   "ranges", "gravity", "ground_truth"}}`; only format and version must be there, other keys are errors,
///   and `files` may not lead out of the folder
/// - graph.g2o
/// - stamps.csv: `key,stamp_ns`, a row for every node
/// - priors.csv: `key,x,y,z,qx,qy,qz,qw,sx,sy,sz,srx,sry,srz`, sigmas in m, rad
/// - scans/KEY.pcd, or another form of read_cloud()
/// - radio.csv: `key,beacon,transmit_dbm,receiver,receive_dbm`, an empty power was not received
/// - beacons.csv: `beacon,robot,drop_key,stamp_ns`
/// - ranges.csv: `from,to,range_m,sigma_m`
/// - gravity.csv: `key,x,y,z,sigma_rad`, the direction of gravity (-z of the common frame) in the body frame
/// - ground_truth.g2o: vertices alone
///
/// A mission without priors gets one at the first node of each robot, where it stands: the robots started
/// from a common frame.
///
/// **Session folder**: rows of the poses file are the nodes 0 … n−1. Odometry comes from odom_poses.txt, else
/// from the edges (i, i+1) of singlesession_posegraph.g2o, else from optimized_poses.txt: consecutive poses,
/// information by the options' sigmas (a g2o edge brings its own). Other edges of that g2o file are left out
/// and counted: closures are ours to find. optimized_poses.txt, where present, is the ground truth. Stamps
/// are in times.txt, seconds; scans in Scans/NUMBER.EXT. The first node gets a prior.
///
/// **g2o file**: the graph; its first node gets a prior if the file has none.
///
/// Counted: "no prior given", "no stamps given", "stamps not ascending", "node without scan", "scan without
/// node", "repeated scan", "node without ground truth", "ground truth without node", "radio reading without
/// node", "stamp without node", "foreign file in scans", and what the readers of the parts count.
/// \throws IoError; ParseError or InputError naming file and line or key; OptionError
[[nodiscard]] LOOPWISE_EXPORT Mission read_mission(const std::filesystem::path& path,
                                                   const MissionOptions& options = {});

/// Writes a mission folder scan by scan. mission.json comes last: a folder without it is no mission, so that
/// one whose making was interrupted is never taken for whole.
class LOOPWISE_EXPORT MissionWriter {
 public:
  /// Makes the folder. \throws IoError if it exists and is not empty, or cannot be made.
  explicit MissionWriter(std::filesystem::path folder, PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

  /// Writes scans/KEY.pcd. Calls with different keys may come from several threads. \throws IoError
  void add_scan(Key key, const PointCloud& cloud) const;

  /// Writes all else; `mission.scans`, `path`, `kind` and `problems` are not looked at.
  /// \throws IoError; InputError if the mission contradicts itself (a node without a robot, provenance that
  /// is no JSON)
  void finish(const Mission& mission) const;

 private:
  std::filesystem::path folder_;
  PcdEncoding encoding_;
};

/// A whole mission with the scans of `mission.scans`, one at a time in memory.
LOOPWISE_EXPORT void write_mission(const std::filesystem::path& folder, const Mission& mission,
                                   PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

}  // namespace loopwise
