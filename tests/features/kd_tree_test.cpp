// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/kd_tree.hpp>

#include <algorithm>
#include <limits>

#include <loopwise/core/random.hpp>
#include "testing.hpp"

namespace loopwise::kd_tree_test {
namespace {

using Points = std::vector<Eigen::Vector3f>;

/// Clouds that a tree may trip over: uniform, on a lattice (many equal distances), flat, on a line, in one
/// point.
Points cloud(int kind, std::size_t count, Rng& rng) {
  Points points;
  for (std::size_t i = 0; i < count; ++i) {
    const auto u = [&] { return static_cast<float>(rng.uniform(-10.0, 10.0)); };
    Eigen::Vector3f p(u(), u(), u());
    if (kind == 1) p = p.array().round();
    if (kind == 2) p.z() = 1.0F;
    if (kind == 3) p = Eigen::Vector3f(p.x(), 2.0F * p.x(), 3.0F);
    if (kind == 4) p = Eigen::Vector3f(1.0F, 2.0F, 3.0F);
    if (kind == 5) p += Eigen::Vector3f(1e5F, -1e5F, 1e5F);
    points.push_back(p);
  }
  return points;
}

std::vector<Neighbour> by_brute_force(const Points& points, const Eigen::Vector3f& query) {
  std::vector<Neighbour> all;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    const float dx = points[i].x() - query.x(), dy = points[i].y() - query.y(),
                dz = points[i].z() - query.z();
    all.push_back({i, dx * dx + dy * dy + dz * dz});
  }
  std::sort(all.begin(), all.end(), [](const Neighbour& a, const Neighbour& b) {
    return a.sq_distance_m2 != b.sq_distance_m2 ? a.sq_distance_m2 < b.sq_distance_m2 : a.index < b.index;
  });
  return all;
}

void require_same(const std::vector<Neighbour>& found, const std::vector<Neighbour>& expected,
                  std::size_t count) {
  REQUIRE(found.size() == count);
  for (std::size_t i = 0; i < count; ++i) {
    REQUIRE(found[i].sq_distance_m2 == expected[i].sq_distance_m2);
    REQUIRE(found[i].index == expected[i].index);
  }
}

TEST_CASE("KdTree finds the same points as brute force, ties by index", "[kd_tree][differential]") {
  const int kind = GENERATE(range(0, 6));
  const std::size_t count = GENERATE(1u, 2u, 8u, 9u, 16u, 17u, 33u, 65u, 100u, 200u, 513u, 1500u, 4097u);
  CAPTURE(kind, count);
  Rng rng(combine_seeds(static_cast<std::uint64_t>(kind), count));
  const Points points = cloud(kind, count, rng);
  const KdTree tree(points);
  REQUIRE(tree.size() == count);
  std::vector<Neighbour> found;
  for (int q = 0; q < 30; ++q) {
    const Eigen::Vector3f query = q % 2 == 0 ? points[rng.below(count)] : cloud(kind, 1, rng)[0];
    const std::vector<Neighbour> expected = by_brute_force(points, query);

    const auto nearest = tree.nearest(query);
    REQUIRE(nearest.has_value());
    REQUIRE(nearest->index == expected[0].index);
    REQUIRE(nearest->sq_distance_m2 == expected[0].sq_distance_m2);

    const std::size_t k = 1 + rng.below(60);
    tree.nearest(query, k, found);
    require_same(found, expected, std::min(k, count));

    const float radius = static_cast<float>(rng.uniform(0.0, 5.0));
    tree.within(query, radius, found);
    const auto inside =
        static_cast<std::size_t>(std::count_if(expected.begin(), expected.end(), [&](const Neighbour& n) {
          return n.sq_distance_m2 <= radius * radius;
        }));
    require_same(found, expected, inside);

    const auto limited = tree.nearest(query, radius);
    REQUIRE(limited.has_value() == (expected[0].sq_distance_m2 <= radius * radius));
    if (limited) REQUIRE(limited->index == expected[0].index);

    const auto two = tree.nearest_of_two(query, radius);
    REQUIRE(two.has_value() == limited.has_value());
    if (!two) continue;
    const float second = inside > 1 ? expected[1].sq_distance_m2 : radius * radius;
    REQUIRE(two->nearest.index == expected[0].index);
    REQUIRE(two->nearest.sq_distance_m2 == expected[0].sq_distance_m2);
    REQUIRE(two->sq_second_m2 == second);
  }
}

TEST_CASE("KdTree: what is searched at the end of the range of floats", "[kd_tree]") {
  constexpr float kInfinity = std::numeric_limits<float>::infinity(), kHuge = 1e18F;
  const Points points{{kHuge, kHuge, kHuge}, {0.0F, 0.0F, 0.0F}, {-kHuge, 0.0F, 0.0F}};
  const KdTree tree(points);
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    CAPTURE(i);
    REQUIRE(tree.nearest(points[i])->index == i);
    REQUIRE(tree.nearest(points[i], kInfinity)->index == i);
    REQUIRE(tree.nearest(points[i], 0.0F)->index == i);
    REQUIRE(tree.nearest_of_two(points[i])->nearest.index == i);
    REQUIRE_FALSE(tree.nearest(points[i], std::numeric_limits<float>::quiet_NaN()).has_value());
    std::vector<Neighbour> found;
    tree.nearest(points[i], 5, found);
    REQUIRE(found.size() == points.size());
    tree.within(points[i], kInfinity, found);
    REQUIRE(found.size() == points.size());
    for (const Neighbour& neighbour : found) REQUIRE(neighbour.index < points.size());
  }
}

TEST_CASE("KdTree without points finds nothing", "[kd_tree]") {
  for (const KdTree& tree : {KdTree(), KdTree(Points{})}) {
    std::vector<Neighbour> found{{7, 1.0F}};
    REQUIRE(tree.empty());
    REQUIRE_FALSE(tree.nearest(Eigen::Vector3f::Zero()).has_value());
    REQUIRE_FALSE(tree.nearest_of_two(Eigen::Vector3f::Zero()).has_value());
    tree.nearest(Eigen::Vector3f::Zero(), 3, found);
    REQUIRE(found.empty());
    tree.within(Eigen::Vector3f::Zero(), 3.0F, found);
    REQUIRE(found.empty());
  }
}

TEST_CASE("KdTree leaves out points that are not finite and keeps the indices of the others",
          "[kd_tree][differential]") {
  const int kind = GENERATE(range(0, 6));
  CAPTURE(kind);
  Rng rng(static_cast<std::uint64_t>(kind));
  Points points = cloud(kind, 500, rng);
  for (std::size_t i = 0; i < points.size(); i += 7) {
    points[i][static_cast<Eigen::Index>(i % 3)] =
        i % 2 == 0 ? std::numeric_limits<float>::quiet_NaN() : -std::numeric_limits<float>::infinity();
  }
  std::vector<Eigen::Vector3d> wide;  // the same in another type
  Points kept;
  std::vector<std::uint32_t> indices;
  for (std::uint32_t i = 0; i < points.size(); ++i) {
    wide.push_back(points[i].cast<double>());
    if (!points[i].allFinite()) continue;
    kept.push_back(points[i]);
    indices.push_back(i);
  }
  const KdTree tree(points);
  REQUIRE(tree.size() == 428);
  REQUIRE(tree.cloud_size() == 500);
  std::vector<Neighbour> found;
  for (int q = 0; q < 30; ++q) {
    const Eigen::Vector3f query = cloud(kind, 1, rng)[0];
    std::vector<Neighbour> expected = by_brute_force(kept, query);
    for (Neighbour& n : expected) n.index = indices[n.index];  // rising, so that ties keep their order
    tree.nearest(query, 1000, found);
    require_same(found, expected, 428);
    if (kind != 5) {
      KdTree(wide).nearest(query, 1000, found);
      require_same(found, expected, 428);
    }
    const float infinity = std::numeric_limits<float>::infinity();
    for (const float value : {std::numeric_limits<float>::quiet_NaN(), infinity, -infinity}) {
      Eigen::Vector3f gap = query;
      gap[q % 3] = value;
      REQUIRE_FALSE(tree.nearest(gap).has_value());
      tree.nearest(gap, 3, found);
      REQUIRE(found.empty());
      for (const float radius : {1e6F, infinity}) {
        tree.within(gap, radius, found);
        REQUIRE(found.empty());
      }
    }
  }
  if (kind == 5) REQUIRE_THROWS_WITH(KdTree(wide), Contains("subtract an offset from its points"));
}

}  // namespace
}  // namespace loopwise::kd_tree_test
