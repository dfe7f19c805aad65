// SPDX-License-Identifier: BSD-3-Clause
// Robust optimisation of graphs with many false closures, alone and in groups, and with information that is
// wrong.
#include <catch2/catch.hpp>

#include <cstddef>
#include <map>
#include <utility>
#include <vector>

#include <loopwise/optimization/gnc.hpp>

#include "confirmed_closures.hpp"
#include "odometry_forest.hpp"
#include "support.hpp"

namespace loopwise::hard_graphs_test {
namespace {

constexpr double kSigmaM = 0.02, kSigmaRad = 0.005;

/// Factors on the information of odometry and closures; 1: as the noise is.
struct Stated {
  double odometry = 1.0, closures = 1.0;
};

/// Measurements of true relative poses, with noise of kSigmaM and kSigmaRad.
class Measured {
 public:
  /// \param noise factor on the noise and on its stated deviations
  Measured(std::uint64_t seed, Stated stated, double noise = 1.0)
      : rng(seed), stated_(stated), sigma_m_(noise * kSigmaM), sigma_rad_(noise * kSigmaRad) {}

  Edge operator()(Key from, Key to, const Eigen::Isometry3d& T, EdgeKind kind) {
    Vector6d noise;
    for (int i = 0; i < 6; ++i) noise[i] = (i < 3 ? sigma_m_ : sigma_rad_) * rng.normal();
    if (kind == EdgeKind::kOdometry) noise[5] += yaw_bias_rad;
    Edge edge{from, to, se3::normalized(T * se3::exp(noise)), Matrix6d::Identity()};
    edge.information.topLeftCorner<3, 3>() /= sigma_m_ * sigma_m_;
    edge.information.bottomRightCorner<3, 3>() /= sigma_rad_ * sigma_rad_;
    edge.information *= kind == EdgeKind::kOdometry ? stated_.odometry : stated_.closures;
    edge.kind = kind;
    return edge;
  }

  Rng rng;
  double yaw_bias_rad = 0.0;  ///< Added to each step of odometry.

 private:
  Stated stated_;
  double sigma_m_, sigma_rad_;
};

/// A path with poses chained along its odometry and a prior on the first.
testing::RandomGraph walk(Measured& measured, std::vector<Eigen::Isometry3d> truth) {
  testing::RandomGraph out;
  out.truth = std::move(truth);
  Eigen::Isometry3d drifted = out.truth[0];
  std::vector<Edge> edges;
  for (Key k = 0; k < out.truth.size(); ++k) {
    if (k > 0) {
      edges.push_back(measured(k - 1, k, out.truth[k - 1].inverse() * out.truth[k], EdgeKind::kOdometry));
      drifted = se3::normalized(drifted * edges.back().T_from_to);
    }
    Node node;
    node.key = k;
    node.pose = drifted;
    out.graph.add_node(node);
  }
  for (const Edge& edge : edges) out.graph.add_edge(edge);
  out.is_false.assign(edges.size(), false);
  out.graph.add_prior(testing::prior_at(0, out.truth[0]));
  return out;
}

void add(testing::RandomGraph& graph, const Edge& edge, bool is_false) {
  graph.graph.add_edge(edge);
  graph.is_false.push_back(is_false);
}

/// A square walked row by row and back, with closures between adjacent rows.
testing::RandomGraph square(Measured& measured, std::size_t side) {
  std::vector<Eigen::Isometry3d> truth;
  for (std::size_t row = 0; row < side; ++row) {
    for (std::size_t column = 0; column < side; ++column) {
      const std::size_t x = row % 2 == 0 ? column : side - 1 - column;
      Eigen::Isometry3d pose(
          Eigen::AngleAxisd(row % 2 == 0 ? 0.0 : 3.14159265358979323846, Eigen::Vector3d::UnitZ()));
      pose.translation() << static_cast<double>(x), static_cast<double>(row), 0.0;
      truth.push_back(pose);
    }
  }
  testing::RandomGraph out = walk(measured, std::move(truth));
  for (std::size_t row = 1; row < side; ++row) {
    for (std::size_t step = 0; step + 1 < side; ++step) {
      const Key from = row * side - 1 - step, to = row * side + step;
      if (from + 1 == to) continue;
      add(out, measured(from, to, out.truth[from].inverse() * out.truth[to], EdgeKind::kLoopClosure), false);
    }
  }
  return out;
}

/// A path wound around a tube, 40 steps a turn, with closures between adjacent turns.
testing::RandomGraph tube(Measured& measured, std::size_t nodes) {
  constexpr std::size_t kTurn = 40;
  constexpr double kRadiusM = 6.0;
  std::vector<Eigen::Isometry3d> truth;
  for (std::size_t k = 0; k < nodes; ++k) {
    const Eigen::Matrix3d turned =
        Eigen::AngleAxisd(2.0 * 3.14159265358979323846 * static_cast<double>(k) / kTurn,
                          Eigen::Vector3d::UnitX())
            .toRotationMatrix();
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = turned;
    pose.translation() = turned * Eigen::Vector3d(0.025 * static_cast<double>(k), 0.0, kRadiusM);
    truth.push_back(pose);
  }
  testing::RandomGraph out = walk(measured, std::move(truth));
  for (Key k = kTurn; k < nodes; ++k) {
    const Eigen::Isometry3d T = out.truth[k].inverse() * out.truth[k - kTurn];
    add(out, measured(k, k - kTurn, T, EdgeKind::kLoopClosure), false);
  }
  return out;
}

/// A corridor walked up and down, with closures between random visits of places at most a step apart.
testing::RandomGraph corridor(Measured& measured, std::size_t length, std::size_t passes,
                              std::size_t closures) {
  std::vector<Eigen::Isometry3d> truth;
  std::vector<std::vector<Key>> visits(length);
  for (std::size_t pass = 0; pass < passes; ++pass) {
    for (std::size_t step = 0; step < length; ++step) {
      const std::size_t x = pass % 2 == 0 ? step : length - 1 - step;
      Eigen::Isometry3d pose(
          Eigen::AngleAxisd(pass % 2 == 0 ? 0.0 : 3.14159265358979323846, Eigen::Vector3d::UnitZ()));
      pose.translation() << 2.0 * static_cast<double>(x), 0.2 * static_cast<double>(pass), 0.0;
      visits[x].push_back(truth.size());
      truth.push_back(pose);
    }
  }
  testing::RandomGraph out = walk(measured, std::move(truth));
  for (std::size_t added = 0; added < closures;) {
    const std::size_t x = measured.rng.below(length - 1);
    const auto visit = [&](std::size_t place) {
      return visits[place][measured.rng.below(visits[place].size())];
    };
    const Key from = visit(x), to = visit(x + measured.rng.below(2));
    if (from == to || from + 1 == to || to + 1 == from) continue;
    add(out, measured(from, to, out.truth[from].inverse() * out.truth[to], EdgeKind::kLoopClosure), false);
    ++added;
  }
  return out;
}

/// A random walk through the streets of a square city, with closures from each pose to the last two at the
/// same place: streets are short, so few closures follow each other.
testing::RandomGraph city(Measured& measured, std::size_t nodes) {
  constexpr int kStreet = 8, kStreets = 3;  // steps of 1 m, streets from side to side
  std::vector<Eigen::Isometry3d> truth;
  std::map<std::pair<int, int>, std::vector<Key>> visits;
  int x = 0, y = 0, towards = 0;
  while (truth.size() < nodes) {
    if ((truth.size() % kStreet) == 0) {
      const auto leads_out = [&](int way) {
        const int u = x + (way == 0 ? 1 : way == 2 ? -1 : 0), v = y + (way == 1 ? 1 : way == 3 ? -1 : 0);
        return u < 0 || v < 0 || u > kStreet * kStreets || v > kStreet * kStreets;
      };
      const int back = (towards + 2) % 4;
      do {
        towards = static_cast<int>(measured.rng.below(4));
      } while (leads_out(towards) || (!truth.empty() && towards == back));
    }
    Eigen::Isometry3d pose(
        Eigen::AngleAxisd(0.5 * 3.14159265358979323846 * towards, Eigen::Vector3d::UnitZ()));
    pose.translation() << x, y, 0.0;
    visits[{x, y}].push_back(truth.size());
    truth.push_back(pose);
    x += towards == 0 ? 1 : towards == 2 ? -1 : 0;
    y += towards == 1 ? 1 : towards == 3 ? -1 : 0;
  }
  testing::RandomGraph out = walk(measured, std::move(truth));
  for (const auto& [place, at] : visits) {
    for (std::size_t i = 1; i < at.size(); ++i) {
      for (std::size_t j = i > 1 ? i - 2 : 0; j < i; ++j) {
        const Eigen::Isometry3d T = out.truth[at[j]].inverse() * out.truth[at[i]];
        if (at[i] > at[j] + 1) add(out, measured(at[j], at[i], T, EdgeKind::kLoopClosure), false);
      }
    }
  }
  return out;
}

/// Closures between random places.
void add_random(Measured& measured, testing::RandomGraph& graph, std::size_t count) {
  const std::size_t nodes = graph.truth.size();
  for (std::size_t i = 0; i < count; ++i) {
    const Key from = measured.rng.below(nodes), to = (from + 2 + measured.rng.below(nodes - 3)) % nodes;
    add(graph, measured(from, to, testing::random_pose(measured.rng, 5.0), EdgeKind::kLoopClosure), true);
  }
}

/// Groups of closures that take one stretch of the path for another, and agree with each other.
void add_groups(Measured& measured, testing::RandomGraph& graph, std::size_t groups, std::size_t size) {
  for (std::size_t g = 0; g < groups;) {
    const std::size_t a = measured.rng.below(graph.truth.size() - size);
    const std::size_t b = measured.rng.below(graph.truth.size() - size);
    if (a < b + 60 && b < a + 60) continue;
    for (std::size_t i = 0; i < size; ++i) {
      const Eigen::Isometry3d T =
          graph.truth[a + i].inverse() * graph.truth[a] * graph.truth[b].inverse() * graph.truth[b + i];
      add(graph, measured(a + i, b + i, T, EdgeKind::kLoopClosure), true);
    }
    ++g;
  }
}

/// The paths of three robots, without odometry from one to the next. That of the last one is worse than
/// stated.
testing::RandomGraph in_three(const testing::RandomGraph& whole) {
  testing::RandomGraph out = whole;
  const Key third = whole.truth.size() / 3;
  const auto joins = [&](const Edge& edge) {
    return edge.kind == EdgeKind::kOdometry && edge.to % third == 0 && edge.to / third < 3;
  };
  out.is_false.clear();
  for (std::size_t e = 0; e < whole.is_false.size(); ++e) {
    if (!joins(whole.graph.edges()[e])) out.is_false.push_back(whole.is_false[e]);
  }
  out.graph.remove_edges_if(joins);
  for (std::size_t e = 0; e < out.is_false.size(); ++e) {
    const Edge& edge = out.graph.edges()[e];
    if (edge.kind == EdgeKind::kOdometry && edge.from >= 2 * third)
      out.graph.set_information(e, 2.5 * edge.information);
  }
  return out;
}

/// Closures that take one stretch of the path for another one above it, as in a building whose floors are
/// alike.
void add_floor(Measured& measured, testing::RandomGraph& graph, Key from, Key to, std::size_t size,
               double height_m) {
  for (Key i = 0; i < size; ++i) {
    Eigen::Isometry3d T = graph.truth[from + i].inverse() * graph.truth[to + i];
    T.translation().z() += height_m;
    add(graph, measured(from + i, to + i, T, EdgeKind::kLoopClosure), true);
  }
}

/// A square whose deviations are stated a hundred times too large, with groups of false closures, or random
/// ones if there are no groups.
testing::RandomGraph pessimistic(std::uint64_t seed, std::size_t groups, std::size_t size) {
  Measured measured(seed, {1e-4, 1e-4});
  testing::RandomGraph graph = square(measured, 16);
  if (groups > 0) {
    add_groups(measured, graph, groups, size);
  } else {
    add_random(measured, graph, 240);
  }
  return graph;
}

struct Wrong {
  std::size_t kept = 0, lost = 0;  ///< False closures kept, right ones lost
};

Wrong wrong(const testing::RandomGraph& graph, const GncResult& result) {
  Wrong out;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    if (known_inlier(graph.graph.edges()[e])) continue;
    out.kept += graph.is_false[e] && result.weights[e] > 0.5 ? 1 : 0;
    out.lost += !graph.is_false[e] && result.weights[e] <= 0.5 ? 1 : 0;
  }
  return out;
}

}  // namespace

TEST_CASE("hard graphs: groups of false closures that contradict the rest need one start only",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    Measured measured(seed, {});
    testing::RandomGraph graph = square(measured, 16);
    add_groups(measured, graph, 16, 5);
    const GncResult result = optimize_gnc(graph.graph);
    REQUIRE(wrong(graph, result).kept == 0);
    REQUIRE(wrong(graph, result).lost <= 2);
    REQUIRE(result.start == GncStart::kConfirmed);
    REQUIRE(result.odometry_scales.empty());
    REQUIRE(result.optimization.factorizations <= 20);
  }
}

TEST_CASE("hard graphs: a closure far from others stays if the solution does not contradict it",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    Measured measured(seed, {});
    testing::RandomGraph graph = corridor(measured, 40, 10, 200);
    add_random(measured, graph, 200);
    const GncResult result = optimize_gnc(graph.graph);
    REQUIRE(wrong(graph, result).kept == 0);
    REQUIRE(wrong(graph, result).lost <= 4);
    REQUIRE(result.start == GncStart::kConfirmed);
    REQUIRE(result.optimization.factorizations <= 30);
  }
}

TEST_CASE("hard graphs: odometry that is three times as uncertain as stated", "[optimization][gnc]") {
  int factorizations = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const bool in_groups : {false, true}) {
      CAPTURE(seed, in_groups);
      Measured measured(seed, {9.0, 1.0});
      testing::RandomGraph graph = square(measured, 16);
      if (in_groups) {
        add_groups(measured, graph, 16, 5);
      } else {
        add_random(measured, graph, 80);
      }
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept == 0);
      REQUIRE(wrong(graph, result).lost <= 2);
      REQUIRE(result.odometry_scales.size() == 1);
      REQUIRE(result.odometry_scales[0].scale == Approx(3.0).epsilon(0.15));
      REQUIRE(result.optimization.factorizations <= 90);
      factorizations += result.optimization.factorizations;
    }
  }
  REQUIRE(factorizations <= 600);
}

TEST_CASE("hard graphs: false closures far below a pessimistic threshold are found", "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const bool in_groups : {false, true}) {
      CAPTURE(seed, in_groups);
      const testing::RandomGraph graph = pessimistic(seed, in_groups ? 16 : 0, 5);
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept <= 1);
      REQUIRE(wrong(graph, result).lost <= 2);
    }
  }
}

TEST_CASE("hard graphs: information that is far too pessimistic is as good as right one",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const bool in_groups : {false, true}) {
      CAPTURE(seed, in_groups);
      const testing::RandomGraph graph = pessimistic(seed, in_groups ? 24 : 0, 10);
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept == 0);
      REQUIRE(wrong(graph, result).lost <= 2);
      REQUIRE(result.start == GncStart::kConfirmed);
      REQUIRE(result.noise_scale >= 0.008);
      REQUIRE(result.noise_scale <= 0.02);
      REQUIRE(result.optimization.factorizations <= 60);
    }
  }
  Measured measured(1, {});
  testing::RandomGraph right = square(measured, 16);
  add_random(measured, right, 120);
  REQUIRE(optimize_gnc(right.graph).noise_scale == 1.0);
}

TEST_CASE("hard graphs: pessimistic information stays measured while the graph grows",
          "[optimization][gnc]") {
  Measured measured(6, {1e-4, 1e-4});
  testing::RandomGraph graph = square(measured, 16);
  add_groups(measured, graph, 24, 10);
  PoseGraphOptimizer optimizer;
  GncOptions options;
  options.warm_start = true;
  for (int round = 0; round < 3; ++round) {
    CAPTURE(round);
    const GncResult result = optimizer.optimize_gnc(graph.graph, options);
    REQUIRE(wrong(graph, result).kept == 0);
    REQUIRE(wrong(graph, result).lost <= 2);
    REQUIRE(result.noise_scale < 0.02);
    const Key from = 20 + static_cast<Key>(round), to = from + 23;
    add(graph, measured(from, to, graph.truth[from].inverse() * graph.truth[to], EdgeKind::kLoopClosure),
        false);
  }
}

TEST_CASE("hard graphs: copies of pessimistic odometry do not replace the other closures",
          "[optimization][gnc]") {
  Measured measured(7, {1e-4, 1e-4});
  testing::RandomGraph graph = square(measured, 16);
  const std::vector<Eigen::Isometry3d> odometry = graph.graph.poses();
  for (Key from = 0; from < 140; ++from) {
    const Key to = from + 30;
    Edge copy = measured(from, to, Eigen::Isometry3d::Identity(), EdgeKind::kLoopClosure);
    copy.T_from_to = odometry[from].inverse() * odometry[to];
    copy.T_from_to.translation() += Eigen::Vector3d::Constant(2e-5);  // as rounded in a file
    add(graph, copy, false);
  }
  add_random(measured, graph, 60);
  const GncResult result = optimize_gnc(graph.graph);
  REQUIRE(wrong(graph, result).lost <= 2);
  REQUIRE(wrong(graph, result).kept <= 1);
}

TEST_CASE("hard graphs: false closures that agree do not make odometry as bad as they need it",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const double height_m : {5.0, 7.0}) {
      CAPTURE(seed, height_m);
      Measured measured(seed, {});
      testing::RandomGraph graph = in_three(corridor(measured, 40, 9, 160));
      add_floor(measured, graph, 70, 190, 12, height_m);
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept == 0);
      REQUIRE(wrong(graph, result).lost <= 5);  // of 160
    }
  }
}

TEST_CASE("hard graphs: stretches of a floor taken for another do not make odometry as bad as they need it",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 6; seed <= 13; ++seed) {
    for (const double stated : {1.0, 2.0}) {
      CAPTURE(seed, stated);
      Measured measured(seed, {stated, 1.0});
      testing::RandomGraph graph = in_three(corridor(measured, 40, 9, 300));
      for (int stretch = 0; stretch < 7; ++stretch) {
        const Key from = 5 + measured.rng.below(100);
        add_floor(measured, graph, from, from + 120 + measured.rng.below(3), 10, 5.0);
      }
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept == 0);
      REQUIRE(wrong(graph, result).lost <= 25);  // of 300
    }
  }
}

TEST_CASE("hard graphs: floors stay apart if odometry of their own closures explains the graph at lower cost",
          "[optimization][gnc]") {
  struct Case {
    std::uint64_t seed;
    double stated;  // information of odometry
    int stretches;
    std::size_t size;
  };
  for (const Case& c : {Case{11, 2.0, 2, 20}, {12, 3.2, 4, 10}, {23, 2.0, 4, 10}}) {
    CAPTURE(c.seed, c.stated, c.stretches, c.size);
    Measured measured(c.seed, {c.stated, 1.0});
    testing::RandomGraph graph = in_three(corridor(measured, 40, 9, 120));
    for (int stretch = 0; stretch < c.stretches; ++stretch) {
      const Key from = 5 + measured.rng.below(100 - c.size);
      add_floor(measured, graph, from, from + 120 + measured.rng.below(3), c.size, 5.0);
    }
    const GncResult result = optimize_gnc(graph.graph);
    REQUIRE(wrong(graph, result).kept == 0);
    REQUIRE(wrong(graph, result).lost <= 20);  // of 120
  }
}

TEST_CASE("hard graphs: errors of odometry that add up do not exclude right closures",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const double odometry : {1.5, 2.0}) {
      for (const double yaw_bias_rad : {0.003, 0.006}) {
        CAPTURE(seed, odometry, yaw_bias_rad);
        Measured measured(seed, {odometry, 1.0});
        measured.yaw_bias_rad = yaw_bias_rad;
        testing::RandomGraph graph = in_three(corridor(measured, 40, 9, 160));
        add_random(measured, graph, 10);
        const GncResult result = optimize_gnc(graph.graph);
        REQUIRE(wrong(graph, result).kept == 0);
        REQUIRE(wrong(graph, result).lost <= 2);  // of 160
      }
    }
  }
}

TEST_CASE("hard graphs: a path that odometry cannot test, and false closures in groups",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    for (const std::size_t size : {std::size_t{5}, std::size_t{20}}) {
      CAPTURE(seed, size);
      Measured measured(seed, {}, 8.0);
      testing::RandomGraph graph = tube(measured, 800);
      add_groups(measured, graph, 300 / size, size);
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept <= 2);
      REQUIRE(wrong(graph, result).lost <= 10);  // of 760
      REQUIRE(result.start == GncStart::kConfirmed);
    }
  }
}

TEST_CASE("hard graphs: false groups where odometry is useless and overconfident", "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    for (const std::size_t size : {std::size_t{5}, std::size_t{10}}) {
      CAPTURE(seed, size);
      Measured measured(seed, {4.0, 1.0}, 8.0);
      testing::RandomGraph graph = tube(measured, 800);
      add_groups(measured, graph, 300 / size, size);
      const GncResult result = optimize_gnc(graph.graph);
      REQUIRE(wrong(graph, result).kept == 0);
      REQUIRE(wrong(graph, result).lost <= 8);  // of 760
      REQUIRE(result.start == GncStart::kConfirmed);
    }
  }
}

TEST_CASE("hard graphs: the largest groups where those of right closures are small", "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    CAPTURE(seed);
    Measured measured(seed, {}, 8.0);
    testing::RandomGraph graph = city(measured, 1000);
    const std::size_t right = graph.is_false.size() - (graph.truth.size() - 1);
    add_groups(measured, graph, 40, 5);
    std::vector<char> closures(graph.is_false.size(), 1);
    for (std::size_t e = 0; e < closures.size(); ++e)
      closures[e] = known_inlier(graph.graph.edges()[e]) ? 0 : 1;
    const std::vector<char> large =
        detail::in_large_groups(graph.graph, detail::OdometryForest(graph.graph), closures,
                                chi_squared_quantile(GncOptions().inlier_probability, 6));
    std::size_t right_ones = 0, false_ones = 0;
    for (std::size_t e = 0; e < large.size(); ++e) {
      if (large[e] != 0) ++(graph.is_false[e] ? false_ones : right_ones);
    }
    REQUIRE(right_ones >= 2 * right / 5);
    REQUIRE(false_ones <= right / 50);
  }
}

TEST_CASE("hard graphs: the noise of closures near each other does not depend on false ones",
          "[optimization][gnc]") {
  for (const double pessimism : {1.0, 1e-4}) {
    for (std::uint64_t seed = 1; seed <= 5; ++seed) {
      CAPTURE(pessimism, seed);
      Measured measured(seed, {pessimism, pessimism});
      testing::RandomGraph graph = square(measured, 16);
      const auto noise = [&] {
        return detail::noise_of_neighbours(
            detail::innovations_of_neighbours(graph.graph, detail::OdometryForest(graph.graph)), 6);
      };
      REQUIRE(noise() == Approx(pessimism).epsilon(0.5));
      add_groups(measured, graph, 16, 5);
      add_random(measured, graph, 120);
      // Measured at most 1.5 of it: the decile of true ones is a higher quantile now.
      REQUIRE(noise() >= 0.7 * pessimism);
      REQUIRE(noise() <= 3.0 * pessimism);
    }
  }
  Measured measured(1, {});
  const testing::RandomGraph alone =
      walk(measured, std::vector<Eigen::Isometry3d>(20, Eigen::Isometry3d::Identity()));
  REQUIRE(detail::innovations_of_neighbours(alone.graph, detail::OdometryForest(alone.graph)).empty());
}

}  // namespace loopwise::hard_graphs_test
