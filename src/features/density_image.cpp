// SPDX-License-Identifier: BSD-3-Clause
#include "density_image.hpp"

#include "../core/constants.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <loopwise/core/random.hpp>

namespace loopwise {
namespace {

int bit_count(std::uint64_t x) {
  // Replaces __builtin_popcountll, which is a function call on processors without the instruction.
  x -= (x >> 1) & 0x5555555555555555ULL;
  x = (x & 0x3333333333333333ULL) + ((x >> 2) & 0x3333333333333333ULL);
  x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fULL;
  return static_cast<int>((x * 0x0101010101010101ULL) >> 56);
}

using Image = Eigen::ArrayXXf;  // (x, y)

/// Gaussian blur; the image is zero outside.
Image blurred(const Image& image, float sigma) {
  const int reach = static_cast<int>(std::ceil(2.5F * sigma));
  Eigen::VectorXf kernel(2 * reach + 1);
  for (int i = -reach; i <= reach; ++i)
    kernel[i + reach] = std::exp(-0.5F * static_cast<float>(i * i) / (sigma * sigma));
  kernel /= kernel.sum();
  const Eigen::Index n = image.rows();
  const auto along = [&](const Image& in) {  // along columns, which are contiguous in memory
    Image out = Image::Zero(n, n);
    for (int i = -reach; i <= reach; ++i) {
      const Eigen::Index count = n - std::abs(i);
      if (count <= 0) continue;
      out.middleCols(i < 0 ? -i : 0, count) += kernel[i + reach] * in.middleCols(i < 0 ? 0 : i, count);
    }
    return out;
  };
  const Image once = along(image);
  return along(once.transpose()).transpose();
}

/// Gradient of an image along x and y, and zero at its edge.
std::pair<Image, Image> gradient(const Image& image) {
  const Eigen::Index n = image.rows();
  std::pair<Image, Image> g{Image::Zero(n, n), Image::Zero(n, n)};
  if (n < 3) return g;
  g.first.middleRows(1, n - 2) = 0.5F * (image.bottomRows(n - 2) - image.topRows(n - 2));
  g.second.middleCols(1, n - 2) = 0.5F * (image.rightCols(n - 2) - image.leftCols(n - 2));
  return g;
}

struct Corner {
  float response;
  int x, y;
};

/// Local maxima of the smaller eigenvalue of the structure tensor (Shi, Tomasi 1994), strongest first.
std::vector<Corner> corners(const Image& gx, const Image& gy, std::size_t most) {
  constexpr float kWindow = 1.5F;  // cells
  constexpr int kApart = 2;        // cells
  constexpr float kLeast = 1e-4F;
  const Image a = blurred(gx * gx, kWindow), b = blurred(gx * gy, kWindow), c = blurred(gy * gy, kWindow);
  const Image response = 0.5F * (a + c) - (0.25F * (a - c).square() + b.square()).sqrt();
  const int n = static_cast<int>(response.rows());
  std::vector<Corner> found;
  for (int y = kApart; y < n - kApart; ++y) {
    for (int x = kApart; x < n - kApart; ++x) {
      const float r = response(x, y);
      if (r > kLeast &&
          r >= response.block<2 * kApart + 1, 2 * kApart + 1>(x - kApart, y - kApart).maxCoeff())
        found.push_back({r, x, y});
    }
  }
  std::sort(found.begin(), found.end(), [](const Corner& p, const Corner& q) {
    return p.response != q.response ? p.response > q.response : std::pair(p.x, p.y) < std::pair(q.x, q.y);
  });
  if (found.size() > most) found.resize(most);
  return found;
}

/// Direction from a corner to the centroid of the intensity around it (Rosin 1999), as in ORB. Returns false
/// if the centroid is at the corner.
bool direction(const Image& image, const Corner& corner, float& angle) {
  constexpr int kReach = 12;  // cells
  constexpr float kLeastShare = 0.02F;
  const int n = static_cast<int>(image.rows());
  float mx = 0.0F, my = 0.0F, mass = 0.0F;
  for (int dy = -kReach; dy <= kReach; ++dy) {
    for (int dx = -kReach; dx <= kReach; ++dx) {
      const int x = corner.x + dx, y = corner.y + dy;
      if (x < 0 || y < 0 || x >= n || y >= n || dx * dx + dy * dy > kReach * kReach) continue;
      const float v = image(x, y);
      mx += static_cast<float>(dx) * v;
      my += static_cast<float>(dy) * v;
      mass += v;
    }
  }
  angle = std::atan2(my, mx);
  return std::hypot(mx, my) > kLeastShare * static_cast<float>(kReach) * mass;
}

constexpr int kBins = 4, kDirections = 8, kLength = kBins * kBins * kDirections;
/// Histograms of gradient directions around a corner, minus their mean. The frame rotates with the corner's
/// direction (Lowe 2004).
Eigen::VectorXf surroundings(const Image& gx, const Image& gy, const Corner& corner, float angle) {
  constexpr float kBin = 7.0F;  // cells
  constexpr int kReach = 20;    // cells: the corner of the window
  const int n = static_cast<int>(gx.rows());
  const float c = std::cos(angle), s = std::sin(angle);
  Eigen::VectorXf histogram = Eigen::VectorXf::Zero(kLength);
  for (int dy = -kReach; dy <= kReach; ++dy) {
    for (int dx = -kReach; dx <= kReach; ++dx) {
      const int x = corner.x + dx, y = corner.y + dy;
      if (x < 0 || y < 0 || x >= n || y >= n) continue;
      const float g = std::hypot(gx(x, y), gy(x, y));
      if (!(g > 0.0F)) continue;
      const auto fx = static_cast<float>(dx), fy = static_cast<float>(dy);
      const float u = (c * fx + s * fy) / kBin + 0.5F * kBins - 0.5F;
      const float v = (c * fy - s * fx) / kBin + 0.5F * kBins - 0.5F;
      if (u <= -1.0F || v <= -1.0F || u >= kBins || v >= kBins) continue;
      float turn = (std::atan2(gy(x, y), gx(x, y)) - angle) / (2.0F * kPiFloat);
      turn = (turn - std::floor(turn)) * kDirections;
      const float u0 = std::floor(u), v0 = std::floor(v), d0 = std::floor(turn);
      for (int corner_bin = 0; corner_bin < 8; ++corner_bin) {
        const int iu = corner_bin & 1, iv = (corner_bin >> 1) & 1, id = corner_bin >> 2;
        const int bu = static_cast<int>(u0) + iu, bv = static_cast<int>(v0) + iv;
        if (bu < 0 || bv < 0 || bu >= kBins || bv >= kBins) continue;
        const int bd = (static_cast<int>(d0) + id) % kDirections;
        const float w = (iu != 0 ? u - u0 : 1.0F - u + u0) * (iv != 0 ? v - v0 : 1.0F - v + v0) *
                        (id != 0 ? turn - d0 : 1.0F - turn + d0);
        histogram[(bv * kBins + bu) * kDirections + bd] += w * g;
      }
    }
  }
  const float norm = histogram.norm();
  if (!(norm > 0.0F)) return histogram;
  histogram = (histogram / norm).cwiseMin(0.3F);  // limits the influence of a single wall
  histogram.array() -= histogram.mean();
  return histogram;
}

/// Random hyperplanes. Each bit of a feature states the side of one hyperplane on which its vector lies
/// (Charikar 2002).
const Eigen::MatrixXf& hyperplanes() {
  static const Eigen::MatrixXf planes = [] {
    Rng rng(0x706c616365ULL);
    Eigen::MatrixXf normals(64 * PlaceBits::kWords, kLength);
    for (Eigen::Index i = 0; i < normals.size(); ++i) normals.data()[i] = static_cast<float>(rng.normal());
    return normals;
  }();
  return planes;
}

void prune_similar(std::vector<PlaceFeature>& features) {
  constexpr int kAlike = 40;  // bits
  std::vector<bool> alike(features.size(), false);
  for (std::size_t i = 0; i < features.size(); ++i) {
    for (std::size_t j = i + 1; j < features.size(); ++j) {
      if (differing_bits(features[i].bits, features[j].bits) <= kAlike) alike[i] = alike[j] = true;
    }
  }
  std::size_t kept = 0;
  for (std::size_t i = 0; i < features.size(); ++i) {
    if (!alike[i]) features[kept++] = features[i];
  }
  features.resize(kept);
}

}  // namespace

int DensityImage::column(float coordinate_m) const {
  return static_cast<int>(std::floor(coordinate_m / cell_m + 0.5F * static_cast<float>(size)));
}

float ground_height(const std::vector<Eigen::Vector3f>& points) {
  constexpr float kNear_m = 8.0F;
  constexpr std::size_t kFew = 50;
  std::vector<float> z;
  for (const Eigen::Vector3f& point : points) {
    if (point.head<2>().squaredNorm() < kNear_m * kNear_m) z.push_back(point.z());
  }
  std::size_t low = z.size() / 10;
  if (z.size() < kFew) {
    z.clear();
    for (const Eigen::Vector3f& point : points) z.push_back(point.z());
    low = z.size() / 50;
  }
  if (z.empty()) return 0.0F;
  const auto at = z.begin() + static_cast<std::ptrdiff_t>(low);
  std::nth_element(z.begin(), at, z.end());
  return *at;
}

DensityImage density_image(const PointCloud& level, double cell_m, double range_m) {
  constexpr int kBelow = 12, kLevels = 64;  // voxels of a column below the ground, and in total
  DensityImage image;
  image.cell_m = static_cast<float>(cell_m);
  image.size = std::max(8, 2 * static_cast<int>(std::ceil(range_m / cell_m)));
  image.ground_m = ground_height(level.points);
  const auto size = static_cast<std::size_t>(image.size);
  std::vector<std::uint64_t> filled(size * size, 0);
  const auto limit = static_cast<float>(range_m);
  for (const Eigen::Vector3f& point : level.points) {
    if (!(point.head<2>().cwiseAbs().maxCoeff() < limit) || !std::isfinite(point.z())) continue;
    const int x = image.column(point.x()), y = image.column(point.y());
    if (x < 0 || y < 0 || x >= image.size || y >= image.size) continue;
    const float up = std::clamp((point.z() - image.ground_m) / image.cell_m + static_cast<float>(kBelow),
                                0.0F, static_cast<float>(kLevels - 1));
    filled[static_cast<std::size_t>(y) * size + static_cast<std::size_t>(x)] |= std::uint64_t{1}
                                                                                << static_cast<int>(up);
  }
  image.heights.reserve(filled.size());
  for (const std::uint64_t column : filled)
    image.heights.push_back(static_cast<std::uint8_t>(bit_count(column)));
  return image;
}

std::vector<PlaceFeature> place_features(const DensityImage& image, std::size_t most) {
  constexpr int kHighest = 8;  // voxels; higher columns have the same density
  Image density(image.size, image.size);
  for (Eigen::Index i = 0; i < density.size(); ++i) {
    // A column with ground alone has density zero.
    density.data()[i] =
        static_cast<float>(std::clamp(image.heights[static_cast<std::size_t>(i)] - 1, 0, kHighest)) /
        kHighest;
  }
  const Image smooth = blurred(density, 1.0F);
  const auto [gx, gy] = gradient(smooth);
  std::vector<PlaceFeature> features;
  std::vector<Eigen::VectorXf> vectors;
  for (const Corner& corner : corners(gx, gy, most)) {
    PlaceFeature feature;
    if (!direction(smooth, corner, feature.angle)) continue;
    const Eigen::VectorXf around = surroundings(gx, gy, corner, feature.angle);
    if (around.isZero(0.0F)) continue;
    feature.position << image.middle(static_cast<float>(corner.x)),
        image.middle(static_cast<float>(corner.y));
    features.push_back(feature);
    vectors.push_back(around);
  }
  for (std::size_t i = 0; i < features.size(); ++i) {
    const Eigen::VectorXf sides = hyperplanes() * vectors[i];
    for (std::size_t b = 0; b < 64 * PlaceBits::kWords; ++b) {
      if (sides[static_cast<Eigen::Index>(b)] > 0.0F)
        features[i].bits.words[b / 64] |= std::uint64_t{1} << (b % 64);
    }
  }
  prune_similar(features);
  return features;
}

}  // namespace loopwise
