// SPDX-License-Identifier: BSD-3-Clause
// Robust optimisation of graphs as files of recorded data have them: odometry with breaks, noise with heavy
// tails under information that is far too pessimistic, and directions that no factor determines.
#include <catch2/catch.hpp>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "confirmed_closures.hpp"
#include "noise_tail.hpp"
#include "odometry_forest.hpp"
#include "support.hpp"

namespace loopwise::broken_odometry_test {
namespace {

constexpr double kSigmaM = 0.002, kSigmaRad = 0.0005;

struct Recorded {
  bool swapped = false;      ///< The keys of two nodes in fourteen are swapped, so that odometry has breaks.
  double stated = 1.0;       ///< Factor on the information.
  double share_of_tail = 0;  ///< Share of the closures with noise that is much larger than the others'.
  std::size_t false_closures = 0;
  std::size_t side = 20;   ///< Nodes of a row, and rows.
  std::size_t copies = 1;  ///< Closures between the same two nodes.
};

/// A square walked row by row and back, with closures between adjacent rows.
class Walk {
 public:
  Walk(std::uint64_t seed, const Recorded& recorded) : rng_(seed), recorded_(recorded) {
    const std::size_t side = recorded.side, nodes = side * side;
    for (std::size_t i = 0; i < nodes; ++i) {
      const std::size_t row = i / side, column = i % side;
      Eigen::Isometry3d pose(Eigen::AngleAxisd(row % 2 == 0 ? 0.0 : M_PI, Eigen::Vector3d::UnitZ()));
      pose.translation() << static_cast<double>(row % 2 == 0 ? column : side - 1 - column),
          static_cast<double>(row), 0.0;
      truth_.push_back(pose);
      keys_.push_back(i);
    }
    if (recorded.swapped) {
      for (std::size_t i = 5; i + 1 < nodes; i += 14) std::swap(keys_[i], keys_[i + 1]);
    }
    for (std::size_t i = 0; i < nodes; ++i) add_node(i);
    for (std::size_t i = 0; i + 1 < nodes; ++i) add(i, i + 1, true_pose(i, i + 1), false);
    for (std::size_t row = 1; row < side; ++row) {
      for (std::size_t step = 1; step < side; ++step) {
        const std::size_t from = row * side - 1 - step, to = row * side + step;
        for (std::size_t copy = 0; copy < recorded.copies && to < nodes; ++copy) {
          add(from, to, true_pose(from, to), false);
        }
      }
    }
    for (std::size_t k = 0; k < recorded.false_closures; ++k) {
      const std::size_t from = rng_.below(nodes), to = (from + 20 + rng_.below(nodes - 40)) % nodes;
      add(from, to, testing::random_pose(rng_, 10.0), true);
    }
    graph.add_prior(testing::prior_at(keys_[0], truth_[0]));
  }

  /// \returns the numbers of false closures kept, and of right ones lost whose noise is clearly within the
  /// stated threshold of 16.8
  [[nodiscard]] std::pair<int, int> wrong(const GncResult& result) const {
    int kept = 0, lost = 0;
    for (std::size_t e = 0; e < is_false_.size(); ++e) {
      if (known_inlier(graph.edges()[e])) continue;
      kept += is_false_[e] && result.weights[e] > 0.5 ? 1 : 0;
      lost += !is_false_[e] && noise_r2_[e] < 12.0 && result.weights[e] <= 0.5 ? 1 : 0;
    }
    return {kept, lost};
  }

  PoseGraph graph;

 private:
  [[nodiscard]] Eigen::Isometry3d true_pose(std::size_t from, std::size_t to) const {
    return truth_[from].inverse() * truth_[to];
  }
  void add_node(std::size_t i) {
    Node node;
    node.key = keys_[i];
    node.pose = truth_[i] * testing::random_pose(rng_, 3.0, 0.2);
    graph.add_node(node);
  }
  void add(std::size_t from, std::size_t to, const Eigen::Isometry3d& T, bool is_false) {
    Edge edge{keys_[from], keys_[to]};
    const bool is_consecutive = edge.from + 1 == edge.to || edge.to + 1 == edge.from;
    edge.kind = is_consecutive ? EdgeKind::kOdometry : EdgeKind::kLoopClosure;
    // In the tail, each factor of 2.7 in the deviations has half as many closures as the one before.
    const double tail = to != from + 1 && rng_.uniform() < recorded_.share_of_tail
                            ? std::pow(1.0 - rng_.uniform(), -1.44)
                            : 1.0;
    Vector6d noise, sigmas;
    sigmas << Eigen::Vector3d::Constant(kSigmaM), Eigen::Vector3d::Constant(kSigmaRad);
    for (int i = 0; i < 6; ++i) noise[i] = tail * sigmas[i] * rng_.normal();
    edge.T_from_to = se3::normalized(T * se3::exp(noise));
    edge.information = recorded_.stated * Matrix6d(sigmas.cwiseAbs2().cwiseInverse().asDiagonal());
    graph.add_edge(edge);
    is_false_.push_back(is_false);
    noise_r2_.push_back(noise.dot(edge.information * noise));
  }

  Rng rng_;
  Recorded recorded_;
  std::vector<Eigen::Isometry3d> truth_;
  std::vector<Key> keys_;
  std::vector<bool> is_false_;
  std::vector<double> noise_r2_;  // rᵀΩr of the noise alone
};

}  // namespace

TEST_CASE("broken odometry: keys that are swapped cost no right closures", "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    for (const std::size_t false_closures : {0, 150, 380}) {
      CAPTURE(seed, false_closures);
      const Walk walk(seed, {true, 1.0, 0.0, false_closures});
      const GncResult result = optimize_gnc(walk.graph);
      const auto [kept, lost] = walk.wrong(result);
      REQUIRE(kept == 0);
      REQUIRE(lost <= 2);
      REQUIRE(result.optimization.factorizations <= 60);
    }
  }
}

TEST_CASE("broken odometry: joined by closures between nodes whose keys are hardly apart",
          "[optimization][gnc]") {
  const Walk walk(1, {true, 1.0, 0.0, 100});
  const detail::OdometryForest odometry(walk.graph);
  const detail::OdometryForest joined = detail::joined_forest(walk.graph, 16.8);
  std::size_t apart = 0;
  for (std::size_t i = 1; i < walk.graph.nodes().size(); ++i) {
    apart += odometry.root(i) != odometry.root(0) ? 1 : 0;
    REQUIRE(joined.root(i) == joined.root(0));
  }
  REQUIRE(apart > walk.graph.nodes().size() / 2);
}

TEST_CASE("broken odometry: joined neither between robots nor against other closures",
          "[optimization][gnc]") {
  const auto graph_of = [](Key second) {  // two robots of three nodes
    PoseGraph graph;
    for (const Key key : {Key{0}, Key{1}, Key{2}, second, second + 1, second + 2}) {
      Node node;
      node.key = key;
      graph.add_node(node);
    }
    return graph;
  };
  const auto add = [](PoseGraph& graph, Key from, Key to, EdgeKind kind, double x) {
    Edge edge{from, to};
    edge.kind = kind;
    edge.T_from_to.translation().x() = x;
    edge.information = 1e4 * Matrix6d::Identity();
    graph.add_edge(edge);
  };
  const auto is_joined = [&](const PoseGraph& graph) {
    const detail::OdometryForest forest = detail::joined_forest(graph, 16.8);
    return forest.root(0) == forest.root(5);
  };
  for (const Key second : {Key{3}, Key{1000}, make_key('b', 0)}) {
    CAPTURE(second);
    PoseGraph graph = graph_of(second);
    for (const Key first : {Key{0}, second}) {
      add(graph, first, first + 1, EdgeKind::kOdometry, 1.0);
      add(graph, first + 1, first + 2, EdgeKind::kOdometry, 1.0);
    }
    add(graph, 2, second, EdgeKind::kLoopClosure, 1.0);
    // Only keys that go on could be those of one robot whose odometry is broken.
    REQUIRE(is_joined(graph) == (second == 3));
    PoseGraph contradicted = graph;
    add(contradicted, 0, second + 2, EdgeKind::kLoopClosure, -7.0);
    REQUIRE_FALSE(is_joined(contradicted));
    PoseGraph confirmed = graph;
    add(confirmed, 1, second + 1, EdgeKind::kLoopClosure, 3.0);
    REQUIRE(is_joined(confirmed) == (second == 3));
    // Priors join both trees already.
    PoseGraph anchored = graph;
    anchored.add_prior(testing::prior_at(0, anchored.nodes()[0].pose));
    anchored.add_prior(testing::prior_at(second + 2, anchored.nodes()[5].pose));
    REQUIRE_FALSE(is_joined(anchored));
  }
}

TEST_CASE("broken odometry: noise with a heavy tail under pessimistic information costs no right closures",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 2; ++seed) {
    for (const std::size_t false_closures : {0, 1500}) {
      CAPTURE(seed, false_closures);
      const Walk walk(seed, {false, 1e-5, 0.4, false_closures, 40, 3});
      const auto [kept, lost] = walk.wrong(optimize_gnc(walk.graph));
      CHECK(kept == 0);
      CHECK(lost <= 6);  // measured at most 5
    }
  }
}

TEST_CASE("broken odometry: directions that nothing determines need no more steps", "[optimization]") {
  // Information on the position alone leaves the rotation of the last node of each pair free.
  const auto factorizations_with = [](bool determined) {
    Rng rng(3);
    PoseGraph graph;
    for (Key k = 0; k < 60; ++k) {
      Node node;
      node.key = k;
      node.pose = testing::random_pose(rng, 2.0, 0.3);
      graph.add_node(node);
      if (k == 0) continue;
      Edge edge{k % 2 == 0 ? k - 2 : k - 1, k, testing::random_pose(rng, 1.0, 0.3)};
      edge.kind = EdgeKind::kOdometry;
      edge.information = Matrix6d::Identity();
      if (k % 2 == 1 && !determined) edge.information.bottomRightCorner<3, 3>().setZero();
      graph.add_edge(edge);
    }
    graph.add_prior(testing::prior_at(0, graph.nodes()[0].pose));
    OptimizerOptions options;
    options.initialization = Initialization::kFile;
    const OptimizationResult result = optimize(graph, options);
    REQUIRE(result.converged);
    REQUIRE(result.underdetermined == !determined);
    REQUIRE(result.cost < 1e-9);
    return result.factorizations;
  };
  REQUIRE(factorizations_with(false) <= 2 * factorizations_with(true) + 2);
}

TEST_CASE("noise tail: ends where closures are fewest, before they are more again", "[optimization][gnc]") {
  std::vector<double> tail;  // 100 in the first factor of two above 0.5, then two thirds in each next one
  for (int octave = 0; octave < 10; ++octave) {
    const double count = 100.0 * std::pow(2.0 / 3.0, octave);
    for (int i = 0; i < static_cast<int>(count); ++i) tail.push_back(0.5 * std::pow(2.0, octave + i / count));
  }
  // The tail thins out up to the stated threshold.
  CHECK(detail::end_of_tail(tail, 1.0, 16.0) == Approx(16.0));
  // With many others beyond 4, it ends there.
  std::vector<double> with_others = tail;
  for (int i = 0; i < 400; ++i) with_others.push_back(8.0 * std::pow(100.0, i / 400.0));
  const double end = detail::end_of_tail(with_others, 1.0, 100.0);
  CHECK(end >= 2.0);
  CHECK(end <= 8.0);
  // No tail beyond the threshold of the noise: nothing changes, with and without others.
  CHECK(detail::end_of_tail({1e-3, 2e-3, 3e-3}, 1.0, 16.0) == 1.0);
  std::vector<double> gap(200, 1e-4);
  gap.insert(gap.end(), 50, 12.0);
  CHECK(detail::end_of_tail(gap, 1.0, 16.0) == 1.0);
  CHECK(detail::end_of_tail({}, 1.0, 16.0) == 1.0);
}

}  // namespace loopwise::broken_odometry_test
