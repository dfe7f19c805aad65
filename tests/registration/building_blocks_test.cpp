// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The steps of a registration as functions of their own, on clouds of every kind.
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/registration/align.hpp>
#include <loopwise/registration/consensus.hpp>
#include <loopwise/registration/fpfh.hpp>
#include <loopwise/registration/gicp.hpp>
#include <loopwise/registration/matching.hpp>

#ifdef LOOPWISE_WITH_PCL
#include <pcl/PCLPointCloud2.h>
#include <pcl/conversions.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#endif

#include <cstring>
#include <limits>
#include <vector>

#include <Eigen/LU>

#include "scene.hpp"
#include "testing.hpp"

namespace other {

/// A point of another program.
struct Echo {
  double time = 0.0;
  float x = 0, y = 0, z = 0;
  float nx = 0, ny = 0, nz = 0;
};

/// A cloud of another program, without operator[] and without floats in memory.
struct Map {
  Eigen::MatrixXd rows;
};

}  // namespace other

namespace loopwise {

template <>
struct PointCloudTraits<other::Map> {
  static std::size_t size(const other::Map& map) { return static_cast<std::size_t>(map.rows.rows()); }
  static Eigen::Vector3d point(const other::Map& map, std::size_t i) {
    return map.rows.row(static_cast<Eigen::Index>(i)).head<3>();
  }
  static PointView normals(const other::Map& map) {
    return PointView::by_function(&map, size(map), [](const void* m, std::size_t i) {
      const auto& rows = static_cast<const other::Map*>(m)->rows;
      return Eigen::Vector3d(rows.row(static_cast<Eigen::Index>(i)).tail<3>());
    });
  }
};

}  // namespace loopwise

namespace loopwise::building_blocks_test {

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

/// A cloud with normals in the types of this file. All hold the same numbers.
struct Kinds {
  explicit Kinds(const PointCloud& points) : cloud(points) {
    constexpr std::size_t kStep = 29;  // odd, so that most numbers are not aligned
    bytes.assign(kStep * cloud.size(), 0xff);
    map.rows.resize(static_cast<Eigen::Index>(cloud.size()), 6);
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const Eigen::Vector3f &p = cloud.points[i], &n = cloud.normals[i];
      echoes.push_back({1.0, p.x(), p.y(), p.z(), n.x(), n.y(), n.z()});
      std::memcpy(bytes.data() + kStep * i + 3, p.data(), 12);
      std::memcpy(bytes.data() + kStep * i + 15, n.data(), 12);
      map.rows.row(static_cast<Eigen::Index>(i)) << p.transpose().cast<double>(),
          n.transpose().cast<double>();
    }
    buffer.data = bytes.data();
    buffer.bytes = bytes.size();
    buffer.points = cloud.size();
    buffer.stride = kStep;
    buffer.offsets = {3, 7, 11};
    normals = buffer;
    normals.offsets = {15, 19, 23};
#ifdef LOOPWISE_WITH_PCL
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      pcl.emplace_back();
      pcl.back().getVector3fMap() = cloud.points[i];
      pcl.back().getNormalVector3fMap() = cloud.normals[i];
    }
    pcl::toPCLPointCloud2(pcl, message);
#endif
  }

  [[nodiscard]] std::vector<std::pair<const char*, PointNormalView>> all() const {
    std::vector<std::pair<const char*, PointNormalView>> out;
    out.emplace_back("loopwise::PointCloud", cloud);
    out.emplace_back("vectors of Eigen", PointNormalView(cloud.points, cloud.normals));
    out.emplace_back("own struct", PointNormalView(echoes, PointView(echoes, &other::Echo::nx,
                                                                     &other::Echo::ny, &other::Echo::nz)));
    out.emplace_back("own traits", map);
    out.emplace_back("bytes", PointNormalView(buffer, normals));
#ifdef LOOPWISE_WITH_PCL
    out.emplace_back("pcl::PointCloud", pcl);
    out.emplace_back("pcl::PCLPointCloud2", message);
#endif
    return out;
  }

  PointCloud cloud;
  std::vector<other::Echo> echoes;
  other::Map map;
  std::vector<unsigned char> bytes;
  PointBuffer buffer, normals;
#ifdef LOOPWISE_WITH_PCL
  pcl::PointCloud<pcl::PointNormal> pcl;
  pcl::PCLPointCloud2 message;
#endif
};

/// Two scans of one place with normals, and the motion between them.
struct Scans {
  explicit Scans(std::uint64_t seed = 3, std::size_t points = 6000) {
    const testing::Scene scene(seed);
    Rng rng(seed + 1);
    const Eigen::Isometry3d T_w_target = testing::ground_pose(0.0, 0.0, 0.1);
    const Eigen::Isometry3d T_w_source = testing::ground_pose(1.5, -0.7, 0.5);
    target = prepared(*scene.scan(T_w_target, points, rng));
    source = prepared(*scene.scan(T_w_source, points, rng));
    T_target_source = T_w_target.inverse() * T_w_source;
  }
  static PointCloud prepared(const PointCloud& scan) {
    PointCloud cloud = voxel_downsample(scan, 0.5);
    cloud.normals = estimate_normals(cloud.points, KdTree(cloud.points));
    return cloud;
  }
  [[nodiscard]] Eigen::Isometry3d guess() const {
    Vector6d offset;
    offset << 0.4, -0.3, 0.1, 0.01, -0.02, 0.1;
    return T_target_source * se3::exp(offset);
  }
  PointCloud target, source;
  Eigen::Isometry3d T_target_source;
};

void require_same(const GicpResult& a, const GicpResult& b) {
  REQUIRE(a.T_target_source.matrix() == b.T_target_source.matrix());  // every bit
  REQUIRE(a.converged == b.converged);
  REQUIRE(a.iterations == b.iterations);
  REQUIRE(a.matches == b.matches);
  REQUIRE(a.points_used == b.points_used);
}

TEST_CASE("building blocks: every kind of cloud gives the same bits", "[blocks][differential]") {
  const Scans scans;
  const Kinds target(scans.target), source(scans.source);
  const KdTree tree(scans.target.points), source_tree(scans.source.points);
  const PointCloud thin = voxel_downsample(scans.target, 1.0);
  const Descriptors described = fpfh(scans.target, tree);
  const auto matches = match_descriptors(described, fpfh(scans.source, source_tree));
  REQUIRE(matches.size() == 1000);
  const std::vector<Match> pairs = matched_points(scans.target, scans.source, matches);
  const GicpResult refined = gicp(scans.target, tree, scans.source, scans.guess());
  REQUIRE(refined.converged);
  const AlignResult aligned = align(scans.target, scans.source);
  REQUIRE(aligned.success);

  Rng rng(5);
  const auto sources = source.all();
  std::size_t kind = 0;
  for (const auto& [name, view] : target.all()) {
    CAPTURE(name);
    const KdTree same(view.points());
    for (int q = 0; q < 50; ++q) {
      const Eigen::Vector3f query(static_cast<float>(rng.uniform(-20, 20)),
                                  static_cast<float>(rng.uniform(-20, 20)),
                                  static_cast<float>(rng.uniform(-2, 3)));
      REQUIRE(same.nearest(query)->index == tree.nearest(query)->index);
      REQUIRE(same.nearest(query)->sq_distance_m2 == tree.nearest(query)->sq_distance_m2);
    }
    REQUIRE(voxel_downsample(view.points(), 1.0).points == thin.points);
    REQUIRE(estimate_normals(view.points(), same) == scans.target.normals);
    REQUIRE(fpfh(view, same) == described);
    const PointNormalView& from = sources[kind++].second;
    const std::vector<Match> these = matched_points(view, from, matches);
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      REQUIRE(these[i].source == pairs[i].source);
      REQUIRE(these[i].target == pairs[i].target);
      REQUIRE(these[i].source_normal == pairs[i].source_normal);
      REQUIRE(these[i].target_normal == pairs[i].target_normal);
    }
    require_same(gicp(view, same, from, scans.guess()), refined);
    require_same(gicp(view, same, scans.source, scans.guess()), refined);
    const AlignResult again = align(view.points(), from.points());
    REQUIRE(again.T_target_source.matrix() == aligned.T_target_source.matrix());
    REQUIRE(again.covariance == aligned.covariance);
  }
}

TEST_CASE("building blocks: from two scans to their transform, without a guess", "[blocks]") {
  const std::uint64_t seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  const Scans scans(seed, 15000);
  const KdTree target_tree(scans.target), source_tree(scans.source);
  const auto matches = match_descriptors(fpfh(scans.target, target_tree), fpfh(scans.source, source_tree));
  const Consensus found = consensus(matched_points(scans.target, scans.source, matches));
  REQUIRE_FALSE(found.hypotheses.empty());
  const GicpResult result =
      gicp(scans.target, target_tree, scans.source, found.hypotheses.front().T_target_source);
  REQUIRE(result.converged);
  const Vector6d error = se3::log(scans.T_target_source.inverse() * result.T_target_source);
  REQUIRE(error.head<3>().norm() < 0.03);   // measured at most 0.010 m
  REQUIRE(error.tail<3>().norm() < 0.003);  // measured at most 0.00035 rad
  REQUIRE(result.points_used == 2000);
  REQUIRE(result.matches > result.points_used / 2);
}

/// The cost of gicp(), written out with matrices, for the pairs and covariances at one pose.
class Cost {
 public:
  Cost(const PointCloud& target, const PointCloud& source, const Eigen::Isometry3d& T, double reach_m)
      : sq_scale_(reach_m * reach_m / 9.0) {
    constexpr double kFlatness = 0.001;
    const auto covariance = [&](const Eigen::Vector3d& n) -> Eigen::Matrix3d {
      return Eigen::Matrix3d::Identity() - (1.0 - kFlatness) * n * n.transpose();
    };
    for (std::size_t i = 0; i < source.size(); ++i) {
      if (source.normals[i].isZero()) continue;
      const Eigen::Vector3d p = source.points[i].cast<double>();
      std::size_t nearest = 0;  // by brute force
      double sq_least = std::numeric_limits<double>::infinity();
      for (std::size_t j = 0; j < target.size(); ++j) {
        const double sq = (T * p - target.points[j].cast<double>()).squaredNorm();
        if (sq < sq_least) sq_least = sq, nearest = j;
      }
      const Eigen::Vector3d m = T.linear() * source.normals[i].cast<double>(),
                            n = target.normals[nearest].cast<double>();
      if (sq_least > reach_m * reach_m || n.dot(m) < 0.0) continue;
      pairs_.push_back({p, target.points[nearest].cast<double>(),
                        2.0 * kFlatness * (covariance(n) + covariance(m)).inverse()});
    }
  }
  [[nodiscard]] double operator()(const Eigen::Isometry3d& T) const {
    double sum = 0.0;
    for (const Pair& pair : pairs_) {
      const Eigen::Vector3d d = T * pair.source - pair.target;
      const double sq = d.dot(pair.information * d);
      sum += sq_scale_ * sq / (sq_scale_ + sq);
    }
    return sum;
  }
  [[nodiscard]] std::size_t pairs() const { return pairs_.size(); }

 private:
  struct Pair {
    Eigen::Vector3d source, target;
    Eigen::Matrix3d information;
  };
  double sq_scale_;
  std::vector<Pair> pairs_;
};

TEST_CASE("gicp: ends at the minimum of its cost", "[blocks][differential]") {
  const std::uint64_t seed = GENERATE(range(1u, 4u));
  CAPTURE(seed);
  const Scans scans(seed);
  GicpOptions options;
  options.fine_points = 100000;
  const GicpResult result = gicp(scans.target, KdTree(scans.target), scans.source, scans.guess(), options);
  REQUIRE(result.converged);
  const Cost cost(scans.target, scans.source, result.T_target_source, options.fine_reach_m);
  REQUIRE(cost.pairs() > 500);
  // The pairs are those of the last iteration but for a few, measured at most 5 of 3400: its step was short.
  REQUIRE(std::abs(static_cast<double>(cost.pairs()) - static_cast<double>(result.matches)) < 20.0);
  const double least = cost(result.T_target_source);
  for (Eigen::Index axis = 0; axis < 6; ++axis) {
    CAPTURE(axis);
    const double h = axis < 3 ? 0.01 : 0.001;
    const auto moved = [&](double by) {
      const Vector6d offset = by * Vector6d::Unit(axis);
      return cost(result.T_target_source * se3::exp(offset));
    };
    const double up = moved(h), down = moved(-h);
    REQUIRE(up > least);
    REQUIRE(down > least);
    // The vertex of the parabola through the three costs.
    const double offset = 0.5 * h * (down - up) / (down - 2.0 * least + up);
    REQUIRE(std::abs(offset) < 0.1 * h);  // measured at most 0.0004 m and 0.000013 rad
  }
}

TEST_CASE("building blocks: points and normals that are not finite are gaps", "[blocks][error]") {
  Scans scans;
  std::size_t gaps = 0;
  for (std::size_t i = 0; i + 1 < scans.target.size(); i += 10, ++gaps) {
    scans.target.points[i].y() = i % 20 == 0 ? kNan : std::numeric_limits<float>::infinity();
    scans.target.normals[i + 1].z() = kNan;
  }
  for (std::size_t i = 0; i + 1 < scans.source.size(); i += 10) {
    scans.source.points[i].x() = kNan;
    scans.source.normals[i + 1].setConstant(kNan);
  }
  const Kinds target(scans.target), source(scans.source);
  const KdTree tree(scans.target);
  REQUIRE(tree.size() == scans.target.size() - gaps);
  REQUIRE(tree.cloud_size() == scans.target.size());
  std::vector<Neighbour> all;
  tree.within(Eigen::Vector3f::Zero(), 1e3F, all);
  REQUIRE(all.size() == tree.size());
  for (const Neighbour& n : all) REQUIRE(scans.target.points[n.index].allFinite());
  REQUIRE_FALSE(tree.nearest(Eigen::Vector3f(kNan, 0.0F, 0.0F)).has_value());
  tree.nearest(Eigen::Vector3f(0.0F, kNan, 0.0F), 3, all);
  REQUIRE(all.empty());

  const auto normals = estimate_normals(scans.target, tree);
  REQUIRE(normals.size() == scans.target.size());
  for (std::size_t i = 0; i < normals.size(); ++i) {
    REQUIRE(normals[i].allFinite());
    if (!scans.target.points[i].allFinite()) REQUIRE(normals[i].isZero());
  }
  REQUIRE(voxel_downsample(PointView(scans.target), 1e-3).size() == tree.size());

  const Descriptors described = fpfh(scans.target, tree);
  REQUIRE(described.allFinite());
  REQUIRE(described.col(0).isZero());
  REQUIRE(described.col(20).isZero());
  const GicpResult refined = gicp(scans.target, tree, scans.source, scans.guess());
  REQUIRE(refined.converged);
  const Vector6d error = se3::log(scans.T_target_source.inverse() * refined.T_target_source);
  REQUIRE(error.head<3>().norm() < 0.05);  // measured 0.021 m
  REQUIRE(error.tail<3>().norm() < 0.01);  // measured 0.0007 rad
  const auto sources = source.all();
  std::size_t kind = 0;
  for (const auto& [name, view] : target.all()) {
    CAPTURE(name);
    REQUIRE(fpfh(view, KdTree(view.points())) == described);
    require_same(gicp(view, KdTree(view.points()), sources[kind++].second, scans.guess()), refined);
  }
}

TEST_CASE("fpfh: key points have the columns of all points", "[blocks]") {
  const Scans scans;
  const KdTree tree(scans.target);
  FpfhOptions options;
  options.radius_m = 2.0;
  const Descriptors all = fpfh(scans.target, tree, options);
  REQUIRE(static_cast<std::size_t>(all.cols()) == scans.target.size());
  const std::vector<std::uint32_t> keys{7, 300, 7, 41};
  const Descriptors some = fpfh(scans.target, tree, options, keys);
  REQUIRE(some.cols() == 4);
  for (std::size_t k = 0; k < keys.size(); ++k) {
    REQUIRE(some.col(static_cast<Eigen::Index>(k)) == all.col(keys[k]));
    REQUIRE(some.col(static_cast<Eigen::Index>(k)).norm() == Approx(1.0).margin(1e-4));
  }
}

TEST_CASE("match_descriptors: mutual matches first, the most similar first, zero columns never", "[blocks]") {
  const Scans scans;
  Descriptors target = fpfh(scans.target, KdTree(scans.target));
  const Descriptors source = fpfh(scans.source, KdTree(scans.source));
  target.leftCols(target.cols() / 2).setZero();
  const auto matches = match_descriptors(target, source, 100000);
  REQUIRE(matches.size() > 500);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    REQUIRE(matches[i].target >= target.cols() / 2);
    if (i == 0) continue;
    REQUIRE(matches[i - 1].mutual >= matches[i].mutual);
    if (matches[i - 1].mutual == matches[i].mutual)
      REQUIRE(matches[i - 1].similarity >= matches[i].similarity);
  }
  const auto best = match_descriptors(target, source, 10);
  REQUIRE(best.size() == 10);
  REQUIRE(best[9].source == matches[9].source);
  REQUIRE(match_descriptors(Descriptors::Zero(kFpfhSize, 5), source).empty());
  REQUIRE(match_descriptors(Descriptors(kFpfhSize, 0), source).empty());
}

TEST_CASE("consensus: without normals distances decide", "[blocks]") {
  const std::uint64_t seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  Rng rng(seed);
  const Eigen::Isometry3d truth = testing::random_pose(rng, 10.0, 3.0);
  std::vector<Match> matches(600);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const auto anywhere = [&] {
      return Eigen::Vector3d(rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-3, 3));
    };
    const Eigen::Vector3d p = anywhere();
    matches[i].source = p.cast<float>();
    matches[i].target = (i % 10 == 0 ? Eigen::Vector3d(truth * p) : anywhere()).cast<float>();
    // A normal of one side alone is as good as none.
    if (i % 3 == 0) matches[i].source_normal = Eigen::Vector3f::UnitX();
  }
  const Consensus found = consensus(matches);
  REQUIRE_FALSE(found.hypotheses.empty());
  REQUIRE(found.hypotheses[0].inliers >= 60);
  REQUIRE(testing::difference(found.hypotheses[0].T_target_source, truth) <
          1e-5);  // measured 2e-7: points in float
}

TEST_CASE("building blocks: clouds in world coordinates keep their digits or are refused",
          "[blocks][error]") {
  const Scans scans;
  const Eigen::Vector3d offset(5e5, 4e6, 100.0);
  std::vector<Eigen::Vector3d> world;
  for (const Eigen::Vector3f& p : scans.target.points) world.push_back(p.cast<double>() + offset);
  REQUIRE_THROWS_WITH(KdTree(world),
                      "KdTree: the cloud is in world coordinates, where a float loses digits: subtract an "
                      "offset from its points, as voxel_downsample() does");
  REQUIRE_THROWS_WITH(gicp(scans.target, KdTree(scans.target), {world, scans.target.normals}),
                      Contains("gicp: the source is in world coordinates"));
  const PointCloud thin = voxel_downsample(world, 0.01);
  REQUIRE(thin.origin == Eigen::Vector3d(thin.origin.array().round()));
  REQUIRE((thin.origin - offset).norm() < 30.0);
  REQUIRE(thin.size() > scans.target.size() - 5);
  const KdTree tree(thin.points);
  double worst_m = 0.0;
  for (const Eigen::Vector3d& p : world) {
    const auto nearest = tree.nearest((p - thin.origin).cast<float>());
    worst_m = std::max(worst_m, std::sqrt(static_cast<double>(nearest->sq_distance_m2)));
  }
  REQUIRE(worst_m < 0.01);
  // A few far points among near ones are outliers.
  world.assign(scans.target.points.size(), Eigen::Vector3d::Zero());
  world.back() = offset;
  REQUIRE(KdTree(world).size() == world.size());
  REQUIRE(voxel_downsample(world, 0.5).origin.isZero());
}

TEST_CASE("estimate_normals: towards the given sensor", "[blocks]") {
  Rng rng(7);
  std::vector<Eigen::Vector3f> plane;  // z = 2 + 0.5 x
  for (int i = 0; i < 500; ++i) {
    const auto x = static_cast<float>(rng.uniform(-5, 5));
    plane.emplace_back(x, static_cast<float>(rng.uniform(-5, 5)), 2.0F + 0.5F * x);
  }
  const KdTree tree(plane);
  const Eigen::Vector3f normal = Eigen::Vector3f(-0.5F, 0.0F, 1.0F).normalized();
  for (const Eigen::Vector3f& n : estimate_normals(plane, tree)) REQUIRE((n + normal).norm() < 1e-3F);
  for (const Eigen::Vector3f& n : estimate_normals(plane, tree, 10, {0.0, 0.0, 10.0})) {
    REQUIRE((n - normal).norm() < 1e-3F);
  }
}

TEST_CASE("building blocks: clouds without points give empty results", "[blocks][error]") {
  const PointCloud none;
  const std::vector<Eigen::Vector3d> empty;
  const KdTree tree(empty);
  REQUIRE(tree.empty());
  REQUIRE(voxel_downsample(empty, 0.5).empty());
  REQUIRE(estimate_normals(empty, tree).empty());
  REQUIRE(fpfh(none, tree).cols() == 0);
  REQUIRE(consensus({}).hypotheses.empty());
  REQUIRE(matched_points(none, none, {}).empty());
  const Scans scans;
  const Eigen::Isometry3d guess = scans.guess();
  for (const auto& result : {gicp(none, tree, none, guess), gicp(none, tree, scans.source, guess),
                             gicp(scans.target, KdTree(scans.target), none, guess)}) {
    REQUIRE_FALSE(result.converged);
    REQUIRE(result.matches == 0);
    REQUIRE(testing::difference(result.T_target_source, guess) < 1e-12);
  }
}

TEST_CASE("building blocks: errors name what to do", "[blocks][error]") {
  Scans scans;
  const KdTree tree(scans.target), other_tree(std::vector<Eigen::Vector3f>(5, {1, 2, 3}));
  REQUIRE_THROWS_WITH(estimate_normals(scans.target, other_tree),
                      Contains("estimate_normals: the tree is of a cloud of 5 points, but the cloud has") &&
                          Contains("build the tree from the same cloud"));
  REQUIRE_THROWS_WITH(fpfh(scans.target, other_tree), Contains("fpfh: the tree is of a cloud of 5 points"));
  REQUIRE_THROWS_WITH(gicp(scans.target, other_tree, scans.source),
                      Contains("gicp: the tree is of a cloud of 5"));
  REQUIRE_THROWS_WITH(fpfh(scans.target, tree, {}, {4000000}),
                      Contains("fpfh: key point 4000000 of a cloud of"));
  REQUIRE_THROWS_WITH(fpfh(PointCloud{scans.target.points, {}, {}}, tree),
                      Contains("each point needs a normal"));

  Eigen::Isometry3d stretched = scans.guess();
  stretched.linear() *= 1.1;
  REQUIRE_THROWS_WITH(gicp(scans.target, tree, scans.source, stretched),
                      "gicp: the guess is not a rigid transform");
  GicpOptions options;
  options.fine_reach_m = 0.0;
  REQUIRE_THROWS_WITH(gicp(scans.target, tree, scans.source, scans.guess(), options),
                      "fine_reach_m = 0, must be > 0");
  FpfhOptions radius;
  radius.radius_m = -1.0;
  REQUIRE_THROWS_AS(fpfh(scans.target, tree, radius), OptionError);
  ConsensusOptions tolerance;
  tolerance.tolerance_m = 0.0;
  REQUIRE_THROWS_AS(consensus({}, tolerance), OptionError);
  std::vector<Match> matches(3);
  matches[1].target.x() = kNan;
  REQUIRE_THROWS_WITH(consensus(matches), "consensus: match 1 is not finite: leave it out");
  DescriptorMatch beyond;
  beyond.target = 1000000;
  REQUIRE_THROWS_WITH(
      matched_points(scans.target, scans.source, {beyond}),
      Contains("the points 0 of the source and 1000000 of the target") && Contains("target first"));

  scans.source.normals[3] *= 2.0F;
  REQUIRE_THROWS_WITH(
      gicp(scans.target, tree, scans.source),
      Contains("gicp: source: normal 3 has the length 2.0") && Contains("normalise the normals"));
  REQUIRE_THROWS_WITH(fpfh(scans.source, KdTree(scans.source)), Contains("fpfh: normal 3 has the length"));
}

}  // namespace
}  // namespace loopwise::building_blocks_test
