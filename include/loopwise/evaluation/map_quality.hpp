// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Quality of a map without a truth: how far poses are from what registrations of revisits measure that took
/// no part in the estimate, and how thick that makes surfaces.
#pragma once

#include <cstddef>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/plane_thickness.hpp>
#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/evaluation/surface_agreement.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/registration/registrar.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise {

/// Criteria of revisits that a map is judged by: nodes may be apart by as much as odometry drifts.
[[nodiscard]] LOOPWISE_EXPORT SurfaceAgreementOptions map_quality_options();

/// Tries to register the pairs, without a guess from any poses, so that neither map is favoured. The outcome
/// is in the order of the pairs, for any number of threads. `registrar` is that of the options and the
/// mission's scans, perhaps with kept outcomes; null: a new one. \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT std::vector<ProvenRevisit> prove_revisits(
    const Mission& mission, const Revisits& pairs, const ReplayOptions& options, ThreadPool& pool,
    const StopToken& stop = {}, const ProgressCallback& progress = {}, const Registrar* registrar = nullptr);

/// Distances between the relative positions of a map and those that were measured, m.
struct Displacement {
  std::vector<double> each_m;  ///< Of each revisit; NaN where a pose is missing.
  double mean_m = 0.0;         ///< Their mean; NaN without revisits.
  double median_m = 0.0;       ///< Half are smaller.
  double worst_tenth_m = 0.0;  ///< A tenth is larger.
};
/// The displacement of a map with poses T_world_body.
[[nodiscard]] LOOPWISE_EXPORT Displacement displacement(const PosesByKey& poses,
                                                        const std::vector<ProvenRevisit>& revisits);

/// Mean thickness of the planes that the scans of revisits share, m.
struct MeanThickness {
  std::vector<double> each_m;  ///< Of each revisit; NaN without planes or poses.
  double mean_m = std::numeric_limits<double>::quiet_NaN();  ///< Over the revisits; NaN without any.
};

/// With fewer pairs of stretches of path, an interval of a difference is meaningless.
inline constexpr std::size_t kLeastStretches = 8;

/// Pairs that are near by the poses of the estimate but not revisits by those of the recording, and the
/// number of them that a registration proves.
struct NearPairs {
  std::size_t pairs = 0;   ///< Near by the estimate alone, and registered.
  std::size_t proven = 0;  ///< Their registration succeeded.
  double median_m = 0.0;   ///< Displacement of the estimate at the proven ones; NaN without any.
};

/// One map against another at the same revisits.
struct MapQuality {
  std::size_t pairs = 0;                ///< Registered of those that may be revisits by the recording.
  std::vector<ProvenRevisit> revisits;  ///< The proven ones.
  std::size_t stretches = 0;            ///< Pairs of stretches of path at which they lie.
  double coverage = 0.0;          ///< Share of the recording's path at which they lie, see revisited_share().
  Displacement before;            ///< Of the recording.
  Displacement after;             ///< Of the estimate.
  PairedComparison difference;    ///< Of `after` and `before`, in stretches, m.
  double share_before = 0.0;      ///< Mean share of points on the other scan's surfaces, recording.
  double share_after = 0.0;       ///< The same by the estimate's poses.
  double share_registered = 0.0;  ///< The same by the registrations: as much as can be reached.
  std::size_t planes = 0;         ///< Pieces of planes that both scans of a revisit saw.
  std::size_t plane_stretches = 0;        ///< Pairs of stretches of path at which these revisits lie.
  MeanThickness thickness_before;         ///< Of these planes by the recording.
  MeanThickness thickness_after;          ///< The same by the estimate.
  MeanThickness thickness_registered;     ///< The same by the registrations: as little as can be reached.
  PairedComparison thickness_difference;  ///< Of the thickness by the estimate and by the recording, m.
  NearPairs near;                         ///< All of them.
  NearPairs near_between_robots;          ///< Those of two robots.

  /// Whether there are enough independent revisits for an interval.
  [[nodiscard]] bool enough() const { return stretches >= kLeastStretches; }
  /// The same for the thickness, which only revisits with planes have.
  [[nodiscard]] bool enough_planes() const { return plane_stretches >= kLeastStretches; }
  /// The reason why the figures are no or little evidence on the map; empty if they are evidence.
  [[nodiscard]] LOOPWISE_EXPORT std::string not_meaningful() const;
};

/// The pairs of nodes that loop closures of the graph join, as the edges have them.
[[nodiscard]] LOOPWISE_EXPORT Revisits closure_pairs(const PoseGraph& graph);

/// Judges the poses `after` of an estimate against `before`, those of the recording. Pairs of `used`, the
/// closures that the estimate was made of, do not count. `registrar` as of prove_revisits().
/// \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT MapQuality map_quality(const Mission& mission, const PosesByKey& before,
                                                     const PosesByKey& after, const Revisits& used,
                                                     const ReplayOptions& options, ThreadPool& pool,
                                                     const StopToken& stop = {},
                                                     const ProgressCallback& progress = {},
                                                     const Registrar* registrar = nullptr);

/// The figures as a JSON object, as `loopwise evaluate --map` prints them; null for unknown numbers.
[[nodiscard]] LOOPWISE_EXPORT std::string map_quality_json(const MapQuality& quality);

/// The figures as text, as `loopwise evaluate --map` prints them.
[[nodiscard]] LOOPWISE_EXPORT std::string map_quality_text(const MapQuality& quality);

/// A sentence if registrations contradict the estimate at many places, i.e. its map is probably wrong;
/// otherwise empty.
[[nodiscard]] LOOPWISE_EXPORT std::string map_quality_warning(const MapQuality& quality);

/// Adds the figures to summary.json of a run's folder, as `map_quality`, in place of former ones.
/// \throws IoError; ParseError, InputError on a summary that is no object
LOOPWISE_EXPORT void keep_map_quality(const std::filesystem::path& run_folder, const MapQuality& quality);

}  // namespace loopwise
