// SPDX-License-Identifier: BSD-3-Clause
#include "fpfh.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/features/normals.hpp>

#include "surface.hpp"

namespace loopwise {
namespace {

constexpr int kBins = kFpfhSize / 3;
using Histogram = Eigen::Matrix<float, kFpfhSize, 1>;

int bin(float unit_interval) {
  return std::clamp(static_cast<int>(unit_interval * static_cast<float>(kBins)), 0, kBins - 1);
}

/// Angle of (x, y) as a share of a full turn, in [0, 1]. The error is below 1e-3 turns, a hundredth of a bin.
float turn(float y, float x) {
  const float ax = std::abs(x), ay = std::abs(y);
  const float larger = std::max(ax, ay);
  if (larger == 0.0F) return 0.5F;
  const float t = std::min(ax, ay) / larger;
  float a = t * (0.25F * 0.636619772F + 0.0435F * (1.0F - t));  // of the octant, in turns: atan(t) / 2π
  if (ay > ax) a = 0.25F - a;
  if (x < 0.0F) a = 0.5F - a;
  return y < 0.0F ? 0.5F - a : 0.5F + a;
}

/// Eigen's cross() is not inlined here, and the linker may bind it to a copy that another library exports.
inline Eigen::Vector3f cross(const Eigen::Vector3f& a, const Eigen::Vector3f& b) {
  return {a.y() * b.z() - a.z() * b.y(), a.z() * b.x() - a.x() * b.z(), a.x() * b.y() - a.y() * b.x()};
}

/// Adds the pair's three angles to the histogram of its first point. The point whose normal is closer to the
/// connecting line defines the frame, so the angles do not depend on the order of the two.
void add_pair(const Eigen::Vector3f& p, const Eigen::Vector3f& np, const Eigen::Vector3f& q,
              const Eigen::Vector3f& nq, float inverse_distance, float weight, Histogram& histogram) {
  Eigen::Vector3f d = (q - p) * inverse_distance;
  float along_p = np.dot(d), along_q = nq.dot(d);
  const bool swap = std::abs(along_p) < std::abs(along_q);
  if (swap) d = -d;
  const Eigen::Vector3f& u = swap ? nq : np;
  const Eigen::Vector3f& n = swap ? np : nq;
  const float phi = swap ? -along_q : along_p;
  Eigen::Vector3f v = cross(d, u);
  const float length = v.norm();
  if (length < 1e-6F) return;
  v /= length;
  const Eigen::Vector3f w = cross(u, v);
  histogram[bin(turn(w.dot(n), u.dot(n)))] += weight;
  histogram[kBins + bin(0.5F * (v.dot(n) + 1.0F))] += weight;
  histogram[2 * kBins + bin(0.5F * (phi + 1.0F))] += weight;
}

/// See fpfh().
template <class Surface>
Descriptors describe(const Surface& cloud, const KdTree& tree, const std::vector<std::uint32_t>& keys,
                     double radius_m, std::size_t max_neighbours) {
  const auto radius = static_cast<float>(radius_m);
  std::vector<Neighbour> found;
  const auto neighbours = [&](std::uint32_t i) {
    tree.within_unordered(cloud.points[i], radius, found);
    if (found.size() <= max_neighbours) return;
    const double step = static_cast<double>(found.size()) / static_cast<double>(max_neighbours);
    for (std::size_t k = 0; k < max_neighbours; ++k) {
      found[k] = found[static_cast<std::size_t>(static_cast<double>(k) * step)];
    }
    found.resize(max_neighbours);
  };

  // Simple histograms, made when a key point's neighbourhood first needs them.
  std::vector<std::int32_t> simple_of(tree.cloud_size(), -1);
  std::vector<Histogram, Eigen::aligned_allocator<Histogram>> simple;
  simple.reserve(std::min(tree.cloud_size(), keys.size() * max_neighbours));
  std::vector<Neighbour> of_key;
  Descriptors out(kFpfhSize, static_cast<Eigen::Index>(keys.size()));
  for (std::size_t k = 0; k < keys.size(); ++k) {
    neighbours(keys[k]);
    of_key = found;
    Histogram sum = Histogram::Zero();
    for (const Neighbour& neighbour : of_key) {
      const std::uint32_t i = neighbour.index;
      if (cloud.normals[i].isZero(0.0F)) continue;
      if (simple_of[i] < 0) {
        neighbours(i);
        Histogram histogram = Histogram::Zero();
        for (const Neighbour& other : found) {
          if (other.sq_distance_m2 == 0.0F || cloud.normals[other.index].isZero(0.0F)) continue;
          add_pair(cloud.points[i], cloud.normals[i], cloud.points[other.index], cloud.normals[other.index],
                   1.0F / std::sqrt(other.sq_distance_m2), 1.0F, histogram);
        }
        const float total = histogram.head<kBins>().sum();
        if (total > 0.0F) histogram /= total;
        simple_of[i] = static_cast<std::int32_t>(simple.size());
        simple.push_back(histogram);
      }
      // A neighbour at a quarter of the radius has the same weight as the point itself.
      const float weight = radius * radius / (16.0F * neighbour.sq_distance_m2 + 0.01F * radius * radius);
      sum += std::min(weight, 1.0F) * simple[static_cast<std::size_t>(simple_of[i])];
    }
    const float total = sum.sum();
    out.col(static_cast<Eigen::Index>(k)) =
        total > 0.0F ? Histogram((sum / total).cwiseSqrt()) : Histogram::Zero();
  }
  return out;
}

}  // namespace

Descriptors compute_fpfh(const PointNormalView& cloud, const KdTree& tree,
                         const std::vector<std::uint32_t>& keys, double radius_m,
                         std::size_t max_neighbours) {
  if (is_array(cloud)) return describe(arrays_of(cloud), tree, keys, radius_m, max_neighbours);
  return describe(SurfaceReader(cloud), tree, keys, radius_m, max_neighbours);
}

Descriptors fpfh(const PointNormalView& cloud, const KdTree& tree, const FpfhOptions& options) {
  std::vector<std::uint32_t> all(cloud.size());
  std::iota(all.begin(), all.end(), 0U);
  return fpfh(cloud, tree, options, all);
}

Descriptors fpfh(const PointNormalView& cloud, const KdTree& tree, const FpfhOptions& options,
                 const std::vector<std::uint32_t>& keys) {
  validate(options);
  detail::check_tree("fpfh", tree, cloud.points());
  for (const std::uint32_t key : keys) {
    if (key < cloud.size()) continue;
    throw InputError("fpfh: key point " + std::to_string(key) + " of a cloud of " +
                     std::to_string(cloud.size()) + " points: keys are indices of points");
  }
  const auto max_neighbours = static_cast<std::size_t>(options.max_neighbours);
  if (!check_normals("fpfh", cloud)) {
    return describe(SurfaceReader(cloud), tree, keys, options.radius_m, max_neighbours);
  }
  return compute_fpfh(cloud, tree, keys, options.radius_m, max_neighbours);
}

}  // namespace loopwise
