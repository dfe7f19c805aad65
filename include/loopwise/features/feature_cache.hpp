// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/features/bounded_cache.hpp>
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/features/observability.hpp>

namespace loopwise {

/// Preparation of a scan for all stages.
struct FeatureOptions {
  /// Points further from the sensor are left out and counted, m. 0: no bound. In a cloud in world coordinates
  /// the distance is measured from its middle.
  double max_range_m = 300.0;
  /// Edge of the voxel grid with which scans are downsampled, m.
  double voxel_m = 0.5;
  /// Scans with at most this many points are not downsampled. The grid is refined if it would leave fewer
  /// points.
  int min_points = 1000;
  /// Number of nearest points, including the point itself, from which a normal is estimated.
  int normal_neighbours = 10;
  /// Keep the normals of a scan if its file has them. Off: estimate all normals.
  bool use_file_normals = true;
  /// Memory for features, MB.
  double max_cache_mb = 512.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_range_m", self.max_range_m, at_least(0.0));
    field("voxel_m", self.voxel_m, above(0.0));
    field("min_points", self.min_points, at_least(0.0));
    field("normal_neighbours", self.normal_neighbours, between(3.0, 100.0));
    field("use_file_normals", self.use_file_normals, any_value());
    field("max_cache_mb", self.max_cache_mb, at_least(0.0));
  }
};

/// Features of a scan for all stages, computed once from the downsampled cloud.
struct ScanFeatures {
  PointCloud cloud;             ///< Downsampled, with normals (zero where unknown), body frame.
  KdTree tree;                  ///< Over cloud.points.
  Observability observability;  ///< How well the scan constrains a registration.
  std::size_t raw_points = 0;   ///< Of the scan before downsampling.
  std::size_t far_points = 0;   ///< Of these, left out because of FeatureOptions::max_range_m.

  /// Memory that the features hold, for bounded caches.
  [[nodiscard]] std::size_t bytes() const { return sizeof(*this) + cloud.bytes() + tree.bytes(); }
};

/// Features of a cloud. Empty or degenerate clouds give empty or degenerate features, never NaN.
[[nodiscard]] LOOPWISE_EXPORT ScanFeatures compute_features(const PointCloud& cloud,
                                                            const FeatureOptions& options);

/// Counts points that were left out of a scan because of their range.
/// \param problems gets the problem
/// \param scan name of the scan
/// \param count number of points
/// \param max_range_m FeatureOptions::max_range_m
LOOPWISE_EXPORT void count_far_points(Problems& problems, const std::string& scan, std::size_t count,
                                      double max_range_m);

/// Features of the scans by key, computed on first use and kept within a bound. Thread-safe.
class LOOPWISE_EXPORT FeatureCache {
 public:
  /// \throws OptionError; InputError if `scans` is empty.
  explicit FeatureCache(ScanLoader scans, const FeatureOptions& options = {});

  /// Null if the key has no scan. \throws exceptions of the loader.
  [[nodiscard]] std::shared_ptr<const ScanFeatures> get(Key key);

  /// The scan from the loader. \throws exceptions of the loader.
  [[nodiscard]] std::shared_ptr<const PointCloud> scan(Key key) const { return scans_(key); }

  /// Points left out of the scans whose features were computed so far, in the order of the keys.
  [[nodiscard]] Problems problems() const;

  /// The options.
  [[nodiscard]] const FeatureOptions& options() const { return options_; }
  /// Number of computations of features.
  [[nodiscard]] std::size_t computed() const { return cache_.misses(); }

 private:
  ScanLoader scans_;
  FeatureOptions options_;
  BoundedCache<Key, ScanFeatures> cache_;
  mutable std::mutex mutex_;
  std::map<Key, std::size_t> far_points_;  // of scans that have some
};

}  // namespace loopwise
