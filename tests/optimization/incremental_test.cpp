// SPDX-License-Identifier: BSD-3-Clause
#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/optimization/incremental.hpp>

#include "linalg/incremental_cholesky.hpp"
#include "support.hpp"

namespace loopwise::incremental_test {
namespace {

using namespace loopwise::testing;

/// Until nothing is left to do.
IncrementalOptions exact() {
  IncrementalOptions options;
  options.tolerance = 1e-5;
  options.remainder = 0.0;
  return options;
}

OptimizerOptions from_file() {
  OptimizerOptions options;
  options.initialization = Initialization::kFile;
  return options;
}

double furthest_apart(const PoseGraph& a, const std::vector<Eigen::Isometry3d>& b) {
  double most = 0.0;
  for (std::size_t i = 0; i < b.size(); ++i) {
    most = std::max(most, (a.nodes()[i].pose.matrix() - b[i].matrix()).cwiseAbs().maxCoeff());
  }
  return most;
}

/// The estimate is the minimum that optimize() finds for the same graph.
void check_against_optimize(const PoseGraph& graph, double cost) {
  const OptimizationResult whole = optimize(graph, from_file());
  CHECK(cost == Approx(whole.cost).epsilon(1e-9).margin(1e-12));
  CHECK(furthest_apart(graph, whole.poses) < 1e-5);
}

/// Adds a graph's nodes one by one, with the factors whose ends are there.
class Feeder {
 public:
  Feeder(const PoseGraph& graph, IncrementalOptimizer& optimizer) : graph_(graph), optimizer_(optimizer) {}

  void add_node() {
    Node node = graph_.nodes()[next_];
    for (const Edge& edge : graph_.edges()) {
      if (edge.to == node.key && edge.kind == EdgeKind::kOdometry && optimizer_.graph().contains(edge.from))
        node.pose = se3::normalized(optimizer_.graph().node(edge.from).pose * edge.T_from_to);
    }
    optimizer_.add_node(node);
    ++next_;
    const auto ready = [&](Key a, Key b) {
      return std::max(graph_.index_of(a), graph_.index_of(b)) == next_ - 1;
    };
    for (const Edge& edge : graph_.edges()) {
      if (ready(edge.from, edge.to)) optimizer_.add_edge(edge);
    }
    for (const PriorFactor& prior : graph_.priors()) {
      if (ready(prior.key, prior.key)) optimizer_.add_prior(prior);
    }
    for (const RangeFactor& range : graph_.ranges()) {
      if (ready(range.from, range.to)) optimizer_.add_range(range);
    }
    for (const GravityFactor& gravity : graph_.gravities()) {
      if (ready(gravity.key, gravity.key)) optimizer_.add_gravity(gravity);
    }
  }
  [[nodiscard]] bool done() const { return next_ == graph_.nodes().size(); }

 private:
  const PoseGraph& graph_;
  IncrementalOptimizer& optimizer_;
  std::size_t next_ = 0;
};

/// Several robots' random graphs in one, apart from each other.
PoseGraph side_by_side(Rng& rng, std::size_t count, bool priors) {
  PoseGraph out;
  for (std::size_t robot = 0; robot < count; ++robot) {
    RandomGraphOptions options;
    options.nodes = 15;
    options.prior = priors && robot == 0;
    const RandomGraph random = random_graph(rng, options);
    for (Node node : random.graph.nodes()) {
      node.key += 100 * robot;
      out.add_node(node);
    }
    for (Edge edge : random.graph.edges()) {
      edge.from += 100 * robot;
      edge.to += 100 * robot;
      out.add_edge(edge);
    }
    for (const PriorFactor& prior : random.graph.priors()) out.add_prior(prior);
  }
  return out;
}

Edge tie(const PoseGraph& graph, Rng& rng, Key from, Key to) {
  Edge edge;
  edge.from = from;
  edge.to = to;
  edge.T_from_to = graph.node(from).pose.inverse() * graph.node(to).pose * random_pose(rng, 0.05, 0.05);
  edge.information = 1e4 * Matrix6d::Identity();
  return edge;
}

}  // namespace

TEST_CASE("incremental: a graph that grows node by node has the minimum of the whole",
          "[optimization][property]") {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    RandomGraphOptions options;
    options.nodes = 60;
    options.closures = 40;
    options.prior = seed % 2 == 0;
    RandomGraph random = random_graph(rng, options);
    if (seed > 3) add_auxiliary_factors(random, rng);
    IncrementalOptimizer optimizer({}, {}, exact());
    Feeder feeder(random.graph, optimizer);
    std::size_t updates = 0, from_scratch = 0;
    while (!feeder.done()) {
      feeder.add_node();
      const IncrementalResult result = optimizer.update();
      ++updates;
      from_scratch += result.from_scratch ? 1 : 0;
      CHECK(result.converged);
      if (updates % 10 == 0) check_against_optimize(optimizer.graph(), result.cost);
    }
    CHECK(optimizer.graph().edges().size() == random.graph.edges().size());
    CHECK(from_scratch < updates / 2);
  }
}

TEST_CASE("incremental: closures in batches between poses that are there", "[optimization]") {
  Rng rng(3);
  RandomGraphOptions options;
  options.nodes = 400;
  options.closures = 300;
  const RandomGraph random = random_graph(rng, options);
  PoseGraph start = random.graph;
  start.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry && edge.from > 100; });
  std::vector<Edge> left;
  for (const Edge& edge : random.graph.edges()) {
    if (edge.kind != EdgeKind::kOdometry && edge.from > 100) left.push_back(edge);
  }
  REQUIRE(left.size() > 100);
  IncrementalOptimizer optimizer(start, {}, exact());
  for (std::size_t i = 0; i < left.size(); ++i) {
    optimizer.add_edge(left[i]);
    if (i % 20 != 19) continue;
    const IncrementalResult result = optimizer.update();
    CHECK(result.converged);
    check_against_optimize(optimizer.graph(), result.cost);
  }
}

TEST_CASE("incremental: an update leaves little to the next one", "[optimization]") {
  Rng rng(4);
  RandomGraphOptions options;
  options.nodes = 300;
  options.closures = 200;
  const RandomGraph random = random_graph(rng, options);
  PoseGraph start = random.graph;
  start.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry && edge.from > 150; });
  IncrementalOptimizer optimizer(start);
  double highest = 0.0;
  int added = 0;
  for (const Edge& edge : random.graph.edges()) {
    if (edge.kind == EdgeKind::kOdometry || edge.from <= 150) continue;
    optimizer.add_edge(edge);
    if (++added % 5 != 0) continue;
    const double cost = optimizer.update().cost;
    highest = std::max(highest, cost - optimize(optimizer.graph(), from_file()).cost);
  }
  // Of some hundred degrees of freedom; half a standard deviation of one of them costs 0.125.
  CHECK(highest < 0.5);
  CHECK(highest >= -1e-6);
}

TEST_CASE("incremental: weights come and go", "[optimization][property]") {
  Rng rng(5);
  RandomGraphOptions options;
  options.nodes = 80;
  options.closures = 40;
  const RandomGraph random = random_graph(rng, options);
  IncrementalOptimizer optimizer(random.graph, {}, exact());
  const double all = optimizer.update().cost;
  for (int round = 0; round < 8; ++round) {
    for (int k = 0; k < 6; ++k) {
      const std::size_t edge = 79 + rng.below(40);
      optimizer.set_weight(edge, round % 2 == 0 ? 0.0 : rng.uniform());
    }
    const IncrementalResult result = optimizer.update();
    CHECK(result.converged);
    check_against_optimize(optimizer.graph(), result.cost);
  }
  for (std::size_t edge = 0; edge < random.graph.edges().size(); ++edge) optimizer.set_weight(edge, 1.0);
  CHECK(optimizer.update().cost == Approx(all).epsilon(1e-9));
}

TEST_CASE("incremental: components join and come apart", "[optimization]") {
  for (const bool priors : {true, false}) {
    CAPTURE(priors);
    Rng rng(6);
    const PoseGraph graph = side_by_side(rng, 3, priors);
    IncrementalOptimizer optimizer(graph, {}, exact());
    check_against_optimize(optimizer.graph(), optimizer.update().cost);
    std::vector<std::size_t> ties;
    for (const auto& [from, to] : {std::pair<Key, Key>{205, 103}, {4, 110}, {8, 212}}) {
      ties.push_back(optimizer.add_edge(tie(optimizer.graph(), rng, from, to)));
      const IncrementalResult result = optimizer.update();
      CHECK(result.converged);
      check_against_optimize(optimizer.graph(), result.cost);
    }
    for (const std::size_t edge : ties) {
      optimizer.set_weight(edge, 0.0);
      const IncrementalResult result = optimizer.update();
      CHECK(result.converged);
      check_against_optimize(optimizer.graph(), result.cost);
    }
    // A node that nothing holds stays where it is.
    Node loose;
    loose.key = 999;
    loose.pose.translation() << 1.0, 2.0, 3.0;
    optimizer.add_node(loose);
    CHECK(optimizer.update().converged);
    CHECK(optimizer.graph().node(999).pose.translation() == loose.pose.translation());
  }
}

TEST_CASE("incremental: a prior that arrives moves its component", "[optimization]") {
  Rng rng(7);
  RandomGraphOptions options;
  options.prior = false;
  const RandomGraph random = random_graph(rng, options);
  IncrementalOptimizer optimizer(random.graph, {}, exact());
  const double before = optimizer.update().cost;
  const Eigen::Isometry3d place = random_pose(rng, 20.0, 1.0);
  optimizer.add_prior(prior_at(3, place));
  const IncrementalResult result = optimizer.update();
  CAPTURE(result.iterations, result.from_scratch, result.relinearized, result.moved);
  CHECK(result.converged);
  CHECK(result.cost == Approx(before).epsilon(1e-6));
  CHECK((optimizer.graph().node(3).pose.matrix() - place.matrix()).cwiseAbs().maxCoeff() < 1e-6);
}

TEST_CASE("incremental: a Hessian that is singular is left to the damped optimiser", "[optimization]") {
  PoseGraph graph;
  for (Key key = 0; key < 4; ++key) {
    Node node;
    node.key = key;
    node.pose.translation().x() = static_cast<double>(key);
    graph.add_node(node);
  }
  Matrix6d no_height = 1e4 * Matrix6d::Identity();
  no_height(2, 2) = 0.0;
  for (Key key = 1; key < 4; ++key) {
    Edge edge;
    edge.from = key - 1;
    edge.to = key;
    edge.T_from_to.translation().x() = 1.1;
    edge.information = no_height;
    edge.kind = EdgeKind::kOdometry;
    graph.add_edge(edge);
  }
  IncrementalOptimizer optimizer(graph, {}, exact());
  Edge closure;
  closure.from = 0;
  closure.to = 3;
  closure.T_from_to.translation().x() = 3.4;
  closure.information = no_height;
  optimizer.add_edge(closure);
  const IncrementalResult result = optimizer.update();
  CHECK(result.from_scratch);
  CHECK(result.cost == Approx(optimize(optimizer.graph(), from_file()).cost).epsilon(1e-6));
}

TEST_CASE("incremental: planar poses stay in the plane", "[optimization][planar]") {
  Rng rng(12);
  PoseGraph graph;
  graph.set_planar(true);
  std::vector<Eigen::Isometry3d> truth;
  for (Key key = 0; key < 60; ++key) {
    const double angle = 0.2 * static_cast<double>(key);
    truth.push_back(planar::pose(5.0 * std::cos(angle), 5.0 * std::sin(angle), angle));
    Node node;
    node.key = key;
    node.pose = truth.back();
    graph.add_node(node);
  }
  const auto add = [&](PoseGraph& to, Key a, Key b, EdgeKind kind) {
    Edge edge;
    edge.from = a;
    edge.to = b;
    edge.T_from_to = truth[a].inverse() * truth[b] *
                     planar::pose(0.05 * rng.normal(), 0.05 * rng.normal(), 0.01 * rng.normal());
    edge.information = 400.0 * Matrix6d::Identity();
    edge.kind = kind;
    to.add_edge(edge);
  };
  for (Key key = 1; key < 60; ++key) add(graph, key - 1, key, EdgeKind::kOdometry);
  IncrementalOptimizer optimizer(graph, {}, exact());
  PoseGraph closures = graph;
  for (Key key = 0; key < 25; ++key) {
    add(closures, key, key + 31, EdgeKind::kLoopClosure);
    optimizer.add_edge(closures.edges().back());
  }
  const IncrementalResult result = optimizer.update();
  CHECK(result.converged);
  CHECK_FALSE(result.from_scratch);
  check_against_optimize(optimizer.graph(), result.cost);
  for (const Node& node : optimizer.graph().nodes()) CHECK(planar::is_pose(node.pose));
}

TEST_CASE("incremental: the same bits for any number of threads", "[optimization][property]") {
  Rng rng(8);
  RandomGraphOptions options;
  options.nodes = 900;
  options.closures = 900;
  const RandomGraph random = random_graph(rng, options);
  PoseGraph start = random.graph;
  start.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry && edge.from < 300; });
  const auto run = [&](int threads) {
    OptimizerOptions optimization;
    optimization.threads = threads;
    IncrementalOptimizer optimizer(start, optimization);
    for (const Edge& edge : random.graph.edges()) {
      if (edge.kind != EdgeKind::kOdometry && edge.from < 300) optimizer.add_edge(edge);
    }
    static_cast<void>(optimizer.update());
    return optimizer.graph().poses();
  };
  const std::vector<Eigen::Isometry3d> one = run(1), three = run(3);
  for (std::size_t i = 0; i < one.size(); ++i) CHECK(one[i].matrix() == three[i].matrix());
}

TEST_CASE("incremental: a request to stop keeps the poses reached", "[optimization]") {
  Rng rng(9);
  const RandomGraph random = random_graph(rng);
  IncrementalOptimizer optimizer(random.graph, {}, exact());
  optimizer.add_edge(tie(optimizer.graph(), rng, 3, 20));
  StopSource source;
  source.request_stop();
  const IncrementalResult stopped = optimizer.update(source.token());
  CHECK_FALSE(stopped.converged);
  CHECK(stopped.iterations == 0);
  const IncrementalResult result = optimizer.update();
  CHECK(result.converged);
  check_against_optimize(optimizer.graph(), result.cost);
}

TEST_CASE("incremental: an update continues a solution that ran out of iterations", "[optimization]") {
  Rng rng(13);
  const RandomGraph random = random_graph(rng);
  OptimizerOptions few;
  few.max_iterations = 1;
  few.initialization = Initialization::kFile;
  IncrementalOptimizer optimizer(random.graph, few, exact());
  IncrementalResult result = optimizer.update();
  CHECK(result.iterations > 0);
  CHECK(result.converged);
  check_against_optimize(optimizer.graph(), result.cost);
}

TEST_CASE("incremental: a false closure leaves no trace", "[optimization]") {
  Rng rng(14);
  const RandomGraph random = random_graph(rng);
  IncrementalOptimizer optimizer(random.graph, {}, exact());
  const double before = optimizer.update().cost;
  Edge edge = tie(optimizer.graph(), rng, 3, 20);
  edge.T_from_to.translation().x() += 1e6;
  edge.information *= 1e8;
  edge.weight = 0.0;
  const std::size_t number = optimizer.add_edge(edge);
  CHECK(optimizer.update().cost == Approx(before).epsilon(1e-12));
  StopSource stop;
  stop.request_stop();
  optimizer.set_weight(number, 1.0);
  static_cast<void>(optimizer.update(stop.token()));  // taken in, and no step taken
  optimizer.set_weight(number, 0.0);
  const IncrementalResult result = optimizer.update();
  CHECK(result.converged);
  CHECK(result.cost == Approx(before).epsilon(1e-9));
  check_against_optimize(optimizer.graph(), result.cost);
}

TEST_CASE("incremental: many closures at once get a new order", "[optimization]") {
  Rng rng(15);
  RandomGraphOptions options;
  options.nodes = 200;
  options.closures = 100;
  const RandomGraph random = random_graph(rng, options);
  PoseGraph chain = random.graph;
  chain.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry; });
  IncrementalOptimizer optimizer(chain, {}, exact());
  for (const Edge& edge : random.graph.edges()) {
    if (edge.kind != EdgeKind::kOdometry) optimizer.add_edge(edge);
  }
  const IncrementalResult result = optimizer.update();
  CHECK(result.reordered);
  CHECK(result.converged);
  check_against_optimize(optimizer.graph(), result.cost);
}

TEST_CASE("incremental: closures all over the graph call for a new order from time to time",
          "[optimization]") {
  Rng rng(71);
  RandomGraphOptions options;
  options.nodes = 500;
  options.closures = 1500;
  PoseGraph start = random_graph(rng, options).graph;
  std::vector<Edge> closures;
  start.remove_edges_if([&](const Edge& edge) {
    if (edge.kind == EdgeKind::kOdometry || rng.below(3) > 0) return false;
    closures.push_back(edge);
    return true;
  });
  IncrementalOptimizer optimizer(start, from_file());
  std::size_t updates = 0, orders = 0;
  for (std::size_t k = 0; k < closures.size(); ++k) {
    optimizer.add_edge(closures[k]);
    if (k % 20 != 19) continue;
    ++updates;
    const IncrementalResult result = optimizer.update();
    REQUIRE_FALSE(result.from_scratch);
    orders += result.reordered ? 1 : 0;
  }
  CAPTURE(updates, orders);
  REQUIRE(updates >= 20);
  REQUIRE(orders >= 2);
  REQUIRE(orders <= updates / 2);
}

TEST_CASE("incremental: nodes that come one by one need no solution from scratch", "[optimization]") {
  Rng rng(73);
  RandomGraphOptions options;
  options.nodes = 600;
  options.closures = 20;
  const PoseGraph graph = random_graph(rng, options).graph;
  // Steps that end at the tolerance leave parts of the gradient, which later updates have to follow.
  IncrementalOptimizer optimizer(graph, from_file());
  Node last = graph.nodes().back();
  Edge step = graph.edges().front();
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kOdometry) step = edge;
  }
  int orders = 0;
  for (int i = 1; i <= 60; ++i) {
    CAPTURE(i);
    step.from = last.key;
    step.to = ++last.key;
    last.pose = optimizer.graph().node(step.from).pose * step.T_from_to;
    optimizer.add_node(last);
    optimizer.add_edge(step);
    if (i == 50) {
      Edge closure = step;
      closure.kind = EdgeKind::kLoopClosure;
      closure.from = graph.nodes().front().key;
      closure.T_from_to = graph.nodes().front().pose.inverse() * optimizer.graph().node(closure.to).pose;
      optimizer.add_edge(closure);
    }
    const IncrementalResult result = optimizer.update();
    REQUIRE_FALSE(result.from_scratch);
    orders += result.reordered ? 1 : 0;
  }
  REQUIRE(orders <= 3);
  REQUIRE(furthest_apart(optimizer.graph(), optimize(optimizer.graph(), from_file()).poses) < 0.02);
}

TEST_CASE("incremental: bad input changes nothing", "[optimization][error]") {
  CHECK_THROWS_AS(IncrementalOptimizer({}, {},
                                       [] {
                                         IncrementalOptions options;
                                         options.tolerance = 0.0;
                                         return options;
                                       }()),
                  OptionError);
  Rng rng(10);
  const RandomGraph random = random_graph(rng);
  IncrementalOptimizer optimizer(random.graph, {}, exact());
  Edge edge = tie(optimizer.graph(), rng, 3, 20);
  edge.to = 12345;
  CHECK_THROWS_AS(optimizer.add_edge(edge), UnknownKeyError);
  CHECK_THROWS_AS(optimizer.add_node(random.graph.nodes().front()), InputError);
  CHECK_THROWS_AS(optimizer.set_weight(0, 2.0), InputError);
  CHECK_THROWS_AS(optimizer.set_weight(1000, 1.0), InputError);
  CHECK(optimizer.graph().edges().size() == random.graph.edges().size());
  CHECK(optimizer.update().converged);
  IncrementalOptimizer empty;
  CHECK(empty.update().converged);
  CHECK(empty.graph().empty());
}

TEST_CASE("incremental factor: solves like a dense one after every change", "[optimization][property]") {
  Rng rng(11);
  constexpr std::uint32_t kLast = 40;
  std::uint32_t n = 25;
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(6 * kLast, 6 * kLast);
  std::vector<std::vector<char>> linked(kLast, std::vector<char>(kLast, 0));
  const auto link = [&](std::uint32_t a, std::uint32_t b) {
    Eigen::Matrix<double, 6, 12> J;
    for (int i = 0; i < 72; ++i) J(i / 12, i % 12) = rng.normal();
    const Eigen::Matrix<double, 12, 12> A = J.transpose() * J;
    const Eigen::Index i = 6 * Eigen::Index{a}, j = 6 * Eigen::Index{b};
    H.block<6, 6>(i, i) += A.topLeftCorner<6, 6>();
    H.block<6, 6>(j, j) += A.bottomRightCorner<6, 6>();
    H.block<6, 6>(i, j) += A.topRightCorner<6, 6>();
    H.block<6, 6>(j, i) += A.bottomLeftCorner<6, 6>();
    linked[a][b] = linked[b][a] = 1;
  };
  for (std::uint32_t v = 0; v < kLast; ++v) H.block<6, 6>(6 * v, 6 * v) = Matrix6d::Identity();
  std::vector<detail::BlockPair> pairs;
  for (std::uint32_t v = 1; v < n; ++v) {
    link(v - 1, v);
    pairs.emplace_back(v - 1, v);
  }
  detail::IncrementalCholesky factor;
  factor.analyze(n, pairs);
  const auto load = [&](std::uint32_t v, auto&& add) {
    add(v, H.block<6, 6>(6 * v, 6 * v));
    for (std::uint32_t u = 0; u < n; ++u) {
      if (linked[u][v] != 0 && factor.position(u) > factor.position(v)) add(u, H.block<6, 6>(6 * u, 6 * v));
    }
  };
  for (int round = 0; round < 60; ++round) {
    if (round % 4 == 3 && n < kLast) {
      factor.append();
      ++n;
      link(n - 2, n - 1);
      factor.insert(n - 2, n - 1);
    } else {
      const auto a = static_cast<std::uint32_t>(rng.below(n));
      const auto b = static_cast<std::uint32_t>((a + 1 + rng.below(n - 1)) % n);
      link(a, b);
      factor.insert(a, b);
    }
    REQUIRE(factor.refactorize(load));
    const auto where = static_cast<std::uint32_t>(rng.below(n));
    Eigen::VectorXd b = Eigen::VectorXd::Zero(6 * Eigen::Index{n});
    b.segment<6>(6 * Eigen::Index{where}).setOnes();
    std::vector<double> x(6 * n, 0.0);
    std::fill_n(x.begin() + 6 * factor.position(where), 6, 1.0);
    std::vector<std::uint32_t> visited;
    factor.solve({factor.position(where)}, 0.0, x, visited);
    const Eigen::VectorXd dense = H.topLeftCorner(6 * n, 6 * n).llt().solve(b);
    double worst = 0.0;
    for (std::uint32_t v = 0; v < n; ++v) {
      const Eigen::Map<Vector6d> mine(x.data() + 6 * factor.position(v));
      worst = std::max(worst, (mine - dense.segment<6>(6 * Eigen::Index{v})).cwiseAbs().maxCoeff());
    }
    CHECK(worst < 1e-9 * std::max(1.0, dense.cwiseAbs().maxCoeff()));
  }
}

}  // namespace loopwise::incremental_test
