// SPDX-License-Identifier: BSD-3-Clause
#include "lidar.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <loopwise/core/random.hpp>

#include "../core/constants.hpp"
#include "parameters.hpp"

namespace loopwise::simulation_detail {
namespace {

namespace parameters = simulation_parameters;
const parameters::Lidar& model(LidarKind kind) {
  return kind == LidarKind::kVlp16 ? parameters::kVlp16 : parameters::kOs1_64;
}

/// The voxel of a point as one number with 21 bits per axis, enough for 2 km at 1 mm.
std::uint64_t voxel_of(const Eigen::Vector3f& p, double leaf) {
  const auto part = [leaf](float x) {
    return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(static_cast<double>(x) / leaf)) +
                                      (1 << 20)) &
           0x1fffffU;
  };
  return (part(p.x()) << 42) | (part(p.y()) << 21) | part(p.z());
}

std::vector<std::pair<std::uint64_t, std::uint32_t>> sorted_voxels(const PointCloud& cloud, double leaf) {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> voxels;
  voxels.reserve(cloud.size());
  for (std::uint32_t i = 0; i < cloud.size(); ++i) voxels.emplace_back(voxel_of(cloud.points[i], leaf), i);
  std::sort(voxels.begin(), voxels.end());
  return voxels;
}

std::size_t count_voxels(const PointCloud& cloud, double leaf, std::vector<std::uint64_t>& table) {
  // Open addressing with 0 for a free slot. No voxel has the number 0, because the offsets keep its parts far
  // from 0.
  std::fill(table.begin(), table.end(), 0);
  const std::size_t mask = table.size() - 1;
  std::size_t count = 0;
  for (const Eigen::Vector3f& p : cloud.points) {
    const std::uint64_t voxel = voxel_of(p, leaf);
    std::size_t slot = mix64(voxel) & mask;
    while (table[slot] != 0 && table[slot] != voxel) slot = (slot + 1) & mask;
    if (table[slot] == 0) {
      table[slot] = voxel;
      ++count;
    }
  }
  return count;
}

float rounded_to_float(double x) {
  return static_cast<float>(std::round(x * 1024.0) / 1024.0);
}

}  // namespace

std::vector<Eigen::Vector3f> beam_directions(LidarKind kind) {
  const parameters::Lidar& lidar = model(kind);
  std::vector<Eigen::Vector3f> directions;
  directions.reserve(static_cast<std::size_t>(lidar.columns * lidar.beams));
  for (int column = 0; column < lidar.columns; ++column) {
    const double azimuth = 2.0 * kPi * column / lidar.columns;
    for (int beam = 0; beam < lidar.beams; ++beam) {
      const double elevation =
          kPi / 180.0 *
          (lidar.elevation_low_deg +
           (lidar.elevation_high_deg - lidar.elevation_low_deg) * beam / (lidar.beams - 1));
      directions.push_back(Eigen::Vector3d(std::cos(elevation) * std::cos(azimuth),
                                           std::cos(elevation) * std::sin(azimuth), std::sin(elevation))
                               .cast<float>());
    }
  }
  return directions;
}

Sweep sweep(const RayCaster& caster, const std::vector<Eigen::Vector3f>& directions, LidarKind kind,
            const Eigen::Isometry3d& T_world_sensor, std::uint64_t seed) {
  const parameters::Lidar& lidar = model(kind);
  const Eigen::Matrix3f R = T_world_sensor.linear().cast<float>();
  const Eigen::Vector3f origin = T_world_sensor.translation().cast<float>();
  Rng rng(seed);
  Sweep result;
  result.rays = directions.size();
  result.cloud.points.reserve(directions.size());
  for (const Eigen::Vector3f& direction : directions) {
    // Drawn for every ray, hit or not, so that the random numbers of the next ray do not depend on this one.
    const double noise = rng.normal(), luck = rng.uniform();
    const Eigen::Vector3f ray = (R * direction).normalized();
    const std::optional<RayHit> hit = caster.cast(origin, ray, static_cast<float>(lidar.max_range_m));
    if (!hit) continue;
    const double distance = std::round(static_cast<double>(hit->distance_m) / parameters::kRangeQuantum) *
                            parameters::kRangeQuantum;
    const double cosine = std::abs(static_cast<double>(hit->normal.dot(ray)));
    const double far = distance / lidar.max_range_m;
    const double grazing = std::clamp((parameters::kDropGrazingCosine - cosine) /
                                          (parameters::kDropGrazingCosine - parameters::kDropGrazingNone),
                                      0.0, 1.0);
    const double kept =
        (1.0 - parameters::kDropAlways) * (1.0 - parameters::kDropAtMaxRange * far * far) * (1.0 - grazing);
    if (luck >= kept) continue;
    const double measured = std::round((distance + lidar.range_sigma_m * noise) / parameters::kRangeQuantum) *
                            parameters::kRangeQuantum;
    if (measured < lidar.min_range_m || measured > lidar.max_range_m) continue;
    result.cloud.points.push_back(direction * static_cast<float>(measured));
    const Eigen::Vector3d n = (R.transpose() * hit->normal).cast<double>();
    result.normal_scatter += n * n.transpose();
  }
  if (!result.cloud.empty()) result.normal_scatter /= static_cast<double>(result.cloud.size());
  return result;
}

PointCloud thin(const PointCloud& cloud, int points, std::uint64_t seed) {
  const double target = parameters::kVoxelTargetPerPoint * points;
  std::size_t slots = 1024;
  while (slots < 2 * cloud.size()) slots *= 2;
  std::vector<std::uint64_t> table(slots);
  double leaf = parameters::kVoxelStart;
  for (int round = 0; round < parameters::kVoxelRounds; ++round) {
    const auto count = static_cast<double>(count_voxels(cloud, leaf, table));
    leaf =
        std::clamp(std::round(leaf * count / target / parameters::kVoxelQuantum) * parameters::kVoxelQuantum,
                   parameters::kVoxelRange.low, parameters::kVoxelRange.high);
  }

  struct Centroid {
    std::uint64_t rank;
    std::uint64_t voxel;
    Eigen::Vector3f point;
  };
  std::vector<Centroid> centroids;
  const auto voxels = sorted_voxels(cloud, leaf);
  for (std::size_t i = 0; i < voxels.size();) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    std::size_t j = i;
    for (; j < voxels.size() && voxels[j].first == voxels[i].first; ++j) {
      sum += cloud.points[voxels[j].second].cast<double>();
    }
    const Eigen::Vector3d mean = sum / static_cast<double>(j - i);
    centroids.push_back({combine_seeds(seed, voxels[i].first), voxels[i].first,
                         Eigen::Vector3f(rounded_to_float(mean.x()), rounded_to_float(mean.y()),
                                         rounded_to_float(mean.z()))});
    i = j;
  }
  const auto keep = static_cast<std::size_t>(points);
  if (centroids.size() > keep) {
    std::nth_element(centroids.begin(), centroids.begin() + static_cast<std::ptrdiff_t>(keep),
                     centroids.end(), [](const Centroid& a, const Centroid& b) { return a.rank < b.rank; });
    centroids.resize(keep);
    std::sort(centroids.begin(), centroids.end(),
              [](const Centroid& a, const Centroid& b) { return a.voxel < b.voxel; });
  }
  PointCloud result;
  result.points.reserve(centroids.size());
  for (const Centroid& c : centroids) result.points.push_back(c.point);
  return result;
}

}  // namespace loopwise::simulation_detail
