// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the readers of the different kinds of mission share. Private to io.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <loopwise/io/mission.hpp>

namespace loopwise::parts {

using Stamps = std::unordered_map<Key, std::int64_t>;

/// Lies in a mission folder until mission.json does: its graph and clouds look like those of a g2o_pcd
/// folder.
inline constexpr const char* kUnfinished = ".unfinished";

/// Problem of joined missions that each begin at an origin of their own.
inline constexpr const char* kWithoutFrame = "joined without a frame";

/// Files of ranges, gravity and the list of odometry beside a graph.
inline constexpr const char* kRanges = "ranges.csv";
inline constexpr const char* kOdometry = "odometry.csv";
inline constexpr const char* kGravity = "gravity.csv";

/// Stamps are held to ±4.6e18 ns (the year 2115), so that differences never overflow.
[[nodiscard]] bool stamp_in_range(std::int64_t stamp_ns);

/// options.robots if given, with the landmarks of `otherwise`, else `otherwise`. \throws InputError naming a
/// node that no robot owns; OptionError
[[nodiscard]] Robots robots_of(const PoseGraph& graph, const MissionOptions& options,
                               const Robots& otherwise);

/// Whether LAMP gives such keys to what robots saw: artifacts carry the capital letter of their robot,
/// anchors of ultra-wideband radios a 'u'.
[[nodiscard]] bool is_landmark_character(char character);

/// The same, those of these characters marked as landmarks. Artifacts are called after their robot,
/// "husky3_artifacts", anchors "uwb_anchors".
[[nodiscard]] Robots with_landmarks(const Robots& robots, const std::set<char>& characters);

/// Keys of all nodes but landmarks, in order.
[[nodiscard]] std::vector<Key> key_frames(const PoseGraph& graph, const Robots& robots);

/// The graph with these stamps (0 where none) and priors.
[[nodiscard]] PoseGraph with_stamps(const PoseGraph& graph, const Stamps& stamps,
                                    const std::vector<PriorFactor>& priors);

/// The same, its edges classified as the options say, and flaws of the odometry counted.
[[nodiscard]] PoseGraph assemble(const PoseGraph& graph, const Stamps& stamps,
                                 const std::vector<PriorFactor>& priors, const Robots& robots,
                                 const MissionOptions& options, Problems& problems,
                                 const std::vector<std::size_t>& without_information = {});

/// Which edges are odometry, where neighbours do not tell it.
struct OdometryList {
  std::string text;      ///< As MissionOptions::odometry takes it; empty if neighbours tell it.
  std::size_t lost = 0;  ///< Edges that get another kind even by the list.
};
[[nodiscard]] OdometryList odometry_list(const PoseGraph& graph, const Robots& robots);

/// When landmarks were first seen: the earliest of the stamps of the nodes that an edge or a range ties to
/// each. Those tied to none are not listed.
[[nodiscard]] Stamps first_sightings(const PoseGraph& graph, const Robots& robots, const Stamps& stamps);

/// Stamps at the options' interval in the order of each robot's keys, from 0. Landmarks have that of their
/// first sighting.
[[nodiscard]] Stamps regular_stamps(const PoseGraph& graph, const Robots& robots,
                                    const MissionOptions& options);

/// Nodes with the smallest key of each robot, in the order of the robots; robots without nodes, and
/// landmarks, have none.
[[nodiscard]] std::vector<Key> first_nodes(const PoseGraph& graph, const Robots& robots);

/// A prior with the options' sigmas where the node stands.
[[nodiscard]] PriorFactor default_prior(const PoseGraph& graph, Key key, const MissionOptions& options);

/// Adds a default prior at the first node of each robot that has none at any of its nodes. Counted if there
/// are several robots: their frames are then guessed to be one.
void complete_priors(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, std::vector<PriorFactor>& priors, Problems& problems);

/// Gives nodes without stamp one between those of their neighbours along the robot's keys, and counts them;
/// landmarks without stamp that of their first sighting.
void complete_stamps(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, Stamps& stamps, Problems& problems);

/// Information of uncorrelated x y z roll pitch yaw.
[[nodiscard]] Matrix6d information_of_sigmas(const double* sigmas);

/// What a closure without information is worth, 0.1 m and 0.02 rad.
[[nodiscard]] Matrix6d closure_information();

/// Adds the ranges or the gravity factors of a CSV file. \throws ParseError naming the line; IoError
void read_ranges(const std::filesystem::path& file, PoseGraph& graph);
void read_gravity(const std::filesystem::path& file, PoseGraph& graph);
/// What they read. \throws InputError naming a gravity factor whose reference is not -z: no file holds it
[[nodiscard]] std::string ranges_text(const PoseGraph& graph);
[[nodiscard]] std::string gravity_text(const PoseGraph& graph);

/// The name of a cloud without its extensions, of which nuScenes writes two: NUMBER.pcd.bin.
[[nodiscard]] std::string cloud_stem(const std::filesystem::path& file);

/// Scan files of a folder by the key that `key_of` finds in their names (without extension). Counts foreign
/// files and second files of one key, of which the first by name is taken.
[[nodiscard]] std::map<Key, std::filesystem::path> find_scans(
    const std::filesystem::path& folder, const std::function<std::optional<Key>(const std::string&)>& key_of,
    Problems& problems);

/// Counts nodes without scan and scans without node unless there is no scan at all. `where` names a key's
/// scan.
void count_scans(Mission& mission, const std::vector<Key>& keys,
                 const std::function<std::string(Key)>& where);

/// Memory for scans by the options.
[[nodiscard]] std::size_t scan_bytes(const MissionOptions& options);

/// Makes the scan store, and counts nodes without scan and scans without node unless there is no scan at all.
void set_scans(Mission& mission, std::map<Key, std::filesystem::path> files, const MissionOptions& options);
/// The same of scans that `source` reads.
void set_scans(Mission& mission, const std::vector<Key>& keys, ScanStore::CloudSource source,
               const std::function<std::string(Key)>& where, const MissionOptions& options);

/// Counts nodes without truth and the reverse, and drops the latter.
void set_ground_truth(Mission& mission, std::map<Key, Eigen::Isometry3d> truth);
/// Where the truth does not begin at the nodes (0.5 m, 0.1 rad) it is in another frame: it is laid on the
/// nodes, by least squares of the positions or by the first pose where these are too few, and counted.
void lay_truth_on_nodes(Mission& mission, const std::string& source);
/// Drops poses without node, counted.
void set_reference(Mission& mission, std::map<Key, Eigen::Isometry3d> reference);

/// Sets start_ns to the earliest stamp and counts stamps that do not ascend along a robot's keys.
void check_stamps(Mission& mission);

/// The name of a folder or, without its extension, of a file.
[[nodiscard]] std::string name_of(const std::filesystem::path& path);

/// The same of a recording: folders with a generic name go by the name of the folder around
/// them.
[[nodiscard]] std::string recording_name(const std::filesystem::path& path);

/// A provenance that says of what kind the mission was and what its sources were called.
[[nodiscard]] std::string provenance_of(MissionKind kind, const std::vector<std::string>& sources);

/// Entries of a folder by name, those that begin with a dot left out. \throws IoError
[[nodiscard]] std::vector<std::filesystem::path> entries(const std::filesystem::path& folder);

/// Whether there is something of this name. \throws IoError if that cannot be determined, as of a name that
/// is too long
[[nodiscard]] bool exists(const std::filesystem::path& path);
/// \throws IoError if something is there that is no folder, or one with something in it
void require_empty(const std::filesystem::path& folder);

/// Whether the file begins with these bytes. \throws IoError
[[nodiscard]] bool begins_with(const std::filesystem::path& file, std::string_view bytes);

/// Where the truth lies of a folder's data: in it, or in a folder ground_truth beside it.
struct TruthFiles {
  std::filesystem::path g2o;                ///< Empty if there is none.
  std::vector<std::filesystem::path> bags;  ///< Only without g2o.
};
[[nodiscard]] TruthFiles find_truth(const std::filesystem::path& folder);
/// Whether the path is one that find_truth() would look for.
[[nodiscard]] bool is_truth(const std::filesystem::path& path);

/// Poses of a g2o file's vertices.
[[nodiscard]] std::map<Key, Eigen::Isometry3d> read_truth(const std::filesystem::path& g2o,
                                                          Problems& problems);

/// The graph of a g2o_pcd folder; empty if the folder has no graph. \throws InputError if it is not clear
/// which
[[nodiscard]] std::filesystem::path g2o_of_folder(const std::filesystem::path& folder);

/// How a reader says how far it is, and hears that it is to stop.
struct Work {
  const ProgressCallback& progress;
  const StopToken& stop;
};

[[nodiscard]] Mission read_session(const std::filesystem::path& folder, const MissionOptions& options);
[[nodiscard]] Mission read_mission_folder(const std::filesystem::path& folder, const MissionOptions& options);
[[nodiscard]] Mission read_g2o_pcd(const std::filesystem::path& folder, const MissionOptions& options,
                                   const Work& work);
/// Files and folders of them as one recording.
[[nodiscard]] Mission read_bags(const std::vector<std::filesystem::path>& paths,
                                const MissionOptions& options, const Work& work);
/// Adds the truth that bags hold to a mission from elsewhere; counted if this build reads no bags.
void read_bag_truth(Mission& mission, const std::vector<std::filesystem::path>& bags,
                    const MissionOptions& options, const Work& work);
/// The archive, or a folder of its contents.
[[nodiscard]] Mission read_lamp_save(const std::filesystem::path& path, const MissionOptions& options,
                                     const Work& work);
[[nodiscard]] Mission join_missions(const std::vector<Mission>& missions, const MissionOptions& options);

}  // namespace loopwise::parts
