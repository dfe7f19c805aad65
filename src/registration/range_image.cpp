// SPDX-License-Identifier: BSD-3-Clause
#include "range_image.hpp"

#include "../core/constants.hpp"
#include "fast_atan2.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace loopwise {
namespace {

constexpr int kColumns = 90, kRows = 45;
constexpr float kMarginM = 0.5F, kMarginShare = 0.05F;

std::size_t cell_of(const Eigen::Vector3f& p) {
  const float azimuth = fast_atan2(p.y(), p.x());
  const float elevation = fast_atan2(p.z(), std::sqrt(p.x() * p.x() + p.y() * p.y()));
  const int column =
      static_cast<int>((azimuth + kPiFloat) * (static_cast<float>(kColumns) / (2.0F * kPiFloat)));
  const int row = static_cast<int>((elevation + 0.5F * kPiFloat) * (static_cast<float>(kRows) / kPiFloat));
  return static_cast<std::size_t>(std::clamp(column, 0, kColumns - 1) * kRows +
                                  std::clamp(row, 0, kRows - 1));
}

/// The two smallest ranges of a cell's points.
struct Nearest {
  float first = std::numeric_limits<float>::infinity(), second = first;
  void add(float range) {
    second = std::min(second, std::max(first, range));
    first = std::min(first, range);
  }
};

/// Calls f with each of the three by three cells around a cell.
template <class F>
void for_each_around(std::size_t cell, F&& f) {
  const int column = static_cast<int>(cell) / kRows, row = static_cast<int>(cell) % kRows;
  for (int dc = -1; dc <= 1; ++dc) {
    const int beside = (column + dc + kColumns) % kColumns;
    for (int r = std::max(0, row - 1); r <= std::min(kRows - 1, row + 1); ++r) {
      f(static_cast<std::size_t>(beside * kRows + r));
    }
  }
}

bool is_in_free_space(float range, float free) {
  return range < free * (1.0F - kMarginShare) - kMarginM;
}

}  // namespace

RangeImage::RangeImage(const PointCloud& cloud)
    : free_m_(std::size_t{kColumns} * kRows, std::numeric_limits<float>::infinity()),
      seen_(free_m_.size(), 0) {
  std::vector<Nearest> nearest(free_m_.size());
  for (const Eigen::Vector3f& p : cloud.points) {
    const float range = p.norm();
    if (!(range > 0.0F)) continue;
    const std::size_t cell = cell_of(p);
    nearest[cell].add(range);
    seen_[cell] = 1;
  }
  for (std::size_t cell = 0; cell < free_m_.size(); ++cell) {
    for_each_around(cell, [&](std::size_t k) { free_m_[cell] = std::min(free_m_[cell], nearest[k].first); });
  }
  std::size_t looked_at = 0, free = 0;
  for (const Eigen::Vector3f& p : cloud.points) {
    const float range = p.norm();
    if (!(range > kMarginM)) continue;
    const std::size_t cell = cell_of(p);
    float of_others = std::numeric_limits<float>::infinity();
    for_each_around(cell, [&](std::size_t k) {
      const bool is_own = k == cell && nearest[k].first == range;
      of_others = std::min(of_others, is_own ? nearest[k].second : nearest[k].first);
    });
    if (std::isinf(of_others)) continue;
    ++looked_at;
    if (is_in_free_space(range, of_others)) ++free;
  }
  if (looked_at > 0) own_contradiction_ = static_cast<double>(free) / static_cast<double>(looked_at);
}

double RangeImage::contradiction(const PointCloud& cloud, const Eigen::Isometry3d& T_sensor_cloud,
                                 std::size_t count) const {
  if (free_m_.empty()) return 0.0;
  const std::size_t looked_at = std::min(cloud.size(), count);
  std::size_t seen = 0, free = 0;
  for (std::size_t k = 0; k < looked_at; ++k) {
    const Eigen::Vector3f p =
        (T_sensor_cloud * cloud.points[k * cloud.size() / looked_at].cast<double>()).cast<float>();
    const float range = p.norm();
    if (!(range > kMarginM)) continue;  // too near to the sensor
    const std::size_t cell = cell_of(p);
    if (seen_[cell] == 0) continue;
    ++seen;
    if (is_in_free_space(range, free_m_[cell])) ++free;
  }
  return seen == 0 ? 0.0 : static_cast<double>(free) / static_cast<double>(seen);
}

}  // namespace loopwise
