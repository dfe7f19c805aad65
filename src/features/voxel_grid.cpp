// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/voxel_grid.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <loopwise/core/options.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/robust_centre.hpp>

namespace loopwise {
namespace {

struct Cell {
  std::int32_t x = 0, y = 0, z = 0;
  [[nodiscard]] bool operator==(const Cell& other) const {
    return x == other.x && y == other.y && z == other.z;
  }
};

/// Farther than any map extends. The bound keeps the conversion to an integer defined for all finite floats.
constexpr double kMaxCell = 2e9;

Cell cell_of(const Eigen::Vector3d& point, double inverse_edge) {
  const auto along = [&](Eigen::Index axis) {
    const double cell = std::floor(point[axis] * inverse_edge);
    return static_cast<std::int32_t>(std::clamp(cell, -kMaxCell, kMaxCell));
  };
  return {along(0), along(1), along(2)};
}

std::uint64_t hash(const Cell& cell) {
  const auto word = [](std::int32_t v) { return static_cast<std::uint64_t>(static_cast<std::uint32_t>(v)); };
  return mix64(word(cell.x) ^ mix64(word(cell.y) ^ (word(cell.z) << 32)));
}

/// Numbers cells in the order of their first appearance. Open addressing needs no allocation per cell.
class CellTable {
 public:
  explicit CellTable(std::size_t max_cells) {
    std::size_t capacity = 16;
    while (capacity < 2 * max_cells) capacity *= 2;
    slots_.assign(capacity, kEmpty);
  }
  std::size_t number(const Cell& cell) {
    const std::size_t mask = slots_.size() - 1;
    for (std::size_t slot = static_cast<std::size_t>(hash(cell)) & mask;; slot = (slot + 1) & mask) {
      if (slots_[slot] == kEmpty) {
        slots_[slot] = static_cast<std::uint32_t>(cells_.size());
        cells_.push_back(cell);
        return cells_.size() - 1;
      }
      if (cells_[slots_[slot]] == cell) return slots_[slot];
    }
  }

 private:
  static constexpr std::uint32_t kEmpty = ~std::uint32_t{0};
  std::vector<std::uint32_t> slots_;
  std::vector<Cell> cells_;
};

struct Sum {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double intensity = 0.0;
  std::uint32_t count = 0;
};

/// Finds points that are too far from the sensor. A scan has the sensor at the origin. A cloud in world
/// coordinates has its middle far from the origin, and the middle then stands for the sensor. The middle of a
/// scan of one direction is ahead of the sensor, but never as far.
class Range {
 public:
  Range(const PointCloud& cloud, double max_range_m) : max_m_(max_range_m) {
    constexpr double kNoScanM = 300.0;
    const Eigen::Vector3d middle = robust_centre(cloud.points);
    if (middle.norm() > std::max(kNoScanM, max_range_m)) sensor_ = middle;
  }
  /// False for points that are not finite, which the downsampling handles.
  [[nodiscard]] bool is_beyond(const Eigen::Vector3f& p) const {
    const double range = (p.cast<double>() - sensor_).norm();
    return std::isfinite(range) && range > max_m_;
  }

 private:
  double max_m_;
  Eigen::Vector3d sensor_ = Eigen::Vector3d::Zero();
};

/// The points for which `wanted` is true, with their normals and intensities.
template <class Wanted>
PointCloud selected(const PointCloud& cloud, Wanted&& wanted) {
  PointCloud out;
  out.origin = cloud.origin;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    if (!wanted(cloud.points[i])) continue;
    out.points.push_back(cloud.points[i]);
    if (cloud.has_normals()) out.normals.push_back(cloud.normals[i]);
    if (cloud.intensities.size() == cloud.size()) out.intensities.push_back(cloud.intensities[i]);
  }
  return out;
}

}  // namespace

std::size_t points_beyond(const PointCloud& cloud, double max_range_m) {
  if (max_range_m == 0.0) return 0;
  const Range range(cloud, max_range_m);
  return static_cast<std::size_t>(std::count_if(cloud.points.begin(), cloud.points.end(),
                                                [&](const auto& p) { return range.is_beyond(p); }));
}

PointCloud within_range(const PointCloud& cloud, double max_range_m) {
  if (max_range_m == 0.0) return cloud;
  const Range range(cloud, max_range_m);
  return selected(cloud, [&](const Eigen::Vector3f& p) { return !range.is_beyond(p); });
}

PointCloud voxel_downsample(const PointCloud& cloud, double voxel_m) {
  detail::check_bounds("voxel_m", voxel_m, above(0.0));
  const bool with_normals = cloud.has_normals();
  const bool with_intensities = cloud.intensities.size() == cloud.size();
  CellTable table(cloud.size());
  std::vector<Sum> sums;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const Eigen::Vector3f& point = cloud.points[i];
    if (!point.allFinite()) continue;
    const std::size_t number = table.number(cell_of(point.cast<double>(), 1.0 / voxel_m));
    if (number == sums.size()) sums.emplace_back();
    Sum& sum = sums[number];
    sum.point += point.cast<double>();
    if (with_normals && cloud.normals[i].allFinite()) sum.normal += cloud.normals[i].cast<double>();
    if (with_intensities) sum.intensity += static_cast<double>(cloud.intensities[i]);
    ++sum.count;
  }
  PointCloud out;
  out.origin = cloud.origin;
  out.points.reserve(sums.size());
  if (with_normals) out.normals.reserve(sums.size());
  if (with_intensities) out.intensities.reserve(sums.size());
  for (const Sum& sum : sums) {
    out.points.push_back((sum.point / sum.count).cast<float>());
    if (with_normals) {
      const double length = sum.normal.norm();
      out.normals.push_back(length > 1e-6 ? Eigen::Vector3f((sum.normal / length).cast<float>())
                                          : Eigen::Vector3f::Zero());
    }
    if (with_intensities) out.intensities.push_back(static_cast<float>(sum.intensity / sum.count));
  }
  return out;
}

PointCloud voxel_downsample(PointView points, double voxel_m) {
  detail::check_bounds("voxel_m", voxel_m, above(0.0));
  constexpr double kCoarse_m = 16384.0;  // floats beyond are at least 2 mm apart
  PointCloud out;
  const Eigen::Vector3d centre = robust_centre(points);
  if (centre.norm() > kCoarse_m) out.origin = centre.array().round();
  CellTable table(points.size());
  std::vector<Sum> sums;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d point = points[i];
    if (!point.allFinite()) continue;
    const std::size_t number = table.number(cell_of(point, 1.0 / voxel_m));
    if (number == sums.size()) sums.emplace_back();
    sums[number].point += point;
    ++sums[number].count;
  }
  out.points.reserve(sums.size());
  for (const Sum& sum : sums) out.points.push_back((sum.point / sum.count - out.origin).cast<float>());
  return out;
}

PointCloud adaptive_downsample(const PointCloud& cloud, double voxel_m, std::size_t min_points) {
  detail::check_bounds("voxel_m", voxel_m, above(0.0));
  if (cloud.size() <= min_points) {
    if (std::all_of(cloud.points.begin(), cloud.points.end(), [](const auto& p) { return p.allFinite(); })) {
      return cloud;
    }
    return selected(cloud, [](const Eigen::Vector3f& p) { return p.allFinite(); });
  }
  PointCloud out = voxel_downsample(cloud, voxel_m);
  for (int refinement = 0; refinement < 3 && out.size() < min_points; ++refinement) {
    voxel_m *= 0.5;
    out = voxel_downsample(cloud, voxel_m);
  }
  return out;
}

}  // namespace loopwise
