// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Common parts of the readers of all kinds of missions. Private to io.
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

/// Marks a mission folder until mission.json is written. Its graph and clouds look like those of a g2o_pcd
/// folder.
inline constexpr const char* kUnfinished = ".unfinished";

/// Problem of joined missions that each begin at their own origin.
inline constexpr const char* kWithoutFrame = "joined without a frame";

/// Files of ranges, gravity and the list of odometry beside a graph.
inline constexpr const char* kRanges = "ranges.csv";
inline constexpr const char* kOdometry = "odometry.csv";
inline constexpr const char* kGravity = "gravity.csv";

/// Stamps must be within ±4.6e18 ns (the year 2115), so that differences never overflow.
[[nodiscard]] bool stamp_in_range(std::int64_t stamp_ns);

/// The robots of the options with the landmarks of `otherwise`, or `otherwise` if the options have no robots.
/// \throws InputError naming a node without a robot; OptionError
[[nodiscard]] Robots robots_of(const PoseGraph& graph, const MissionOptions& options,
                               const Robots& otherwise);

/// Whether LAMP uses the character for landmarks. Artifacts have the capital letter of their robot, and
/// anchors of ultra-wideband radios have a 'u'.
[[nodiscard]] bool is_landmark_character(char character);

/// The same robots, with those of these characters marked as landmarks. Artifacts are named after their
/// robot, "husky3_artifacts", and anchors are named "uwb_anchors".
[[nodiscard]] Robots with_landmarks(const Robots& robots, const std::set<char>& characters);

/// Keys of all nodes but landmarks, in order.
[[nodiscard]] std::vector<Key> key_frames(const PoseGraph& graph, const Robots& robots);

/// The graph with these priors and stamps (0 for nodes without a stamp).
[[nodiscard]] PoseGraph with_stamps(const PoseGraph& graph, const Stamps& stamps,
                                    const std::vector<PriorFactor>& priors);

/// The same with edges that are classified by the options. Counts problems of the odometry.
[[nodiscard]] PoseGraph assemble(const PoseGraph& graph, const Stamps& stamps,
                                 const std::vector<PriorFactor>& priors, const Robots& robots,
                                 const MissionOptions& options, Problems& problems,
                                 const std::vector<std::size_t>& without_information = {});

/// The odometry edges of a graph where neighbouring keys do not define them.
struct OdometryList {
  std::string text;      ///< For MissionOptions::odometry; empty if neighbours define the odometry.
  std::size_t lost = 0;  ///< Edges that get another kind even with the list.
};
[[nodiscard]] OdometryList odometry_list(const PoseGraph& graph, const Robots& robots);

/// First sightings of landmarks: the earliest stamp of the nodes that an edge or a range connects to each.
/// Landmarks without such nodes are not listed.
[[nodiscard]] Stamps first_sightings(const PoseGraph& graph, const Robots& robots, const Stamps& stamps);

/// Stamps from 0 at the options' interval, in the order of each robot's keys. A landmark has the stamp of its
/// first sighting.
[[nodiscard]] Stamps regular_stamps(const PoseGraph& graph, const Robots& robots,
                                    const MissionOptions& options);

/// The node with the smallest key of each robot, in the order of the robots. Landmarks and robots without
/// nodes are left out.
[[nodiscard]] std::vector<Key> first_nodes(const PoseGraph& graph, const Robots& robots);

/// A prior with the options' sigmas at the node's pose.
[[nodiscard]] PriorFactor default_prior(const PoseGraph& graph, Key key, const MissionOptions& options);

/// Adds a default prior at the first node of each robot that has no prior. Counted if there are several
/// robots, because a common frame is then a guess.
void complete_priors(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, std::vector<PriorFactor>& priors, Problems& problems);

/// Gives nodes without a stamp one between those of their neighbours along the robot's keys, and counts them.
/// A landmark without a stamp gets that of its first sighting.
void complete_stamps(const PoseGraph& graph, const Robots& robots, const MissionOptions& options,
                     const std::string& name, Stamps& stamps, Problems& problems);

/// Information of uncorrelated x y z roll pitch yaw.
[[nodiscard]] Matrix6d information_of_sigmas(const double* sigmas);

/// Default information of a closure: 0.1 m and 0.02 rad.
[[nodiscard]] Matrix6d closure_information();

/// Whether a direction of gravity, in the frame of a node of the graph, points up at its pose: some programs
/// write the reading of an accelerometer at rest. kGravityUp reports that such a factor is left out.
[[nodiscard]] bool points_up(const PoseGraph& graph, Key key, const Eigen::Vector3d& direction);
constexpr const char* kGravityUp = "gravity factor that points up left out";

/// Adds the ranges or the gravity factors of a CSV file. \throws ParseError naming the line; IoError
void read_ranges(const std::filesystem::path& file, PoseGraph& graph);
void read_gravity(const std::filesystem::path& file, PoseGraph& graph, Problems& problems);
/// Contents of files for the two readers. \throws InputError naming a gravity factor whose reference is not
/// -z, which the file cannot store
[[nodiscard]] std::string ranges_text(const PoseGraph& graph);
[[nodiscard]] std::string gravity_text(const PoseGraph& graph);

/// The name of a cloud without its extensions. nuScenes writes two: NUMBER.pcd.bin.
[[nodiscard]] std::string cloud_stem(const std::filesystem::path& file);

/// Scan files of a folder by key. `key_of` finds the key in a name without its extension. Counts foreign
/// files, and further files of a key; the first one by name is used.
[[nodiscard]] std::map<Key, std::filesystem::path> find_scans(
    const std::filesystem::path& folder, const std::function<std::optional<Key>(const std::string&)>& key_of,
    Problems& problems);

/// Counts nodes without a scan and scans without a node, unless there is no scan at all. `where` names the
/// scan of a key.
void count_scans(Mission& mission, const std::vector<Key>& keys,
                 const std::function<std::string(Key)>& where);

/// Memory for scans according to the options.
[[nodiscard]] std::size_t scan_bytes(const MissionOptions& options);

/// Makes the scan store. Counts nodes without a scan and scans without a node, unless there is no scan at
/// all.
void set_scans(Mission& mission, std::map<Key, std::filesystem::path> files, const MissionOptions& options);
/// The same for scans that `source` reads.
void set_scans(Mission& mission, const std::vector<Key>& keys, ScanStore::CloudSource source,
               const std::function<std::string(Key)>& where, const MissionOptions& options);

/// Sets the truth. Counts nodes without truth, and counts and drops truth without a node.
void set_ground_truth(Mission& mission, std::map<Key, Eigen::Isometry3d> truth);
/// Aligns the truth with the nodes if it does not begin at them (0.5 m, 0.1 rad), because it is in another
/// frame then. Uses least squares of the positions, or the first pose if there are too few. Counted.
void align_truth_to_nodes(Mission& mission, const std::string& source);
/// Sets the reference. Drops and counts poses without a node.
void set_reference(Mission& mission, std::map<Key, Eigen::Isometry3d> reference);

/// Sets start_ns to the earliest stamp and counts stamps that do not ascend along a robot's keys.
void check_stamps(Mission& mission);

/// The name of a folder or, without its extension, of a file.
[[nodiscard]] std::string name_of(const std::filesystem::path& path);

/// The name of a recording. A folder with a generic name gets the name of its parent.
[[nodiscard]] std::string recording_name(const std::filesystem::path& path);

/// A provenance with the kind of the mission and the names of its sources.
[[nodiscard]] std::string provenance_of(MissionKind kind, const std::vector<std::string>& sources);

/// Entries of a folder by name, without those that begin with a dot. \throws IoError
[[nodiscard]] std::vector<std::filesystem::path> entries(const std::filesystem::path& folder);

/// Whether the path exists. \throws IoError if that cannot be determined, for example for a name that is too
/// long
[[nodiscard]] bool exists(const std::filesystem::path& path);
/// \throws IoError if the path exists and is not an empty folder
void require_empty(const std::filesystem::path& folder);

/// Whether the file begins with these bytes. \throws IoError
[[nodiscard]] bool begins_with(const std::filesystem::path& file, std::string_view bytes);

/// Location of the truth for a folder: in the folder, or in a folder ground_truth beside it.
struct TruthFiles {
  std::filesystem::path g2o;                ///< Empty if there is no such file.
  std::vector<std::filesystem::path> bags;  ///< Only without g2o.
};
[[nodiscard]] TruthFiles find_truth(const std::filesystem::path& folder);
/// Whether the path is one that find_truth() would look for.
[[nodiscard]] bool is_truth(const std::filesystem::path& path);

/// Poses of a g2o file's vertices.
[[nodiscard]] std::map<Key, Eigen::Isometry3d> read_truth(const std::filesystem::path& g2o,
                                                          Problems& problems);

/// The graph of a g2o_pcd folder; empty if the folder has no graph. \throws InputError if there are several
[[nodiscard]] std::filesystem::path g2o_of_folder(const std::filesystem::path& folder);

/// Progress and stop requests of a reader.
struct Work {
  const ProgressCallback& progress;
  const StopToken& stop;
};

[[nodiscard]] Mission read_session(const std::filesystem::path& folder, const MissionOptions& options);
[[nodiscard]] Mission read_mission_folder(const std::filesystem::path& folder, const MissionOptions& options);
[[nodiscard]] Mission read_g2o_pcd(const std::filesystem::path& folder, const MissionOptions& options,
                                   const Work& work);
/// Reads files, and folders of files, as one recording.
[[nodiscard]] Mission read_bags(const std::vector<std::filesystem::path>& paths,
                                const MissionOptions& options, const Work& work);
/// Adds the truth from bags to a mission of another source. Counted if this build reads no bags.
void read_bag_truth(Mission& mission, const std::vector<std::filesystem::path>& bags,
                    const MissionOptions& options, const Work& work);
/// Reads the archive, or a folder of its contents.
[[nodiscard]] Mission read_lamp_save(const std::filesystem::path& path, const MissionOptions& options,
                                     const Work& work);
[[nodiscard]] Mission join_missions(const std::vector<Mission>& missions, const MissionOptions& options);

}  // namespace loopwise::parts
