// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The pose graph of a file, of a run, or of a recording.
#pragma once

#include <filesystem>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// Whether a path names a recording of any kind, by its extension, instead of a single file of poses or of a
/// graph. Folders are recordings.
[[nodiscard]] LOOPWISE_EXPORT bool is_recording(const std::filesystem::path& path);

/// The graph that a replay wrote to this folder, see write_run_folder(); empty if there is no such graph.
[[nodiscard]] LOOPWISE_EXPORT std::filesystem::path graph_of_run(const std::filesystem::path& folder);

/// A graph with the kinds of its edges.
struct SourceGraph {
  PoseGraph graph;    ///< Nodes, edges and priors, without the default priors of a mission for a file or run.
  Problems problems;  ///< Tolerable flaws of the source.
};

/// Reads the graph of a g2o file or of a folder that a replay wrote, with all of its closures and no further
/// priors, or the graph of any recording as read_mission() does. Edges of a file are classified by the
/// options; those of a run also by the odometry.csv beside its graph, unless the options name another list.
/// \throws as read_g2o(), classify_edges() and read_mission()
[[nodiscard]] LOOPWISE_EXPORT SourceGraph read_graph(const std::filesystem::path& path,
                                                     const MissionOptions& options = {},
                                                     const ProgressCallback& progress = {},
                                                     const StopToken& stop = {});

}  // namespace loopwise
