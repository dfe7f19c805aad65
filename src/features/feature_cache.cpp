// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/feature_cache.hpp>

#include <cmath>
#include <sstream>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/voxel_grid.hpp>

namespace loopwise {
namespace {

/// Scales the normals of a file to unit length. Normals that are not finite or have zero length become zero.
void normalize(std::vector<Eigen::Vector3f>& normals) {
  for (Eigen::Vector3f& normal : normals) {
    const float length = normal.norm();
    normal =
        std::isfinite(length) && length > 1e-6F ? Eigen::Vector3f(normal / length) : Eigen::Vector3f::Zero();
  }
}

}  // namespace

ScanFeatures compute_features(const PointCloud& cloud, const FeatureOptions& options) {
  ScanFeatures out;
  out.raw_points = cloud.size();
  const auto downsample = [&](const PointCloud& points) {
    return adaptive_downsample(points, options.voxel_m, static_cast<std::size_t>(options.min_points));
  };
  out.far_points = points_beyond(cloud, options.max_range_m);
  out.cloud = downsample(out.far_points == 0 ? cloud : within_range(cloud, options.max_range_m));
  out.tree = KdTree(out.cloud.points);
  if (options.use_file_normals && out.cloud.has_normals()) {
    normalize(out.cloud.normals);
  } else {
    out.cloud.normals = estimate_normals(out.cloud.points, out.tree, options.normal_neighbours);
  }
  out.observability = observability(out.cloud);
  return out;
}

void count_far_points(Problems& problems, const std::string& scan, std::size_t count, double max_range_m) {
  if (count == 0) return;
  std::ostringstream example;
  example << scan << ": further than features.max_range_m, " << max_range_m << " m";
  problems.add("point too far from the sensor left out", example.str(), count);
}

FeatureCache::FeatureCache(ScanLoader scans, const FeatureOptions& options)
    : scans_(std::move(scans)),
      options_(options),
      cache_(static_cast<std::size_t>(options.max_cache_mb * 1e6)) {
  validate(options_);
  if (!scans_) throw InputError("a feature cache needs a scan loader");
}

std::shared_ptr<const ScanFeatures> FeatureCache::get(Key key) {
  return cache_.get(key, [this](Key wanted) -> std::shared_ptr<const ScanFeatures> {
    const std::shared_ptr<const PointCloud> scan = scans_(wanted);
    if (!scan) return nullptr;
    auto features = std::make_shared<const ScanFeatures>(compute_features(*scan, options_));
    if (features->far_points > 0) {
      const std::lock_guard<std::mutex> lock(mutex_);
      far_points_[wanted] = features->far_points;
    }
    return features;
  });
}

Problems FeatureCache::problems() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  Problems problems;
  for (const auto& [key, count] : far_points_) {
    count_far_points(problems, "scan " + key_name(key), count, options_.max_range_m);
  }
  return problems;
}

}  // namespace loopwise
