// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/evaluation/closure_statistics.hpp>
#include <loopwise/evaluation/run_history.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Distances of closures from the relative poses of their nodes.
struct ClosureResiduals {
  Statistics translation_m;  ///< m.
  Statistics rotation_rad;   ///< rad.
};

/// Quality of a replay: residuals always, errors with ground truth, differences with a reference.
struct RunEvaluation {
  ClosureStatistics closures;            ///< In the classes of the paper's Table I.
  ClosureResiduals residuals;            ///< Of the closures that the back end kept, against the estimate.
  ClosureResiduals odometry_residuals;   ///< Of the same closures against odometry.
  bool has_reference = false;            ///< The two differences stay empty without.
  TrajectoryErrors odometry_reference;   ///< Difference from the reference, common frame; not an error.
  TrajectoryErrors optimized_reference;  ///< The same of the optimised estimate.
  bool has_truth = false;                ///< The rest stays empty without.
  TrajectoryErrors
      odometry;  ///< In the common frame without alignment, as in the paper; aligned if the truth is.
  TrajectoryErrors optimized;          ///< The same of the optimised estimate.
  TrajectoryErrors odometry_aligned;   ///< After the best rigid motion.
  TrajectoryErrors optimized_aligned;  ///< The same of the optimised estimate.
};

/// Evaluates closures and poses of a replay, by odometry and by the estimate, against the truth if it is
/// known.
[[nodiscard]] LOOPWISE_EXPORT RunEvaluation evaluate_run(const Mission& mission, const ReplayResult& result);

/// Contents of summary.json as indented JSON: candidates, closures, reasons, errors, times, options.
[[nodiscard]] LOOPWISE_EXPORT std::string run_summary_json(const Mission& mission,
                                                           const ReplayOptions& options,
                                                           const ReplayResult& result,
                                                           const RunEvaluation& evaluation);

/// The header and rows of closures.csv.
[[nodiscard]] LOOPWISE_EXPORT std::string closures_csv(const ReplayResult& result);

/// Origin of maps of the graph: the median of its nodes in whole metres, or zero if that is nearer than 10
/// km.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Vector3d map_origin(const PoseGraph& graph);

/// A map and the number of points left out of it.
struct StitchedMap {
  PointCloud cloud;   ///< Relative to map_origin().
  Problems problems;  ///< Points too far from their sensor.
};

/// The scans of the graph's nodes at its poses, thinned to one point per voxel. Scans are read one at a time.
/// \param graph nodes and poses
/// \param scans of the nodes
/// \param voxel_m edge of a voxel
/// \param stop ends it early
/// \param progress is called for each node
/// \param max_range_m as FeatureOptions::max_range_m
[[nodiscard]] LOOPWISE_EXPORT StitchedMap stitch_map(const PoseGraph& graph, const ScanStore& scans,
                                                     double voxel_m, const StopToken& stop = {},
                                                     const ProgressCallback& progress = {},
                                                     double max_range_m = FeatureOptions().max_range_m);

/// Adds problems with scans since the end of the run, for example in stitch_map(): a file may vanish in
/// between.
LOOPWISE_EXPORT void add_scan_problems(ReplayResult& result, const ScanStore& scans);

/// The map of a run, as from stitch_map(). Adds the problems of the map and of its scans to the result.
[[nodiscard]] LOOPWISE_EXPORT PointCloud map_of_run(const Mission& mission, ReplayResult& result,
                                                    double voxel_m, const StopToken& stop = {},
                                                    const ProgressCallback& progress = {},
                                                    double max_range_m = FeatureOptions().max_range_m);

/// Removes results of an earlier run that write_run_folder() does not always replace, such as trajectories of
/// other robots. Other files stay. \throws IoError
LOOPWISE_EXPORT void remove_run_results(const std::filesystem::path& folder);

/// Writes the results of a run into an existing folder: graph.g2o, trajectories/ROBOT.tum (optimised),
/// trajectories/ROBOT_odometry.tum, closures.csv, history.csv, map.pcd (if `map` is not empty), picture.svg
/// (both about map_origin(), which summary.json and a comment in map.pcd state) and, last, summary.json:
/// without it the folder is incomplete. \throws IoError
LOOPWISE_EXPORT void write_run_folder(const std::filesystem::path& folder, const Mission& mission,
                                      const ReplayOptions& options, const ReplayResult& result,
                                      const RunEvaluation& evaluation, const std::vector<HistoryRow>& history,
                                      const PointCloud& map);

}  // namespace loopwise
