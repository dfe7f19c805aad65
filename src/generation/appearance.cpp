// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/appearance.hpp>

#include <cmath>
#include <limits>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/odometry_walk.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/features/bounded_cache.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/generation/place_submap.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kCacheBytes = std::size_t{64} << 20;

std::unique_ptr<PlaceDatabase> make_database(PlaceKind kind) {
  return kind == PlaceKind::kScanContext ? make_scan_context_database() : make_density_place_database();
}

}  // namespace

/// Downsampled scans, cached within a bound: submaps of neighbouring nodes share most of their scans.
struct AppearanceGenerator::Scans {
  ScanLoader source;
  double voxel_m;
  Problems& problems;
  BoundedCache<Key, PointCloud> cache{kCacheBytes};

  [[nodiscard]] std::shared_ptr<const PointCloud> load(Key key) {
    return cache.get(key, [this](Key of) -> std::shared_ptr<const PointCloud> {
      try {
        const auto scan = source(of);
        return scan ? std::make_shared<const PointCloud>(voxel_downsample(*scan, voxel_m)) : nullptr;
      } catch (const Error& error) {
        problems.add("scan of a place cannot be read", error.what());
        return nullptr;
      }
    });
  }
};

AppearanceGenerator::AppearanceGenerator(const AppearanceOptions& options, Robots robots, ScanLoader scans,
                                         std::unique_ptr<PlaceDatabase> database)
    : options_(options), robots_(std::move(robots)), database_(std::move(database)) {
  validate(options_);
  if (!scans) throw InputError("candidates by appearance need the scans");
  if (!database_) database_ = make_database(options_.descriptor);
  // NOLINTNEXTLINE(modernize-make-unique): an aggregate
  scans_.reset(new Scans{std::move(scans), options_.voxel_m, problems_});
}

AppearanceGenerator::~AppearanceGenerator() = default;

AppearanceGenerator::PathPosition AppearanceGenerator::path_position_of(const PoseGraph& graph, Key key) {
  if (const auto known = path_positions_.find(key); known != path_positions_.end()) return known->second;
  PathPosition position;
  const auto before = OdometryWalk(graph, robots_, key, false).next();
  const auto previous =
      before ? path_positions_.find(graph.nodes()[before->node].key) : path_positions_.end();
  if (previous != path_positions_.end()) {
    position = previous->second;
    position.path_m += before->T_start_here.translation().norm();
  } else {
    position.piece = last_place_m_.size();
    last_place_m_.push_back(-std::numeric_limits<double>::infinity());
  }
  return path_positions_[key] = position;
}

std::vector<LoopCandidate> AppearanceGenerator::on_node(const PoseGraph& graph, Key key, double time_s) {
  if (robots_.is_landmark(key) || !graph.contains(key) || database_->find(key)) return {};
  const PathPosition here = path_position_of(graph, key);
  if (here.path_m - last_place_m_[here.piece] < options_.spacing_m) return {};
  PlaceSubmapOptions submap_options;
  submap_options.path_m = options_.path_m;
  submap_options.spacing_m = options_.spacing_m;
  const PlaceSubmap submap = place_submap(
      graph, robots_, key, [this](Key of) { return scans_->load(of); }, submap_options);
  if (submap.level.empty()) return {};
  const auto place = database_->describe(submap.level);
  if (!place)
    throw InputError("place database \"" + std::string(database_->name()) + "\": describe() returned null");
  const auto found = database_->search(*place, static_cast<std::size_t>(options_.per_place), [&](Key other) {
    const auto there = path_positions_.find(other);
    return there != path_positions_.end() &&
           (there->second.piece != here.piece ||
            std::abs(there->second.path_m - here.path_m) >= options_.apart_m);
  });
  database_->insert(key, place);
  level_[key] = submap.rotation;
  last_place_m_[here.piece] = here.path_m;

  std::vector<LoopCandidate> candidates;
  for (const PlaceMatch& match : found) {
    if (match.similarity < options_.min_similarity) break;  // the best come first
    const auto level = level_.find(match.key);
    if (level == level_.end()) {
      throw InputError("place database \"" + std::string(database_->name()) + "\" returned key " +
                       key_name(match.key) + ", which was not added to it");
    }
    const PlaceMatch bodies = between_bodies(match, submap.rotation, level->second);
    auto recognition = std::make_shared<Recognition>();
    recognition->similarity = bodies.similarity;
    recognition->T_from_to = bodies.T_query_match;
    recognition->covariance = bodies.covariance;
    LoopCandidate candidate;
    candidate.from = key;
    candidate.to = match.key;
    candidate.source = CandidateSource::kAppearance;
    candidate.time_s = time_s;
    candidate.distance_m =
        (graph.node(key).pose.translation() - graph.node(match.key).pose.translation()).norm();
    candidate.recognition = std::move(recognition);
    candidates.push_back(std::move(candidate));
  }
  return candidates;
}

}  // namespace loopwise
