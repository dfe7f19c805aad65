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
#include <loopwise/core/progress.hpp>
#include <loopwise/core/radio.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/scan_store.hpp>

namespace loopwise {

/// The source of a mission.
enum class MissionKind {
  kMission,        ///< A folder with mission.json.
  kSession,        ///< A folder with Scans/ and KITTI poses, as single-robot SLAM programs write it.
  kG2o,            ///< A g2o file alone: no scans.
  kG2oPcd,         ///< A folder with a g2o file and clouds, as in the NeBula multi-robot data set.
  kBags,           ///< Bags of ROS 1 or ROS 2.
  kLampZip,        ///< A map that LAMP's base station saved.
  kJoined,         ///< Several missions of one robot each.
  kRun,            ///< A folder that a replay wrote: its graph with the closures, without scans.
  kKitti,          ///< A sequence in the layout of KITTI's odometry data.
  kStampedClouds,  ///< A folder of clouds whose names are stamps, and a trajectory.
  kGlim,           ///< A map that GLIM saved: its submaps.
  kFastLioSamQn,   ///< Key frames that FAST-LIO-SAM or FAST-LIO-SAM-QN saved.
  kVoxelSlam,      ///< A session that Voxel-SLAM saved.
  kHba,            ///< Poses and clouds in the layout of HBA.
  kKissSlam,       ///< Local maps of KISS-SLAM.
  kOpen3d,         ///< A pose graph of Open3D.
  kRtabmap,        ///< A database of RTAB-Map.
};
[[nodiscard]] inline EnumNames<MissionKind> enum_names(MissionKind) {
  return {{MissionKind::kMission, "mission"},
          {MissionKind::kSession, "session"},
          {MissionKind::kG2o, "g2o"},
          {MissionKind::kG2oPcd, "g2o_pcd"},
          {MissionKind::kBags, "rosbag"},
          {MissionKind::kLampZip, "lamp_zip"},
          {MissionKind::kJoined, "joined"},
          {MissionKind::kRun, "run"},
          {MissionKind::kKitti, "kitti"},
          {MissionKind::kStampedClouds, "stamped_clouds"},
          {MissionKind::kGlim, "glim"},
          {MissionKind::kFastLioSamQn, "fast_lio_sam_qn"},
          {MissionKind::kVoxelSlam, "voxel_slam"},
          {MissionKind::kHba, "hba"},
          {MissionKind::kKissSlam, "kiss_slam"},
          {MissionKind::kOpen3d, "open3d"},
          {MissionKind::kRtabmap, "rtabmap"}};
}

/// How the 36 numbers of an odometry edge's covariance in a bag are ordered. LAMP's code stores rotation
/// first; some of its odometry sources pass on the covariance of nav_msgs/Odometry, which has translation
/// first.
enum class CovarianceOrder { kRotationFirst, kTranslationFirst };
[[nodiscard]] inline EnumNames<CovarianceOrder> enum_names(CovarianceOrder) {
  return {{CovarianceOrder::kRotationFirst, "rotation_first"},
          {CovarianceOrder::kTranslationFirst, "translation_first"}};
}

/// A robot is out of range in [begin_s, end_s) of mission time: its data from this interval arrive at end_s.
struct CommunicationGap {
  std::size_t robot = 0;  ///< Number of the robot.
  double begin_s = 0.0;   ///< Out of range from here, s.
  double end_s = 0.0;     ///< Back in range, s.
};

/// A topic of the bags that a mission was read from.
struct RecordedTopic {
  std::string name;          ///< "/husky1/points"
  std::string type;          ///< "sensor_msgs/PointCloud2"
  std::size_t messages = 0;  ///< In all bags.
  std::string use;           ///< Data taken from it, in words; empty if it is not used.
};

/// All recorded data of a run of a team of robots, in one common frame.
struct Mission {
  std::string name;                          ///< Name of the folder, or the one in mission.json.
  std::filesystem::path path;                ///< Path of the source.
  MissionKind kind = MissionKind::kMission;  ///< Kind of the source.
  Robots robots;                             ///< Own every node of the graph.
  PoseGraph graph;  ///< Nodes with stamps, priors, odometry; closures only if the files hold some.
  std::shared_ptr<const ScanStore> scans = std::make_shared<ScanStore>();  ///< Never null.
  /// True poses, with which estimates are evaluated. Empty if unknown. set_truth() takes them from files.
  std::map<Key, Eigen::Isometry3d> ground_truth;
  /// ground_truth is in another frame and was aligned with the mission: only aligned errors are meaningful.
  bool truth_is_aligned = false;
  std::string truth_file;  ///< Source of ground_truth from set_truth(); empty if it was recorded.
  /// Poses that another program computed, such as a session's own optimised poses. They serve for comparison,
  /// never as the truth. Empty if no such poses are recorded.
  std::map<Key, Eigen::Isometry3d> reference;
  std::vector<CommunicationGap> gaps;  ///< By robot, then begin.
  std::vector<RadioReading> radio;     ///< In the order of the file.
  std::vector<BeaconDrop> beacons;     ///< In the order of the file.
  /// For joined sources: the number of the source of each robot. Else empty.
  std::vector<std::size_t> robot_sources;
  std::int64_t start_ns = 0;  ///< Stamp of mission time 0: the earliest, unless mission.json sets it.
  std::string frame = "map";  ///< Name of the common frame.
  std::string provenance_json = "{}";  ///< A JSON object: where the mission comes from.
  std::vector<RecordedTopic> topics;   ///< Of bags, by name; else empty.
  Problems problems;  ///< Of all files except scans, whose problems are in scans->problems().

  /// Mission time of a stamp, s.
  [[nodiscard]] double time_s(std::int64_t stamp_ns) const {
    return static_cast<double>(stamp_ns - start_ns) * 1e-9;
  }
};

/// How a mission is read, and defaults for missing data.
struct MissionOptions {
  /// Robots and their keys, such as "0-624,625-1249" or "husky=0-624,spot=625-1249" or "a,b", see
  /// parse_robots(). Groups of landmarks come from the files and are not listed. Empty: as in mission.json,
  /// or one robot per character of the keys.
  std::string robots;
  /// File with two keys a line, in any order: the edges that are odometry. Empty: the edges between
  /// neighbours of one robot, see classify_edges().
  std::string odometry;
  /// Memory for scans that are kept after use, MB.
  double scan_cache_mb = 512.0;
  /// Fields of a point in .bin files, which have no header: auto (xyzi if the values are plausible), xyz,
  /// xyzi (KITTI), xyzir (nuScenes), xyzirt, xyz_double, xyzi_double, or a record of HeLiPR.
  BinLayout bin_layout = BinLayout::kAuto;
  /// Odometry without information, such as from the poses of a session: standard deviation of the translation
  /// per metre of the step, m.
  double odometry_sigma_m_per_m = 0.02;
  /// Odometry without information, such as from the poses of a session: standard deviation of the rotation
  /// per metre of the step, rad.
  double odometry_sigma_rad_per_m = 0.002;
  /// Odometry without information: minimum standard deviation of the translation, m.
  double odometry_min_sigma_m = 0.01;
  /// Odometry without information: minimum standard deviation of the rotation, rad.
  double odometry_min_sigma_rad = 0.001;
  /// Standard deviations of the prior that a mission without priors gets: x, y, z in m; roll, pitch, yaw in
  /// rad. The default values are those of LAMP.
  std::vector<double> prior_sigmas = {0.0016, 0.0016, 0.0016, 0.041, 0.041, 0.00041};
  /// Time between consecutive nodes of a robot if the files hold no stamps, s.
  double node_interval_s = 2.0;
  /// g2o_pcd folders: letter of the robot whose ids in the graph lack it. Empty: taken from the names of the
  /// clouds.
  std::string robot_character;
  /// Bags: order of the covariances of odometry, rotation first or translation first.
  CovarianceOrder odometry_covariance_order = CovarianceOrder::kRotationFirst;
  /// Bags: maximum difference of stamps between a node and its true pose, which is the nearest in time, s.
  /// Files given as truth: the longest gap between stamps that is interpolated.
  double truth_max_time_difference_s = 1.0;
  /// Bags without graphs: topic of the odometry, as a whole name or within the namespace of each robot.
  /// Empty: the one with the most messages.
  std::string odometry_topic;
  /// Bags without graphs: topic of the clouds, as a whole name or within the namespace of each robot. Empty:
  /// the one with the most messages.
  std::string cloud_topic;
  /// Bags without graphs: topic of the true poses. Empty: topics with ground_truth or gt in their names.
  std::string truth_topic;
  /// Several missions as one: file with the pose of the frame of each mission in the common frame. Empty:
  /// poses are in the common frame. read_team() also takes the words auto and common.
  std::string frames;
  /// Several missions as one: all begin at the same time, independent of their stamps.
  bool start_together = false;
  /// Odometry with sweeps: a key frame is made when the sensor has moved this far since the last one, m. 0:
  /// of every sweep.
  double keyframe_distance_m = 1.0;
  /// Odometry with sweeps: a key frame is made when the sensor has turned by this angle since the last one,
  /// rad. 0: of every sweep.
  double keyframe_angle_rad = 0.35;
  /// Odometry with sweeps: maximum time between a sweep and the pose of the odometry that it gets, s.
  double keyframe_max_time_difference_s = 0.1;
  /// Odometry with sweeps: maximum number of sweeps that form the scan of a key frame, those nearest in time.
  /// 0: only its own sweep.
  std::int64_t submap_sweeps = 0;
  /// Folders of sweeps: file with the poses of the sweeps (rows of KITTI, or TUM), if the folder holds only
  /// clouds or the poses of something else. Empty: the file beside the sweeps.
  std::string poses;
  /// A measurement that would be repaired, guessed or left out is an error.
  bool strict = false;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("robots", self.robots, any_value());
    field("odometry", self.odometry, any_value());
    field("scan_cache_mb", self.scan_cache_mb, at_least(0.0));
    field("bin_layout", self.bin_layout, any_value());
    field("odometry_sigma_m_per_m", self.odometry_sigma_m_per_m, at_least(0.0));
    field("odometry_sigma_rad_per_m", self.odometry_sigma_rad_per_m, at_least(0.0));
    field("odometry_min_sigma_m", self.odometry_min_sigma_m, above(0.0));
    field("odometry_min_sigma_rad", self.odometry_min_sigma_rad, above(0.0));
    field("prior_sigmas", self.prior_sigmas, above(0.0));
    field("node_interval_s", self.node_interval_s, above(0.0));
    field("robot_character", self.robot_character, any_value());
    field("odometry_covariance_order", self.odometry_covariance_order, any_value());
    field("truth_max_time_difference_s", self.truth_max_time_difference_s, at_least(0.0));
    field("odometry_topic", self.odometry_topic, any_value());
    field("cloud_topic", self.cloud_topic, any_value());
    field("truth_topic", self.truth_topic, any_value());
    field("frames", self.frames, any_value());
    field("start_together", self.start_together, any_value());
    field("keyframe_distance_m", self.keyframe_distance_m, at_least(0.0));
    field("keyframe_angle_rad", self.keyframe_angle_rad, at_least(0.0));
    field("keyframe_max_time_difference_s", self.keyframe_max_time_difference_s, at_least(0.0));
    field("submap_sweeps", self.submap_sweeps, between(0.0, 1000.0));
    field("poses", self.poses, any_value());
    field("strict", self.strict, any_value());
  }
};

/// classify_edges() with the options. Edges without information in the file (G2oFile::without_information)
/// first get it: odometry_information() for edges between neighbours or in the list, 0.1 m and 0.02 rad for
/// others. \throws IoError; ParseError naming the line of the file; InputError naming the file and a pair
/// without an edge or with a landmark
LOOPWISE_EXPORT Problems classify_edges(PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                                        const std::vector<std::size_t>& without_information = {});

/// The odometry edges of a classified graph, as MissionOptions::odometry takes them; empty if the neighbours
/// determine them. For odometry.csv beside a written graph.
[[nodiscard]] LOOPWISE_EXPORT std::string odometry_list(const PoseGraph& graph, const Robots& robots);

/// Information of an odometry edge over a step T, by the session sigmas of the options.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d odometry_information(const Eigen::Isometry3d& T,
                                                            const MissionOptions& options = {});

/// The kind of source at the path, from the first bytes of a file or the contents of a folder. The data set's
/// outer folder, with rosbag/ or g2o_pcd/ in it, counts as the part that read_mission() reads. \throws
/// InputError naming the expected contents if read_mission() cannot read it; IoError if it does not exist.
[[nodiscard]] LOOPWISE_EXPORT MissionKind mission_kind(const std::filesystem::path& path);

/// Reads a mission folder (or its mission.json), a session folder, a g2o file, a g2o_pcd folder, ROS 1 bags,
/// a map saved by LAMP, the data set's own folder, sweeps with poses, or the files of other programs. Scans
/// are located, not read.
///
/// **Mission folder**: the files below; all but the first two may be missing. Keys are decimal numbers of 64
/// bits (or a letter and an index), in JSON as text.
///
/// - mission.json: `{"format": "loopwise-mission", "version": 1, "name", "frame", "clock": {"start_ns"},
///   "robots": [{"name", "first", "last", "landmarks"}], "communication_gaps": [{"robot", "begin_s",
///   "end_s"}], "provenance": {...}, "files": {"graph", "stamps", "priors", "scans", "radio", "beacons",
///   "ranges", "gravity", "odometry", "ground_truth", "reference"}}`; only format and version are required,
///   other keys are errors, and `files` may not lead outside of the folder
/// - graph.g2o
/// - stamps.csv: `key,stamp_ns`, a row for every node
/// - priors.csv: `key,x,y,z,qx,qy,qz,qw,sx,sy,sz,srx,sry,srz`, sigmas in m, rad
/// - scans/KEY.pcd, or another format of read_cloud()
/// - radio.csv: `key,beacon,transmit_dbm,receiver,receive_dbm`, an empty power was not received
/// - beacons.csv: `beacon,robot,drop_key,stamp_ns`
/// - ranges.csv: `from,to,range_m,sigma_m`
/// - gravity.csv: `key,x,y,z,sigma_rad`, the direction of gravity (-z of the common frame) in the body frame
/// - odometry.csv: as MissionOptions::odometry, which takes precedence
/// - ground_truth.g2o: vertices alone
/// - reference.g2o: the same, poses that another program computed
///
/// A mission without priors gets one at the pose of the first node of each robot: the robots started from a
/// common frame.
///
/// **Session folder**: rows of the poses file are the nodes 0 … n−1. Odometry comes from odom_poses.txt, else
/// from the edges (i, i+1) of singlesession_posegraph.g2o, else from optimized_poses.txt: consecutive poses,
/// information from the options' sigmas (a g2o edge may have its own). Other edges of that g2o file are left
/// out and counted: finding closures is the task. optimized_poses.txt, if present, is the reference: another
/// program's result, not the truth. Stamps are in times.txt, seconds; scans in Scans/NUMBER.EXT, from 0 or
/// from 1. The first node gets a prior. If a session was stopped during saving, the rows that all files have
/// are read.
///
/// **g2o file**: the graph; its first node gets a prior if the file has no prior.
///
/// **g2o_pcd folder**: result.g2o, else the only g2o file that is not the truth, and clouds beside it, in a
/// subfolder or in a zip archive, named KEY (a 64-bit number, or a letter and an index) or pc_N: the N-th
/// by key, or as in keys.csv (`key,file,stamp_ns`, no header). Ids in the graph may lack the robot's
/// character if all of them belong to one robot, which options.robot_character or the names of the clouds
/// give. Closures in the graph are kept, like those of a mission folder. Nodes under capital letters or 'u'
/// without clouds and edges among themselves are landmarks. ranges.csv, gravity.csv and odometry.csv are
/// those of a mission folder. The truth is in ground_truth/, inside or beside. A dump of hdl_graph_slam is
/// such a folder, with clouds in NUMBER/cloud.pcd and ids and stamps in NUMBER/data; edges to the fixed node
/// of special_nodes.csv, which is not a key frame, become priors.
///
/// **Bags**: bags of ROS 1, or of ROS 2 in MCAP or SQLite (.db3), or a folder's bags, as one recording.
/// Messages are selected by type: KeyedScan, PoseGraph and CommNodeStatus of pose_graph_msgs,
/// silvus_msgs/SilvusStreamscape; nav_msgs/Odometry in a bag without these or in ground_truth/ is the truth,
/// nearest in time. Nodes have the pose of their first message. Artifacts and radio anchors are landmarks
/// under their own keys; a landmark with ranges alone needs three of them and gets a prior of 10 m. Ranges
/// and gravity (of which the first number of the covariance is the sigma) become factors. Without any of
/// these, make_key_frame_mission() makes key frames of nav_msgs/Odometry or geometry_msgs/PoseStamped and
/// sensor_msgs/PointCloud2. Of several such topics it takes the one in the options, else the one with the
/// most messages. Each namespace is a robot. Needs a build with librosbag-storage; for ROS 2 with SQLite,
/// zstd and lz4. Scans stay in the bags, which must not change. Mission::topics lists all topics.
///
/// **LAMP's saved map**: a zip archive with keys.csv, pc_N.pcd and pose_graph.bag, or the same unpacked.
///
/// **The data set's folder**: rosbag/ if this build reads bags, else g2o_pcd/; with ground_truth/.
///
/// **Sweeps with poses**: a sequence of KITTI's odometry data (velodyne/, times.txt, calib.txt, poses of the
/// camera), or clouds named by their stamps beside a trajectory in TUM format. They become key frames, see
/// choose_key_frames(). options.poses names another file with the poses.
///
/// **Files of other programs**: GLIM's submaps, key frames of FAST-LIO-SAM-QN, sessions of Voxel-SLAM, poses
/// and clouds of HBA, local maps of KISS-SLAM, pose graphs of Open3D. docs/formats.md lists for each
/// the data that are read, and counts of the rest.
///
/// Counted: "no prior given", "no stamps given", "stamps not ascending", "node without scan", "scan without
/// node", "repeated scan", "node without ground truth", "ground truth without node", "reference without
/// node", "radio reading without node", "stamp without node", "foreign file in scans", and what
/// classify_edges() and the readers of the parts count. Sessions also: "row beyond the common part left out",
/// "unfinished last line left out", "empty file not used", "edge to a missing vertex left out", "session
/// graph not used", "closure of the session's own graph left out", "edge that contradicts the session's
/// odometry left out", "repeated odometry of the session's graph left out", "odometry missing in the
/// session's graph", "odometry taken from the optimised poses", "scans are counted from 1", "scans may be
/// counted from 1". Dumps of hdl_graph_slam also: "edge to a fixed node without key frame, converted to a
/// prior", "fixed node without key frame, treated as an anchor", "edge between fixed nodes left out", "key
/// frame without node left out", "key frame's WORD not used". Bags also: "message cannot be read", "message
/// at time 0 left out", "bag altered in a part that is not read", "node without stamp", "node without usable
/// pose", "edge without node", "edge without pose", "unusable edge", "repeated edge with other numbers",
/// "covariance absent", "unusable covariance", "odometry covariance looks swapped", "odometry not between
/// consecutive nodes", "unusable range factor", "unusable gravity factor", "gravity factor that points up
/// left out", "range factor of a landmark left out", "landmark left out", "landmark with ranges only, given a
/// prior", "edge of unknown type left out", "odometry messages not used", "ground truth of an unknown robot",
/// "topic of unknown encoding left out", "topic without message definition left out", "bag not listed in
/// metadata.yaml left out", "messages missing from the summary", "message of an unknown topic left out",
/// "several topics of poses, one is used", "several topics of clouds, one is used", "clouds assumed to be in
/// the frame whose poses are recorded", "clouds in the frame of the odometry, transformed to the frame of the
/// robot", "frame of clouds changes, the first is used", "empty cloud left out", "odometry pose unusable",
/// "message without stamp, the time of its record is used", "truth in another frame". \throws IoError;
/// ParseError or InputError naming file and line or key; OptionError; StoppedError
[[nodiscard]] LOOPWISE_EXPORT Mission read_mission(const std::filesystem::path& path,
                                                   const MissionOptions& options = {},
                                                   const ProgressCallback& progress = {},
                                                   const StopToken& stop = {});

/// Several sources as one mission. Bags and folders of bags are one recording. Otherwise each must be a
/// mission by read_mission(): its robots get the next letters, with the keys a0, a1, …; b0, b1, … in the
/// given order. The robot of a source with one robot is named after the source, others SOURCE_ROBOT. Poses
/// are in the common frame, or options.frames names a file with the pose T_common_source of each: CSV with
/// the header `source,x,y,z,qx,qy,qz,qw` or `source,x,y,z,yaw` (rad, frames are level), where source is the
/// name of its folder or file, or TUM, with the number of the source from 0 as the stamp. CSV may continue
/// with the sigmas `sx,sy,sz,srx,sry,srz` or `sx,sy,sz,syaw` of the first key frame's pose: they replace the
/// source's priors. A single source is read unchanged. Landmarks get the keys A0, A1, …; B0, …, separate for
/// each source. Sources that each begin at an origin of their own count as "joined without a frame". \throws
/// as read_mission(); InputError naming a source that the file lacks
[[nodiscard]] LOOPWISE_EXPORT Mission read_missions(const std::vector<std::filesystem::path>& paths,
                                                    const MissionOptions& options = {},
                                                    const ProgressCallback& progress = {},
                                                    const StopToken& stop = {});

/// Writes a mission folder scan by scan. mission.json comes last: an interrupted folder is not read as a
/// mission.
class LOOPWISE_EXPORT MissionWriter {
 public:
  /// Makes the folder. \throws IoError if it exists and is not empty, or cannot be made.
  explicit MissionWriter(std::filesystem::path folder, PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

  /// Writes scans/KEY.pcd. Calls with different keys may come from several threads. \throws IoError
  void add_scan(Key key, const PointCloud& cloud) const;

  /// Writes all other files; `mission.scans`, `path`, `kind` and `problems` are not used. \throws IoError;
  /// InputError if the mission contradicts itself (a node without a robot, provenance that is not JSON)
  void finish(const Mission& mission) const;

 private:
  std::filesystem::path folder_;
  PcdEncoding encoding_;
};

/// Writes a whole mission with the scans of `mission.scans`, one at a time in memory.
LOOPWISE_EXPORT void write_mission(const std::filesystem::path& folder, const Mission& mission,
                                   PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

}  // namespace loopwise
