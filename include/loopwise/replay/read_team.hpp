// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Reads and joins missions whose robots or sessions have no common frame yet.
#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/joining/join.hpp>
#include <loopwise/replay/config.hpp>

namespace loopwise {

/// Components and result of find_team_frames().
struct TeamFrames {
  std::vector<JoinComponent> components;  ///< Sources or robots whose frames were searched.
  JoinResult result;                      ///< The frames, by component.
};

/// Components of a mission that each have one frame. These are its sources if it was joined from several,
/// otherwise its robots. Landmarks and nodes without scans are left out.
[[nodiscard]] LOOPWISE_EXPORT std::vector<JoinComponent> frames_to_find(const Mission& mission);

/// Finds the frames of a mission's components, see frames_to_find().
/// \param mission its components each have their own frame, z up
/// \param config of registration and joining
/// \param threads that register pairs
/// \param progress is called while places are described and pairs registered
/// \param stop ends the search: StoppedError
/// \throws InputError naming a component without scans; OptionError; StoppedError
[[nodiscard]] LOOPWISE_EXPORT TeamFrames find_team_frames(const Mission& mission, const Config& config,
                                                          ThreadPool& threads,
                                                          const ProgressCallback& progress = {},
                                                          const StopToken& stop = {});

/// The mission with the largest group of joined components in the frame of its first component. The closures
/// between them are edges of the graph. The first component keeps its priors. Every robot of the others gets
/// a prior at its first key frame with ten times the standard deviations of its frame. So the closures
/// determine the poses, and the path to them does not count twice. Components outside of the group are left
/// out and counted. \throws InputError with the reason for each component if no two are joined
[[nodiscard]] LOOPWISE_EXPORT Mission placed_team(const Mission& mission, const TeamFrames& frames);

/// A mission of sources in a common frame.
struct Team {
  Mission mission;                   ///< As from read_missions(), in a common frame.
  std::optional<TeamFrames> frames;  ///< Present if the frames were found from the scans.
};

/// read_missions() with two more words for MissionOptions::frames: "auto" finds the frames of the sources, or
/// of the robots of a single source, from the scans; "common" uses the poses unchanged, without a warning.
/// \param paths of the sources
/// \param config of reading, registration and joining
/// \param find also find frames if MissionOptions::frames is empty and several sources with scans begin at
/// their own origin
/// \param threads that register pairs
/// \param progress is called while sources are read and frames are searched
/// \param stop ends it early: StoppedError
/// \throws as read_missions(), find_team_frames() and placed_team()
[[nodiscard]] LOOPWISE_EXPORT Team read_team(const std::vector<std::filesystem::path>& paths,
                                             const Config& config, bool find, ThreadPool& threads,
                                             const ProgressCallback& progress = {},
                                             const StopToken& stop = {});

}  // namespace loopwise
