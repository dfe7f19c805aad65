// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/features/place.hpp>
#include <loopwise/generation/candidate_generator.hpp>

namespace loopwise {

/// Databases of places.
enum class PlaceKind {
  kDensity,      ///< make_density_place_database()
  kScanContext,  ///< make_scan_context_database()
};
[[nodiscard]] inline EnumNames<PlaceKind> enum_names(PlaceKind) {
  return {{PlaceKind::kDensity, "density"}, {PlaceKind::kScanContext, "scan_context"}};
}

/// Candidates from the appearance of places, independent of the estimate.
struct AppearanceOptions {
  /// Propose pairs of places that look alike, independent of the estimate. The z axis of the common frame
  /// must point up.
  bool enabled = false;
  /// Descriptor of places: density (images of submaps from above, which also guess the relative pose) or
  /// scan_context.
  PlaceKind descriptor = PlaceKind::kDensity;
  /// Maximum number of candidates of each new place.
  std::int64_t per_place = 3;
  /// Pairs with a lower similarity are not proposed.
  double min_similarity = 0.15;
  /// Distance along the path between consecutive places of a robot, m.
  double spacing_m = 1.0;
  /// Minimum distance along the path between two places of one robot that are proposed as a pair, m.
  double apart_m = 50.0;
  /// Length of the path whose scans form a place, m. 0: one scan.
  double path_m = 15.0;
  /// Edge of the voxels with which scans are downsampled, m.
  double voxel_m = 0.25;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("enabled", self.enabled, any_value());
    field("descriptor", self.descriptor, any_value());
    field("per_place", self.per_place, at_least(1));
    field("min_similarity", self.min_similarity, between(0.0, 1.0));
    field("spacing_m", self.spacing_m, at_least(0.0));
    field("apart_m", self.apart_m, at_least(0.0));
    field("path_m", self.path_m, at_least(0.0));
    field("voxel_m", self.voxel_m, above(0.0));
  }
};

/// Proposes pairs of a new place and earlier places of all robots that look like it, with the relative pose
/// that the place recognition guesses. A place is described by the scans along the path up to it, so that it
/// is known as soon as its node arrives.
class LOOPWISE_EXPORT AppearanceGenerator final : public CandidateGenerator {
 public:
  /// \param options of the places; `enabled` is ignored
  /// \param robots of the team
  /// \param scans hands out their clouds
  /// \param database of places, empty; null: the one that the options name. \throws OptionError; InputError
  /// without a loader
  AppearanceGenerator(const AppearanceOptions& options, Robots robots, ScanLoader scans,
                      std::unique_ptr<PlaceDatabase> database = nullptr);
  ~AppearanceGenerator() override;

  [[nodiscard]] std::string_view name() const override { return "appearance"; }

  /// May be called again if the scan of a node arrives after the node. Until then the node is not a place.
  [[nodiscard]] std::vector<LoopCandidate> on_node(const PoseGraph& graph, Key key, double time_s) override;

  /// The places so far.
  [[nodiscard]] const PlaceDatabase& places() const { return *database_; }
  /// Scans that could not be read ("scan of a place cannot be read").
  [[nodiscard]] const Problems& problems() const { return problems_; }

 private:
  /// Where a node lies on its robot's path.
  struct PathPosition {
    std::size_t piece = 0;  ///< Of a path that odometry connects.
    double path_m = 0.0;    ///< From the piece's begin.
  };
  struct Scans;
  [[nodiscard]] PathPosition path_position_of(const PoseGraph& graph, Key key);

  AppearanceOptions options_;
  Robots robots_;
  std::unique_ptr<PlaceDatabase> database_;
  std::unique_ptr<Scans> scans_;
  std::unordered_map<Key, PathPosition> path_positions_;
  std::unordered_map<Key, Eigen::Matrix3d> level_;  ///< Of the places.
  std::vector<double> last_place_m_;                ///< By piece; infinite before the first.
  Problems problems_;
};

}  // namespace loopwise
