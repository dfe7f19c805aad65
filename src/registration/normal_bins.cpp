// SPDX-License-Identifier: BSD-3-Clause
#include "normal_bins.hpp"

#include <algorithm>
#include <array>

#include <loopwise/core/random.hpp>

#include "surface.hpp"

namespace loopwise {
namespace {

template <class Normals>
std::vector<std::uint32_t> draw(const Normals& normals, std::size_t size, std::size_t count) {
  std::array<std::vector<std::uint32_t>, kNormalBins> by_direction;
  for (std::uint32_t i = 0; i < size; ++i) by_direction[normal_bin(normals[i])].push_back(i);
  by_direction[kUnknownNormal].clear();
  Rng rng(size);
  std::size_t available = 0;
  for (auto& indices : by_direction) {
    rng.shuffle(indices);
    available += indices.size();
  }
  const std::size_t wanted = std::min(available, count);
  std::vector<std::uint32_t> drawn;
  drawn.reserve(wanted);
  while (drawn.size() < wanted) {
    for (auto& indices : by_direction) {
      if (indices.empty() || drawn.size() == wanted) continue;
      drawn.push_back(indices.back());
      indices.pop_back();
    }
  }
  return drawn;
}

}  // namespace

std::vector<std::uint32_t> draw_balanced(const PointCloud& cloud, std::size_t count) {
  return draw(cloud.normals, cloud.size(), count);
}

std::vector<std::uint32_t> draw_balanced(const PointNormalView& cloud, std::size_t count) {
  return draw(SurfaceReader(cloud).normals, cloud.size(), count);
}

}  // namespace loopwise
