// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What the readers of the different kinds of mission share. Private to io.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <unordered_map>

#include <loopwise/io/mission.hpp>

namespace loopwise::parts {

using Stamps = std::unordered_map<Key, std::int64_t>;

/// Stamps are held to ±4.6e18 ns (the year 2115), so that differences never overflow.
[[nodiscard]] bool stamp_in_range(std::int64_t stamp_ns);

/// options.robots if given, else `otherwise`. \throws InputError naming a node that no robot owns;
/// OptionError
[[nodiscard]] Robots robots_of(const PoseGraph& graph, const MissionOptions& options,
                               const Robots& otherwise);

/// The graph with these stamps (0 where none), priors and robots: edges between consecutive nodes become
/// odometry, those to landmarks sightings.
[[nodiscard]] PoseGraph assemble(const PoseGraph& graph, const Stamps& stamps,
                                 const std::vector<PriorFactor>& priors, const Robots& robots);

/// Stamps at the options' interval in the order of each robot's keys, from 0.
[[nodiscard]] Stamps regular_stamps(const PoseGraph& graph, const Robots& robots,
                                    const MissionOptions& options);

/// Nodes with the smallest key of each robot, in the order of the robots; robots without nodes, and
/// landmarks, have none.
[[nodiscard]] std::vector<Key> first_nodes(const PoseGraph& graph, const Robots& robots);

/// A prior with the options' sigmas where the node stands.
[[nodiscard]] PriorFactor default_prior(const PoseGraph& graph, Key key, const MissionOptions& options);

/// Information of uncorrelated x y z roll pitch yaw.
[[nodiscard]] Matrix6d information_of_sigmas(const double* sigmas);

/// Scan files of a folder by the key that `key_of` finds in their names (without extension). Counts foreign
/// files and second files of one key, of which the first by name is taken.
[[nodiscard]] std::map<Key, std::filesystem::path> find_scans(
    const std::filesystem::path& folder, const std::function<std::optional<Key>(const std::string&)>& key_of,
    Problems& problems);

/// Makes the scan store, and counts nodes without scan and scans without node unless there is no scan at all.
void set_scans(Mission& mission, std::map<Key, std::filesystem::path> files, const MissionOptions& options);

/// Counts nodes without truth and the reverse, and drops the latter.
void set_ground_truth(Mission& mission, std::map<Key, Eigen::Isometry3d> truth);

/// Sets start_ns to the earliest stamp and counts stamps that do not ascend along a robot's keys.
void check_stamps(Mission& mission);

[[nodiscard]] Mission read_session(const std::filesystem::path& folder, const MissionOptions& options);
[[nodiscard]] Mission read_mission_folder(const std::filesystem::path& folder, const MissionOptions& options);

}  // namespace loopwise::parts
