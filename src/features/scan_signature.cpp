// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/scan_signature.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kMostLookedAt = 8192;  // points of a cloud
constexpr float kVoxelsAcross = 40.0F;       // of the middle 96 % of the points, along their widest axis
constexpr float kSmallest_m = 0.4F, kLargest_m = 3.0F;
constexpr std::size_t kMostBits = 40960;  // of the grid: 5 kB
constexpr float kShareCutOff = 0.02F;     // of the points, at each end of an axis

constexpr float kFarthest_m = 1e4F;  // no lidar sees as far

/// Every n-th point, with n such that at most kMostLookedAt remain.
std::vector<Eigen::Vector3f> thinned(const PointCloud& cloud) {
  const std::size_t step = (cloud.size() + kMostLookedAt - 1) / kMostLookedAt;
  std::vector<Eigen::Vector3f> out;
  out.reserve(kMostLookedAt);
  for (std::size_t i = 0; i < cloud.size(); i += step) {
    const Eigen::Vector3f& point = cloud.points[i];
    if (point.allFinite() && point.cwiseAbs().maxCoeff() < kFarthest_m) out.push_back(point);
  }
  return out;
}

/// Bounds of the middle part of the points along an axis.
std::pair<float, float> middle(const std::vector<Eigen::Vector3f>& points, Eigen::Index axis) {
  constexpr std::size_t kFew = 512;
  const std::size_t step = (points.size() + kFew - 1) / kFew;
  std::array<float, kFew> values{};
  std::size_t n = 0;
  for (std::size_t i = 0; i < points.size(); i += step) values[n++] = points[i][axis];
  const auto cut = static_cast<std::ptrdiff_t>(kShareCutOff * static_cast<float>(n));
  const auto end = values.begin() + static_cast<std::ptrdiff_t>(n);
  std::nth_element(values.begin(), values.begin() + cut, end);
  const float low = values[static_cast<std::size_t>(cut)];
  std::nth_element(values.begin(), end - 1 - cut, end);
  return {low, *(end - 1 - cut)};
}

}  // namespace

ScanSignature::ScanSignature(const PointCloud& cloud) {
  const std::vector<Eigen::Vector3f> points = thinned(cloud);
  if (points.empty()) return;
  std::array<float, 3> extent{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto [low, high] = middle(points, static_cast<Eigen::Index>(axis));
    low_[axis] = low;
    extent[axis] = high - low;
  }
  const float widest = *std::max_element(extent.begin(), extent.end());
  voxel_m_ = std::clamp(widest / kVoxelsAcross, kSmallest_m, kLargest_m);
  const auto bits = [&] {
    float count = 1.0F;
    for (const float e : extent) count *= std::floor(e / voxel_m_) + 1.0F;
    return count;
  };
  while (bits() > static_cast<float>(kMostBits)) voxel_m_ *= 1.1F;
  for (std::size_t axis = 0; axis < 3; ++axis)
    size_[axis] = static_cast<std::int32_t>(std::floor(extent[axis] / voxel_m_)) + 1;
  bits_.assign((static_cast<std::size_t>(size_[0] * size_[1] * size_[2]) + 31) / 32, 0);

  std::vector<std::uint32_t> first;  // point of each voxel
  for (std::size_t i = 0; i < points.size(); ++i) {
    std::array<std::int32_t, 3> cell{};
    bool within = true;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      cell[axis] = static_cast<std::int32_t>(
          std::floor((points[i][static_cast<Eigen::Index>(axis)] - low_[axis]) / voxel_m_));
      within = within && cell[axis] >= 0 && cell[axis] < size_[axis];
    }
    if (!within) continue;
    const auto at = static_cast<std::uint32_t>(cell[0] + size_[0] * (cell[1] + size_[1] * cell[2]));
    std::uint32_t& word = bits_[at / 32];
    const std::uint32_t bit = std::uint32_t{1} << (at % 32);
    if ((word & bit) == 0) first.push_back(static_cast<std::uint32_t>(i));
    word |= bit;
  }
  points_ = static_cast<std::uint32_t>(std::min(first.size(), kPoints));
  for (std::size_t k = 0; k < points_; ++k) {
    const Eigen::Vector3f& point = points[first[k * first.size() / points_]];
    for (std::size_t axis = 0; axis < 3; ++axis) drawn_[axis][k] = point[static_cast<Eigen::Index>(axis)];
  }
}

double ScanSignature::share_of(const ScanSignature& other, const Eigen::Isometry3d& T_this_other) const {
  if (empty() || other.empty()) return 0.0;
  // Converts to voxels from the corner of the grid.
  const float per_m = 1.0F / voxel_m_;
  const Eigen::Matrix3f R = T_this_other.linear().cast<float>() * per_m;
  const Eigen::Vector3f t =
      (T_this_other.translation().cast<float>() - Eigen::Vector3f(low_[0], low_[1], low_[2])) * per_m;
  // Computes all kPoints entries even if fewer are used, so that the loop has no branches.
  std::array<std::int32_t, kPoints> at;
  std::array<std::int32_t, kPoints> within;
  const auto& [px, py, pz] = other.drawn_;
  const auto nx = static_cast<float>(size_[0]), ny = static_cast<float>(size_[1]),
             nz = static_cast<float>(size_[2]);
  for (std::size_t k = 0; k < kPoints; ++k) {
    const float x = R(0, 0) * px[k] + R(0, 1) * py[k] + R(0, 2) * pz[k] + t[0];
    const float y = R(1, 0) * px[k] + R(1, 1) * py[k] + R(1, 2) * pz[k] + t[1];
    const float z = R(2, 0) * px[k] + R(2, 1) * py[k] + R(2, 2) * pz[k] + t[2];
    const int inside = static_cast<int>(x >= 0.0F) & static_cast<int>(x < nx) & static_cast<int>(y >= 0.0F) &
                       static_cast<int>(y < ny) & static_cast<int>(z >= 0.0F) & static_cast<int>(z < nz);
    within[k] = inside;
    const float cx = inside != 0 ? x : 0.0F, cy = inside != 0 ? y : 0.0F, cz = inside != 0 ? z : 0.0F;
    at[k] = static_cast<std::int32_t>(cx) +
            size_[0] * (static_cast<std::int32_t>(cy) + size_[1] * static_cast<std::int32_t>(cz));
  }
  std::uint32_t hits = 0;
  for (std::size_t k = 0; k < other.points_; ++k) {
    const auto place = static_cast<std::uint32_t>(at[k]);
    hits += (bits_[place / 32] >> (place % 32)) & static_cast<std::uint32_t>(within[k]);
  }
  return static_cast<double>(hits) / static_cast<double>(other.points_);
}

std::vector<std::uint32_t> ScanSignature::words() const {
  if (empty()) return {};
  std::vector<std::uint32_t> out;
  const auto put = [&out](auto value) {
    static_assert(sizeof(value) == 4);
    std::uint32_t word = 0;
    std::memcpy(&word, &value, 4);
    out.push_back(word);
  };
  put(voxel_m_);
  for (const float low : low_) put(low);
  for (const std::int32_t size : size_) put(size);
  put(points_);
  for (const auto& axis : drawn_) std::for_each_n(axis.begin(), points_, put);
  out.insert(out.end(), bits_.begin(), bits_.end());
  return out;
}

ScanSignature ScanSignature::from_words(const std::vector<std::uint32_t>& words) {
  ScanSignature out;
  if (words.empty()) return out;
  const auto refuse = [](bool wrong) {
    if (wrong) throw InputError("invalid scan signature");
  };
  constexpr std::size_t kHead = 8;
  refuse(words.size() < kHead);
  std::size_t next = 0;
  const auto get = [&](auto& value) {
    static_assert(sizeof(value) == 4);
    std::memcpy(&value, &words[next++], 4);
  };
  get(out.voxel_m_);
  for (float& low : out.low_) get(low);
  for (std::int32_t& size : out.size_) get(size);
  get(out.points_);
  refuse(!(out.voxel_m_ >= kSmallest_m) || out.points_ == 0 || out.points_ > kPoints);
  std::uint64_t bits = 1;
  for (const std::int32_t size : out.size_) {
    refuse(size < 1 || static_cast<std::size_t>(size) > kMostBits);
    bits *= static_cast<std::uint64_t>(size);
    refuse(bits > kMostBits);
  }
  const std::size_t bit_words = (static_cast<std::size_t>(bits) + 31) / 32;
  refuse(words.size() != kHead + std::size_t{3} * out.points_ + bit_words);
  for (auto& axis : out.drawn_) std::for_each_n(axis.begin(), out.points_, get);
  out.bits_.assign(words.begin() + static_cast<std::ptrdiff_t>(next), words.end());
  return out;
}

double predicted_overlap(const ScanSignature& from, const ScanSignature& to,
                         const Eigen::Isometry3d& T_from_to) {
  return std::min(from.share_of(to, T_from_to), to.share_of(from, T_from_to.inverse()));
}

}  // namespace loopwise
