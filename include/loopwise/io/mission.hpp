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

/// What a mission was read from.
enum class MissionKind {
  kMission,  ///< A folder with mission.json.
  kSession,  ///< A folder with Scans/ and poses in KITTI's form, as single-robot SLAM programs write it.
  kG2o,      ///< A g2o file alone: no scans.
  kG2oPcd,   ///< A folder with a g2o file and clouds, as the NeBula multi-robot data set has them.
  kBags,     ///< ROS 1 bags of LAMP's messages.
  kLampZip,  ///< A map that LAMP's base station saved.
  kJoined,   ///< Several missions of one robot each.
  kRun,      ///< A folder that a replay wrote: its graph with the closures, without scans.
};
[[nodiscard]] inline EnumNames<MissionKind> enum_names(MissionKind) {
  return {{MissionKind::kMission, "mission"}, {MissionKind::kSession, "session"},
          {MissionKind::kG2o, "g2o"},         {MissionKind::kG2oPcd, "g2o_pcd"},
          {MissionKind::kBags, "rosbag"},     {MissionKind::kLampZip, "lamp_zip"},
          {MissionKind::kJoined, "joined"},   {MissionKind::kRun, "run"}};
}

/// How the 36 numbers of an odometry edge's covariance in a bag are ordered. LAMP's code stores rotation
/// first; some of its odometry sources hand on the covariance of nav_msgs/Odometry, which has translation
/// first.
enum class CovarianceOrder { kRotationFirst, kTranslationFirst };
[[nodiscard]] inline EnumNames<CovarianceOrder> enum_names(CovarianceOrder) {
  return {{CovarianceOrder::kRotationFirst, "rotation_first"},
          {CovarianceOrder::kTranslationFirst, "translation_first"}};
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
  /// True poses, by which estimates are judged. Empty if not known. set_truth() takes them from files.
  std::map<Key, Eigen::Isometry3d> ground_truth;
  /// ground_truth stands in another frame and was laid on the mission: only aligned errors mean something.
  bool truth_is_aligned = false;
  std::string truth_file;  ///< What set_truth() took ground_truth from; empty if it was recorded.
  /// Poses that another program computed, such as a session's own optimised poses. They are to compare with,
  /// never the truth. Empty if no such poses are recorded.
  std::map<Key, Eigen::Isometry3d> reference;
  std::vector<CommunicationGap> gaps;  ///< By robot, then begin.
  std::vector<RadioReading> radio;     ///< In the order of the file.
  std::vector<BeaconDrop> beacons;     ///< In the order of the file.
  /// Of several sources joined: by robot, the number of the source that it comes from. Else empty.
  std::vector<std::size_t> robot_sources;
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
  /// As parse_robots() takes it. Empty: as mission.json says, or one robot per character of the keys. Groups
  /// of landmarks are known from the files and not listed.
  std::string robots;
  /// A file with two keys a line, in any order: the edges that are odometry. Empty: those between neighbours
  /// of one robot, see classify_edges().
  std::string odometry;
  double scan_cache_mb = 512.0;
  BinLayout bin_layout = BinLayout::kAuto;
  /// Sigmas of odometry that has no information of its own, as that made from a session's poses: per metre of
  /// the step, but never below the minimum.
  double odometry_sigma_m_per_m = 0.02;
  double odometry_sigma_rad_per_m = 0.002;
  double odometry_min_sigma_m = 0.01;
  double odometry_min_sigma_rad = 0.001;
  /// Sigmas of the prior that a mission without any is given, x y z and roll pitch yaw. Those of LAMP.
  std::vector<double> prior_sigmas = {0.0016, 0.0016, 0.0016, 0.041, 0.041, 0.00041};
  double node_interval_s = 2.0;
  /// A letter: whose nodes the small ids of a g2o file beside clouds are. Empty: as the clouds' names say.
  std::string robot_character;
  CovarianceOrder odometry_covariance_order = CovarianceOrder::kRotationFirst;
  /// A true pose whose stamp is further from a node's is not its truth.
  double truth_max_time_difference_s = 1.0;
  /// File with the pose of each joined mission's frame in the common one. Empty: they stand in it already.
  /// The words "auto" and "common" of the command line are not for read_missions(), see read_team().
  std::string frames;
  /// Joined missions begin at the same moment, whenever they were recorded.
  bool start_together = false;
  /// A measurement that would be repaired, guessed or left out is an error, see Problem::altered.
  bool strict = false;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("robots", self.robots, any_value(),
          "Robots and their keys, as \"0-624,625-1249\" or \"husky=0-624,spot=625-1249\" or \"a,b\"; "
          "empty: as the files say.");
    field(
        "odometry", self.odometry, any_value(),
        "Which edges are odometry: a file with two keys a line; empty: those between neighbours of a robot.");
    field("scan_cache_mb", self.scan_cache_mb, at_least(0.0), "Memory for scans kept after use, MB.");
    field("bin_layout", self.bin_layout, any_value(),
          "What a point is made of in .bin files, which have no header: auto (xyzi if it looks like it), "
          "xyz, xyzi "
          "(KITTI), xyzir (nuScenes), xyzirt, xyz_double, xyzi_double, or a record of HeLiPR.");
    field("odometry_sigma_m_per_m", self.odometry_sigma_m_per_m, at_least(0.0),
          "Sessions, edges without information: translation sigma of an odometry edge per metre of its "
          "length.");
    field("odometry_sigma_rad_per_m", self.odometry_sigma_rad_per_m, at_least(0.0),
          "Sessions, edges without information: rotation sigma of an odometry edge per metre of its length.");
    field("odometry_min_sigma_m", self.odometry_min_sigma_m, above(0.0),
          "Sessions, edges without information: least translation sigma of an odometry edge, m.");
    field("odometry_min_sigma_rad", self.odometry_min_sigma_rad, above(0.0),
          "Sessions, edges without information: least rotation sigma of an odometry edge, rad.");
    field("prior_sigmas", self.prior_sigmas, above(0.0),
          "Sigmas of the prior given to a mission without one: x, y, z in m, roll, pitch, yaw in rad.");
    field("node_interval_s", self.node_interval_s, above(0.0),
          "Time between a robot's nodes where the files hold no stamps, s.");
    field("robot_character", self.robot_character, any_value(),
          "g2o_pcd folders: letter of the robot whose ids in the graph lack it; empty: as the clouds say.");
    field("odometry_covariance_order", self.odometry_covariance_order, any_value(),
          "Bags: what comes first in the covariances of odometry.");
    field("truth_max_time_difference_s", self.truth_max_time_difference_s, at_least(0.0),
          "Bags: a node's true pose is the nearest in time, at most this far, s; files given as truth: the "
          "longest gap between stamps that is interpolated.");
    field("frames", self.frames, any_value(),
          "Several missions as one: file with the pose of each one's frame in the common frame.");
    field("start_together", self.start_together, any_value(),
          "Several missions as one: all begin at the same moment.");
    field("strict", self.strict, any_value(),
          "A measurement that would be repaired, guessed or left out is an error.");
  }
};

/// classify_edges() as the options say. Edges of the numbers `without_information`, for which a file has none
/// (G2oFile::without_information), get it first: odometry_information() where odometry may be, between
/// neighbours or as listed, others 0.1 m and 0.02 rad. \throws IoError; ParseError naming the line of the
/// file; InputError naming the file and a pair that no edge joins, or that ends at a landmark
LOOPWISE_EXPORT Problems classify_edges(PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                                        const std::vector<std::size_t>& without_information = {});

/// The edges that are odometry, as MissionOptions::odometry takes them, of a graph whose edges are
/// classified; empty if neighbours tell it. For odometry.csv beside a graph that is written.
[[nodiscard]] LOOPWISE_EXPORT std::string odometry_list(const PoseGraph& graph, const Robots& robots);

/// Information of an odometry edge over a step T, by the session sigmas of the options.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d odometry_information(const Eigen::Isometry3d& T,
                                                            const MissionOptions& options = {});

/// What lies at the path: a file by what it begins with, a folder by what it holds. The data set's own
/// folder, with rosbag/ or g2o_pcd/ in it, counts as what read_mission() takes from it. \throws InputError
/// saying what was looked for if it is nothing that read_mission() reads; IoError if it does not exist.
[[nodiscard]] LOOPWISE_EXPORT MissionKind mission_kind(const std::filesystem::path& path);

/// Reads a mission folder (or its mission.json), a session folder, a g2o file, a g2o_pcd folder, ROS 1 bags,
/// a map saved by LAMP, or the data set's own folder. Scans are found, not read.
///
/// **Mission folder**: the files below; all but the first two may be missing. Keys are decimal numbers of 64
/// bits (or a letter and an index), in JSON as text.
///
/// - mission.json: `{"format": "loopwise-mission", "version": 1, "name", "frame", "clock": {"start_ns"},
///   "robots": [{"name", "first", "last", "landmarks"}], "communication_gaps": [{"robot", "begin_s",
///   "end_s"}], "provenance": {...}, "files": {"graph", "stamps", "priors", "scans", "radio", "beacons",
///   "ranges", "gravity", "odometry", "ground_truth", "reference"}}`; only format and version must be there,
///   other keys are errors, and `files` may not lead out of the folder
/// - graph.g2o
/// - stamps.csv: `key,stamp_ns`, a row for every node
/// - priors.csv: `key,x,y,z,qx,qy,qz,qw,sx,sy,sz,srx,sry,srz`, sigmas in m, rad
/// - scans/KEY.pcd, or another form of read_cloud()
/// - radio.csv: `key,beacon,transmit_dbm,receiver,receive_dbm`, an empty power was not received
/// - beacons.csv: `beacon,robot,drop_key,stamp_ns`
/// - ranges.csv: `from,to,range_m,sigma_m`
/// - gravity.csv: `key,x,y,z,sigma_rad`, the direction of gravity (-z of the common frame) in the body frame
/// - odometry.csv: as MissionOptions::odometry takes it, which comes first
/// - ground_truth.g2o: vertices alone
/// - reference.g2o: the same, poses that another program computed
///
/// A mission without priors gets one at the first node of each robot, where it stands: the robots started
/// from a common frame.
///
/// **Session folder**: rows of the poses file are the nodes 0 … n−1. Odometry comes from odom_poses.txt, else
/// from the edges (i, i+1) of singlesession_posegraph.g2o, else from optimized_poses.txt: consecutive poses,
/// information by the options' sigmas (a g2o edge may bring its own). Other edges of that g2o file are left
/// out and counted: closures are ours to find. optimized_poses.txt, where present, is the reference:
/// another program's result, not the truth. Stamps are in times.txt, seconds; scans in Scans/NUMBER.EXT, from
/// 0 or from 1. The first node gets a prior. Of a session that was stopped while it was saved, the rows that
/// all files have are read.
///
/// **g2o file**: the graph; its first node gets a prior if the file has none.
///
/// **g2o_pcd folder**: result.g2o, else the only g2o file that is not the truth, and clouds beside it, in a
/// subfolder or in a zip archive, named KEY (a number of 64 bits, or a letter and an index) or pc_N: the N-th
/// by key, or as keys.csv says (`key,file,stamp_ns`, no header). Ids in the graph may lack the robot's
/// character if they are of one robot, which options.robot_character or the clouds' names tell. Closures in
/// the graph are kept, as those of a mission folder. Nodes under capital letters or 'u' that have neither
/// clouds nor edges among themselves are landmarks. ranges.csv, gravity.csv and odometry.csv are those of a
/// mission folder. The truth is in ground_truth/, inside or beside. A dump of hdl_graph_slam is such a
/// folder, with clouds in NUMBER/cloud.pcd and ids and stamps in NUMBER/data; edges to the fixed node that is
/// no key frame, as special_nodes.csv says, become priors.
///
/// **Bags**: a bag, or a folder's bags, as one recording. Messages are told apart by type: KeyedScan,
/// PoseGraph and CommNodeStatus of pose_graph_msgs, silvus_msgs/SilvusStreamscape; nav_msgs/Odometry in a bag
/// without these or in ground_truth/ is the truth, nearest in time. Nodes stand where the first message put
/// them. Artifacts and radio anchors are landmarks under their own keys; one that only ranges hold needs
/// three and gets a prior of 10 m. Ranges and gravity (of which the first number of the covariance is the
/// sigma) become factors. Needs a build with librosbag-storage. Scans stay in the bags, which must not
/// change.
///
/// **LAMP's saved map**: a zip archive with keys.csv, pc_N.pcd and pose_graph.bag, or the same unpacked.
///
/// **The data set's folder**: rosbag/ if this build reads bags, else g2o_pcd/; with ground_truth/.
///
/// Counted: "no prior given", "no stamps given", "stamps not ascending", "node without scan", "scan without
/// node", "repeated scan", "node without ground truth", "ground truth without node", "reference without
/// node", "radio reading without node", "stamp without node", "foreign file in scans", and what
/// classify_edges() and the readers of the parts count. Sessions also: "row beyond the common part left out",
/// "unfinished last line left out", "empty file not used", "edge to a missing vertex left out", "session
/// graph not used", "closure of the session's own graph left out", "edge that contradicts the session's
/// odometry left out", "repeated odometry of the session's graph left out", "odometry missing in the
/// session's graph", "odometry taken from the optimised poses", "scans are counted from 1", "scans may be
/// counted from 1". Dumps of hdl_graph_slam also: "edge to a fixed node that is no key frame made a prior",
/// "fixed node without key frame taken for an anchor", "edge between fixed nodes left out", "key frame
/// without node left out", "key frame's WORD not used". Bags also: "message cannot be read", "message at time
/// 0 left out", "bag altered in a place that is not read", "node without stamp", "node without usable pose",
/// "edge without node", "edge without pose", "unusable edge", "repeated edge with other numbers", "covariance
/// absent", "unusable covariance", "odometry covariance looks swapped", "odometry not between consecutive
/// nodes", "unusable range factor", "unusable gravity factor", "gravity factor that points up left out",
/// "range factor of a landmark left out", "landmark left out", "landmark by ranges alone gets a prior", "edge
/// of unknown type left out", "odometry messages not used", "ground truth of an unknown robot". \throws
/// IoError; ParseError or InputError naming file and line or key; OptionError; StoppedError
[[nodiscard]] LOOPWISE_EXPORT Mission read_mission(const std::filesystem::path& path,
                                                   const MissionOptions& options = {},
                                                   const ProgressCallback& progress = {},
                                                   const StopToken& stop = {});

/// Several sources as one mission. Bags and folders of bags are one recording. Otherwise each must be a
/// mission by read_mission(): its robots get the next letters, with the keys a0, a1, …; b0, b1, … in the
/// order given. The robot of a source that has one alone is named after it, others SOURCE_ROBOT. Poses stand
/// in the common frame as they are, or options.frames names a file with the pose T_common_source of each: CSV
/// with the header `source,x,y,z,qx,qy,qz,qw` or `source,x,y,z,yaw` (rad, frames are level), where source is
/// the name of its folder or file, or TUM, where the number of the source from 0 stands for the stamp. CSV
/// may go on with the sigmas `sx,sy,sz,srx,sry,srz` or `sx,sy,sz,syaw` of the first key frame's pose: they
/// replace the source's priors. One source is read as it is. Landmarks get the keys A0, A1, …; B0, …, each
/// source its own. Sources that each begin at an origin of their own count as "joined without a frame".
/// \throws as read_mission(); InputError naming a source that the file lacks
[[nodiscard]] LOOPWISE_EXPORT Mission read_missions(const std::vector<std::filesystem::path>& paths,
                                                    const MissionOptions& options = {},
                                                    const ProgressCallback& progress = {},
                                                    const StopToken& stop = {});

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
