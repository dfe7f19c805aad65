// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/optimizer.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "support.hpp"

namespace loopwise::optimizer_test {
namespace {

/// Known optima of the shared graphs: ½ Σ rᵀΩr with exact Jacobians, prior sigma 1e-4, computed
/// independently.
struct KnownOptimum {
  std::string name;
  std::vector<Key> priors;
  double cost;
  int factorizations;
};
const std::vector<KnownOptimum> kOptima{{"smallGrid3D", {0}, 517.925332360, 8},
                                        {"parking-garage", {0}, 0.634192399632, 4},
                                        {"sphere2500", {0}, 675.700962926, 7},
                                        {"tunnel1250", {0, 625}, 595.833288941, 5}};

}  // namespace

TEST_CASE("optimize: a Gauss-Newton step is the dense solution", "[optimization][property]") {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::RandomGraph random = testing::random_graph(rng);
    OptimizerOptions options;
    options.initialization = Initialization::kFile;
    options.max_iterations = 1;
    const OptimizationResult result = optimize(random.graph, options);
    Eigen::VectorXd g;
    const Eigen::MatrixXd H = testing::dense_hessian(random.graph, &g);
    const Eigen::VectorXd step = -H.ldlt().solve(g);
    REQUIRE(result.iterations == 1);
    REQUIRE(result.trace.front().accepted);
    for (std::size_t i = 0; i < result.poses.size(); ++i) {
      const Eigen::Isometry3d expected =
          random.graph.nodes()[i].pose * se3::exp(step.segment<6>(6 * static_cast<Eigen::Index>(i)));
      REQUIRE(testing::difference(expected, result.poses[i]) < 1e-6);
    }
  }
}

TEST_CASE("optimize: the gradient is the derivative of the cost", "[optimization][property]") {
  Rng rng(2);
  for (int round = 0; round < 5; ++round) {
    const testing::RandomGraph random = testing::random_graph(rng);
    Eigen::VectorXd g;
    const Eigen::MatrixXd ignored = testing::dense_hessian(random.graph, &g);
    const double h = 1e-6;
    const auto cost_at = [&](std::size_t node, const Vector6d& xi) {
      PoseGraph moved = random.graph;
      moved.set_pose(moved.nodes()[node].key, se3::normalized(moved.nodes()[node].pose * se3::exp(xi)));
      return graph_cost(moved);
    };
    double largest = 0.0;
    for (std::size_t node = 0; node < 5; ++node) {
      for (int k = 0; k < 6; ++k) {
        const Vector6d d = h * Vector6d::Unit(k);
        const double numeric = (cost_at(node, d) - cost_at(node, -d)) / (2.0 * h);
        // Measured 3e-8 of the largest element.
        REQUIRE(g[6 * static_cast<Eigen::Index>(node) + k] ==
                Approx(numeric).margin(1e-5 * g.cwiseAbs().maxCoeff()));
        largest = std::max(largest, std::abs(numeric));
      }
    }
    REQUIRE(largest > 0.0);
    OptimizerOptions options;
    options.max_iterations = 0;
    options.initialization = Initialization::kFile;
    REQUIRE(optimize(random.graph, options).gradient == Approx(g.cwiseAbs().maxCoeff()).epsilon(1e-6));
  }
}

TEST_CASE("optimize: the factorisations agree", "[optimization]") {
  // The second graph's factor is almost dense: its last front is large enough for BLAS.
  for (const auto& [nodes, closures] : {std::pair<std::size_t, std::size_t>{200, 150}, {80, 1500}}) {
    CAPTURE(nodes);
    Rng rng(12);
    testing::RandomGraphOptions shape;
    shape.nodes = nodes;
    shape.closures = closures;
    const testing::RandomGraph random = testing::random_graph(rng, shape);
    OptimizerOptions options;
    options.factorization = Factorization::kMultifrontal;
    const OptimizationResult expected = optimize(random.graph, options);
    const auto compare = [&](Factorization factorization) {
      options.factorization = factorization;
      const OptimizationResult result = optimize(random.graph, options);
      REQUIRE(result.cost == Approx(expected.cost).epsilon(1e-11));
      REQUIRE(result.factorizations == expected.factorizations);
      for (std::size_t i = 0; i < result.poses.size(); ++i)
        REQUIRE(testing::difference(result.poses[i], expected.poses[i]) < 1e-8);
    };
    compare(Factorization::kSimplicial);
#ifdef LOOPWISE_TEST_SUPERNODAL
    compare(Factorization::kSupernodal);
#else
    options.factorization = Factorization::kSupernodal;
    REQUIRE_THROWS_WITH(optimize({}, options), Contains("factorization"));
#endif
  }
}

TEST_CASE("optimize: the same bits for any number of threads", "[optimization][property]") {
  Rng rng(13);
  testing::RandomGraphOptions shape;
  shape.nodes = 1500;
  shape.closures = 900;
  shape.false_closures = 30;
  const testing::RandomGraph random = testing::random_graph(rng, shape);
  OptimizerOptions one, three;
  one.max_iterations = three.max_iterations = 4;
  three.threads = 3;
  const OptimizationResult a = optimize(random.graph, one), b = optimize(random.graph, three);
  REQUIRE(a.cost == b.cost);
  for (std::size_t i = 0; i < a.poses.size(); ++i) REQUIRE(a.poses[i].matrix() == b.poses[i].matrix());
}

TEST_CASE("optimize: first estimates of a noise-free graph are the truth", "[optimization]") {
  Rng rng(14);
  testing::RandomGraphOptions shape;
  shape.sigma_m = shape.sigma_rad = 1e-6;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  for (const Node& node : random.graph.nodes()) {
    if (node.key != 0) random.graph.set_pose(node.key, testing::random_pose(rng, 10.0));
  }
  for (const auto initialization : {Initialization::kOdometry, Initialization::kChordal}) {
    const auto poses = initial_poses(random.graph, initialization);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      // Measured 3e-5: 30 steps of noise. A transposed rotation is wrong by 1.
      REQUIRE(testing::difference(poses[i], random.truth[i]) < 1e-3);
    }
  }
}

TEST_CASE("optimize: a graph without a prior keeps its first node and finds the same shape",
          "[optimization]") {
  Rng rng(15);
  testing::RandomGraphOptions shape;
  shape.prior = false;
  const testing::RandomGraph random = testing::random_graph(rng, shape);
  const OptimizationResult free = optimize(random.graph);
  REQUIRE(free.converged);
  REQUIRE(free.held == std::vector<Key>{0});
  REQUIRE(testing::difference(free.poses[0], random.graph.nodes()[0].pose) == 0.0);
  PoseGraph anchored = random.graph;
  anchored.add_prior(testing::prior_at(0, random.graph.nodes()[0].pose));
  const OptimizationResult tied = optimize(anchored);
  REQUIRE(tied.held.empty());
  REQUIRE(free.cost == Approx(tied.cost).epsilon(1e-9));
  for (std::size_t i = 0; i < free.poses.size(); ++i) {
    REQUIRE(testing::difference(free.poses[i], tied.poses[i]) < 1e-7);
  }
}

TEST_CASE("optimize: components do not influence each other", "[optimization]") {
  Rng rng(16);
  const testing::RandomGraph a = testing::random_graph(rng), b = testing::random_graph(rng);
  PoseGraph both = a.graph;
  for (Node node : b.graph.nodes()) {
    node.key += 1000;
    both.add_node(node);
  }
  for (Edge edge : b.graph.edges()) {
    edge.from += 1000;
    edge.to += 1000;
    both.add_edge(edge);
  }
  Node lone;
  lone.key = 5000;
  lone.pose = se3::normalized(testing::random_pose(rng));
  both.add_node(lone);
  const OptimizationResult joint = optimize(both), alone = optimize(a.graph);
  REQUIRE(joint.converged);
  REQUIRE(joint.components == 3);
  REQUIRE(joint.held == std::vector<Key>{1000});  // b lost its prior, the lone node has no factor
  for (std::size_t i = 0; i < a.truth.size(); ++i)
    REQUIRE(testing::difference(joint.poses[i], alone.poses[i]) < 1e-6);
  REQUIRE(testing::difference(joint.poses.back(), lone.pose) < 1e-15);
}

TEST_CASE("optimize: an optimizer that is used again follows the graph", "[optimization]") {
  Rng rng(17);
  testing::RandomGraphOptions shape;
  shape.nodes = 60;
  shape.closures = 40;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  PoseGraphOptimizer optimizer;
  const OptimizationResult first = optimizer.optimize(random.graph);
  random.graph.set_poses(first.poses);
  const OptimizationResult again = optimizer.optimize(random.graph);
  REQUIRE(optimizer.analyses() == 1);
  REQUIRE(again.converged);
  REQUIRE(again.factorizations <= 2);
  REQUIRE(again.cost == Approx(first.cost).epsilon(1e-9));

  Node node;
  node.key = 500;
  node.pose = random.graph.nodes()[7].pose;
  random.graph.add_node(node);
  Edge edge;
  edge.from = 7;
  edge.to = 500;
  edge.T_from_to.translation().x() = 1.0;
  random.graph.add_edge(edge);
  const OptimizationResult grown = optimizer.optimize(random.graph);
  REQUIRE(grown.converged);
  REQUIRE(testing::difference(grown.poses.back(), optimize(random.graph).poses.back()) < 1e-7);
}

TEST_CASE("optimize: bad input has a documented result or a clear error", "[optimization][error]") {
  SECTION("nothing at all") {
    const OptimizationResult result = optimize(PoseGraph());
    REQUIRE(result.converged);
    REQUIRE(result.termination == Termination::kNothingToDo);
    REQUIRE(result.poses.empty());
  }
  Rng rng(18);
  testing::RandomGraph random = testing::random_graph(rng);
  SECTION("options out of range name the field") {
    OptimizerOptions options;
    options.cost_tolerance = -1.0;
    REQUIRE_THROWS_WITH(optimize(random.graph, options), Contains("cost_tolerance = -1"));
  }
  SECTION("information without rotation leaves directions open, and says so") {
    PoseGraph graph;
    for (const Node& node : random.graph.nodes()) graph.add_node(node);
    for (Edge edge : random.graph.edges()) {
      edge.information.setZero();
      edge.information.topLeftCorner<3, 3>() = 100.0 * Eigen::Matrix3d::Identity();
      graph.add_edge(edge);
    }
    const OptimizationResult result = optimize(graph);
    REQUIRE(result.underdetermined);
    REQUIRE(result.cost <= result.cost_initial);
    for (const auto& pose : result.poses) REQUIRE(pose.matrix().allFinite());
  }
  SECTION("all information zero") {
    PoseGraph graph;
    for (const Node& node : random.graph.nodes()) graph.add_node(node);
    for (Edge edge : random.graph.edges()) {
      edge.information.setZero();
      graph.add_edge(edge);
    }
    const OptimizationResult result = optimize(graph);
    REQUIRE(result.cost == 0.0);
    for (std::size_t i = 0; i < result.poses.size(); ++i) {
      REQUIRE(testing::difference(result.poses[i], graph.nodes()[i].pose) < 1e-12);
    }
  }
  SECTION("contradicting odometry is a compromise, not a failure") {
    Edge edge = random.graph.edges()[3];
    edge.T_from_to.translation().x() += 10.0;
    random.graph.add_edge(edge);
    const OptimizationResult result = optimize(random.graph);
    REQUIRE(result.converged);
    REQUIRE(result.cost > 1000.0);
  }
  SECTION("a prior on a lone node is obeyed") {
    Node node;
    node.key = 900;
    random.graph.add_node(node);
    const Eigen::Isometry3d wanted = testing::random_pose(rng);
    random.graph.add_prior(testing::prior_at(900, wanted));
    const OptimizationResult result = optimize(random.graph);
    REQUIRE(testing::difference(result.poses.back(), wanted) < 1e-9);
  }
  SECTION("values beyond the range of numbers") {
    PoseGraph graph;
    for (Key k = 0; k < 2; ++k) {
      Node node;
      node.key = k;
      node.pose.translation().x() = 1e200 * static_cast<double>(k);
      graph.add_node(node);
    }
    Edge edge;
    edge.from = 0;
    edge.to = 1;
    graph.add_edge(edge);
    OptimizerOptions from_graph;
    from_graph.initialization = Initialization::kFile;
    REQUIRE_THROWS_AS(optimize(graph, from_graph), InputError);
    REQUIRE_THROWS_AS(optimize_gnc(graph, from_graph), InputError);
    REQUIRE(optimize(graph).cost == 0.0);  // auto has another estimate
    OptimizerOptions short_of_steps;
    short_of_steps.max_iterations = 0;
    REQUIRE(optimize(graph, short_of_steps).cost == 0.0);
  }
  SECTION("an edge from a node to itself, NaN and indefinite information do not get into a graph") {
    Edge edge = random.graph.edges()[3];
    edge.to = edge.from;
    REQUIRE_THROWS_WITH(random.graph.add_edge(edge), Contains("same node"));
    edge = random.graph.edges()[3];
    edge.T_from_to.translation().y() = std::numeric_limits<double>::quiet_NaN();
    REQUIRE_THROWS_WITH(random.graph.add_edge(edge), Contains("not finite"));
    edge = random.graph.edges()[3];
    edge.information(2, 2) = std::numeric_limits<double>::quiet_NaN();
    REQUIRE_THROWS_AS(random.graph.add_edge(edge), InputError);
    edge.information(2, 2) = -1.0;
    REQUIRE_THROWS_AS(random.graph.add_edge(edge), InputError);
    std::vector<Eigen::Isometry3d> poses = random.graph.poses();
    poses[4].translation().x() = std::numeric_limits<double>::quiet_NaN();
    REQUIRE_THROWS_AS(random.graph.set_poses(poses), InputError);
  }
  SECTION("a request to stop keeps the best so far") {
    const StopSource source;
    source.request_stop();
    const OptimizationResult result = optimize(random.graph, {}, source.token());
    REQUIRE(result.termination == Termination::kStopped);
    REQUIRE_FALSE(result.converged);
    REQUIRE(result.cost == result.cost_initial);
    REQUIRE(result.poses.size() == random.graph.nodes().size());
  }
}

TEST_CASE("optimize: the cost never rises, from however bad a start", "[optimization][property]") {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::RandomGraph random = testing::random_graph(rng);
    for (const Node& node : random.graph.nodes())
      random.graph.set_pose(node.key, testing::random_pose(rng, 20.0));
    const OptimizationResult result = optimize(random.graph);
    double cost = result.cost_initial;
    for (const IterationRecord& record : result.trace) {
      if (!record.accepted) continue;
      REQUIRE(record.cost < cost);
      cost = record.cost;
    }
    REQUIRE(result.cost == cost);
    PoseGraph at = random.graph;
    at.set_poses(result.poses);
    REQUIRE(graph_cost(at) == Approx(result.cost).epsilon(1e-9));
  }
}

TEST_CASE("optimize: known optima from every first estimate", "[optimization][data]") {
  const auto folder = testing::test_data("g2o");
  if (!folder) return;
  for (const KnownOptimum& known : kOptima) {
    const auto path = *folder / (known.name + ".g2o");
    if (!testing::fs::exists(path)) continue;
    CAPTURE(known.name);
    const PoseGraph graph = testing::read_graph(path, known.priors);
    for (const auto initialization :
         {Initialization::kFile, Initialization::kOdometry, Initialization::kChordal}) {
      OptimizerOptions options;
      options.initialization = initialization;
      const OptimizationResult result = optimize(graph, options);
      REQUIRE(result.converged);
      REQUIRE(result.cost <= known.cost * (1.0 + 1e-8));
      REQUIRE(result.cost >= known.cost * (1.0 - 1e-8));
      REQUIRE(result.gradient <= 1e-6 * result.gradient_initial);
    }
  }
}

}  // namespace loopwise::optimizer_test
