// SPDX-License-Identifier: BSD-3-Clause
// Where optimisation starts: graphs whose odometry says nothing over the whole, and graphs that grow.
#include <algorithm>
#include <numeric>

#include <loopwise/optimization/gnc.hpp>

#include "confirmed_closures.hpp"
#include "odometry_forest.hpp"
#include "odometry_scale.hpp"
#include "pose_problem.hpp"
#include "support.hpp"

namespace loopwise::starts_test {
namespace {

/// A path wound around a torus, each turn next to the one before, with closures between neighbours in
/// adjacent turns. Odometry is so bad that its chain has no information on the path's other end. The false
/// closures are random poses between random nodes.
testing::RandomGraph torus(std::uint64_t seed, std::size_t turns, double false_share) {
  constexpr std::size_t kAround = 100;
  constexpr double kSigmaM = 0.1, kSigmaRad = 0.05;
  constexpr double kPi = 3.14159265358979323846;
  Rng rng(seed);
  const auto noise = [&] {
    Vector6d xi;
    for (int i = 0; i < 6; ++i) xi[i] = (i < 3 ? kSigmaM : kSigmaRad) * rng.normal();
    return se3::exp(xi);
  };
  testing::RandomGraph out;
  const std::size_t count = turns * kAround;
  for (std::size_t i = 0; i < count; ++i) {
    const double large = 2.0 * kPi * static_cast<double>(i) / static_cast<double>(count);
    const double small = 2.0 * kPi * static_cast<double>(i % kAround) / static_cast<double>(kAround);
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.rotate(Eigen::AngleAxisd(large, Eigen::Vector3d::UnitZ()));
    pose.translate(Eigen::Vector3d(0.05 * static_cast<double>(turns), 0.0, 0.0));
    pose.rotate(Eigen::AngleAxisd(small, Eigen::Vector3d::UnitY()));
    pose.translate(Eigen::Vector3d(1.0, 0.0, 0.0));
    pose.linear() = pose.linear() * testing::random_pose(rng, 0.0).linear();
    out.truth.push_back(pose);
  }
  Matrix6d information = Matrix6d::Zero();
  information.diagonal() << Eigen::Vector3d::Constant(1.0 / (kSigmaM * kSigmaM)),
      Eigen::Vector3d::Constant(1.0 / (kSigmaRad * kSigmaRad));
  std::vector<Edge> edges;
  const auto measure = [&](Key from, Key to, const Eigen::Isometry3d& T, EdgeKind kind) {
    Edge edge{from, to, se3::normalized(T), information};
    edge.kind = kind;
    edges.push_back(edge);
  };
  Eigen::Isometry3d drifted = out.truth[0];
  for (std::size_t i = 0; i < count; ++i) {
    if (i > 0) {
      measure(i - 1, i, out.truth[i - 1].inverse() * out.truth[i] * noise(), EdgeKind::kOdometry);
      drifted = se3::normalized(drifted * edges.back().T_from_to);
    }
    Node node;
    node.key = i;
    node.pose = drifted;
    out.graph.add_node(node);
  }
  for (std::size_t i = kAround; i < count; ++i) {
    measure(i - kAround, i, out.truth[i - kAround].inverse() * out.truth[i] * noise(),
            EdgeKind::kLoopClosure);
  }
  out.is_false.assign(edges.size(), false);
  const auto wrong =
      static_cast<std::size_t>(false_share / (1.0 - false_share) * static_cast<double>(count - kAround));
  for (std::size_t k = 0; k < wrong; ++k) {
    const Key a = rng.below(count - 1), b = rng.below(count - 1);
    if (a == b) continue;
    measure(a, b, testing::random_pose(rng, 2.0), EdgeKind::kLoopClosure);
    out.is_false.push_back(true);
  }
  for (const Edge& edge : edges) out.graph.add_edge(edge);
  out.graph.add_prior(testing::prior_at(0, out.truth[0]));
  return out;
}

/// With poses of an estimate that is far off: the path winds itself up.
testing::RandomGraph wound_up(testing::RandomGraph graph) {
  std::vector<Eigen::Isometry3d> poses = graph.graph.poses();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i] = Eigen::AngleAxisd(0.05 * static_cast<double>(i), Eigen::Vector3d::UnitZ()) * poses[i];
  }
  graph.graph.set_poses(poses);
  return graph;
}

struct Kept {
  std::size_t right = 0, wrong = 0;  ///< Closures
};

Kept kept_by(const testing::RandomGraph& graph, const GncResult& result) {
  Kept kept;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    if (known_inlier(graph.graph.edges()[e]) || result.weights[e] <= 0.5) continue;
    ++(graph.is_false[e] ? kept.wrong : kept.right);
  }
  return kept;
}

std::size_t right_closures(const testing::RandomGraph& graph) {
  std::size_t count = 0;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    count += !known_inlier(graph.graph.edges()[e]) && !graph.is_false[e] ? 1 : 0;
  }
  return count;
}

/// The first nodes of a graph, with the factors between them.
PoseGraph beginning(const PoseGraph& whole, std::size_t nodes) {
  PoseGraph out;
  for (std::size_t i = 0; i < nodes; ++i) out.add_node(whole.nodes()[i]);
  for (const PriorFactor& prior : whole.priors()) out.add_prior(prior);
  // In the order in which they come to be: each edge with the later of its ends.
  for (std::size_t i = 0; i < nodes; ++i) {
    for (std::size_t e = 0; e < whole.edges().size(); ++e) {
      const auto ends = whole.ends(e);
      if (std::max(ends.from, ends.to) == i) out.add_edge(whole.edges()[e]);
    }
  }
  return out;
}

/// A path of 120 nodes with odometry alone, whose second half passes the first: closures join nodes k and
/// k + 60.
struct TwoRounds {
  TwoRounds() {
    Rng rng(4);
    testing::RandomGraphOptions shape;
    shape.nodes = 120;
    shape.closures = 0;
    random = testing::random_graph(rng, shape);
  }
  [[nodiscard]] const PoseGraph& graph() const { return random.graph; }
  [[nodiscard]] const Matrix6d& information() const { return random.graph.edges().front().information; }
  void join(Key k, const Eigen::Isometry3d& error) {
    random.graph.add_edge(
        {k, k + 60, random.truth[k].inverse() * random.truth[k + 60] * error, information()});
  }
  testing::RandomGraph random;
};

}  // namespace

TEST_CASE("starts: random false closures are found although odometry is useless over the whole path",
          "[optimization][gnc]") {
  for (const double share : {0.1, 0.3, 0.5}) {
    for (std::uint64_t seed = 1; seed <= 3; ++seed) {
      CAPTURE(share, seed);
      const testing::RandomGraph graph = torus(seed, 8, share);
      const std::size_t right = right_closures(graph);
      const GncResult result = optimize_gnc(graph.graph);
      const Kept kept = kept_by(graph, result);
      REQUIRE(static_cast<double>(kept.right) >= 0.98 * static_cast<double>(right));
      REQUIRE(kept.wrong == 0);
      REQUIRE(result.optimization.converged);
      REQUIRE(result.start == GncStart::kConfirmed);
      GncOptions once;
      once.second_start = false;
      const GncResult graduated = optimize_gnc(graph.graph, {}, once);
      REQUIRE(2 * result.optimization.factorizations < graduated.optimization.factorizations);
    }
  }
}

TEST_CASE("starts: a closure is confirmed by one near it, a false one between random places is not",
          "[optimization][gnc]") {
  testing::RandomGraph graph = torus(7, 8, 0.5);
  // Two false ones that agree with each other.
  Edge first = graph.graph.edges().back();
  first.from = 30;
  first.to = 300;
  Edge second = first;
  second.from = 31;
  second.to = 301;
  const auto step = [&](Key k) { return graph.graph.edges()[k].T_from_to; };  // odometry from k to k + 1
  second.T_from_to = step(30).inverse() * first.T_from_to * step(300);
  graph.graph.add_edge(first);
  graph.graph.add_edge(second);
  graph.is_false.resize(graph.graph.edges().size(), true);
  const std::vector<char> all(graph.graph.edges().size(), 1);
  const std::vector<char> confirmed =
      detail::confirmed_closures(graph.graph, detail::OdometryForest(graph.graph), all, 16.8);
  std::size_t right = 0, wrong = 0;
  for (std::size_t e = 0; e + 2 < confirmed.size(); ++e) (graph.is_false[e] ? wrong : right) += confirmed[e];
  REQUIRE(static_cast<double>(right) > 0.95 * static_cast<double>(right_closures(graph)));
  REQUIRE(wrong == 0);
  REQUIRE(confirmed[confirmed.size() - 2] == 1);
  REQUIRE(confirmed.back() == 1);
}

TEST_CASE("starts: closures that confirm each other form a group", "[optimization]") {
  testing::RandomGraph graph = torus(7, 8, 0.0);
  const std::size_t before = graph.graph.edges().size();
  const auto step = [&](Key k) { return graph.graph.edges()[k].T_from_to; };  // odometry from k to k + 1
  Edge edge = graph.graph.edges().back();
  const auto add_group = [&](Key from, Key to, std::size_t size) {
    edge.from = from;
    edge.to = to;
    graph.graph.add_edge(edge);
    for (std::size_t i = 1; i < size; ++i) {
      edge.T_from_to = step(edge.from).inverse() * edge.T_from_to * step(edge.to);
      ++edge.from;
      ++edge.to;
      graph.graph.add_edge(edge);
    }
  };
  add_group(30, 300, 8);
  add_group(500, 100, 2);
  add_group(600, 200, 1);
  std::vector<char> wanted(graph.graph.edges().size(), 0);
  std::fill(wanted.begin() + static_cast<std::ptrdiff_t>(before), wanted.end(), 1);
  const detail::OdometryForest forest(graph.graph);
  std::vector<std::size_t> expected(before, 0);
  // The first and the last of the eight are too far apart to confirm each other, but others lie between.
  expected.insert(expected.end(), {8, 8, 8, 8, 8, 8, 8, 8, 2, 2, 1});
  REQUIRE(detail::group_sizes(graph.graph, forest, wanted, 16.8) == expected);
  // Closures that are not wanted belong to no group and join none.
  for (std::size_t i = 1; i < 7; ++i) wanted[before + i] = 0;
  wanted[before + 9] = 0;
  std::fill(expected.begin() + static_cast<std::ptrdiff_t>(before), expected.end(), 0);
  for (const std::size_t alone : {0, 7, 8, 10}) expected[before + alone] = 1;
  REQUIRE(detail::group_sizes(graph.graph, forest, wanted, 16.8) == expected);
}

TEST_CASE("starts: an estimate says if odometry is worse than the largest uncertainty", "[optimization]") {
  constexpr double kLargest = 9.0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    for (const double scale : {1.0, 2.0, 2.9, 3.03, 4.0, 6.0}) {
      CAPTURE(seed, scale);
      testing::RandomGraph graph = torus(seed, 4, 0.0);
      for (std::size_t k = 0; k < graph.graph.edges().size(); ++k) {
        const Edge& edge = graph.graph.edges()[k];
        if (edge.kind == EdgeKind::kOdometry)
          graph.graph.set_information(k, scale * scale * edge.information);
      }
      const std::vector<std::uint32_t> chains = detail::odometry_chains(graph.graph);
      const detail::OdometryVariances used{{0, std::min(scale * scale, kLargest)}};
      PoseGraph weighted = detail::with_odometry_variances(graph.graph, chains, used);
      weighted.set_poses(optimize(weighted).poses);
      std::vector<Eigen::Isometry3d> poses;
      for (const Node& node : weighted.nodes()) poses.push_back(node.pose);
      const auto estimate = detail::estimated_odometry_variances(
          graph.graph, chains, poses, std::vector<double>(graph.graph.edges().size(), 1.0), used, kLargest,
          true, {});
      REQUIRE(estimate);
      REQUIRE(estimate->beyond_largest == (scale > 3.5));
      if (scale > 1.0) REQUIRE(estimate->variances.at(0) == Approx(used.at(0)).epsilon(0.2));
    }
  }
}

TEST_CASE("starts: auto ends where the best of the first estimates does", "[optimization]") {
  std::size_t stuck = 0;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    CAPTURE(seed);
    const PoseGraph graph = wound_up(torus(seed, 20, 0.0)).graph;
    const auto cost_from = [&](Initialization start) {
      OptimizerOptions options;
      options.initialization = start;
      options.max_iterations = 100;
      return optimize(graph, options).cost;
    };
    const OptimizationResult result = optimize(graph);
    REQUIRE(result.converged);
    REQUIRE(result.initialization != Initialization::kFile);
    const double best = std::min(cost_from(Initialization::kChordal), cost_from(Initialization::kOdometry));
    REQUIRE(result.cost == Approx(best).epsilon(1e-6));
    stuck += cost_from(Initialization::kFile) > 1.1 * result.cost ? 1 : 0;

    PoseGraph solved = graph;
    solved.set_poses(result.poses);
    const OptimizationResult again = optimize(solved);
    REQUIRE(again.initialization == Initialization::kFile);
    REQUIRE(again.factorizations == 1);
  }
  CAPTURE(stuck);
  REQUIRE(stuck >= 1);  // from the graph's own poses it ends at a local minimum
}

TEST_CASE("starts: continued estimates of a growing graph are those from scratch, for less",
          "[optimization][gnc]") {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::RandomGraphOptions shape;
    shape.nodes = 240;
    shape.closures = 300;
    shape.false_closures = 20;
    const testing::RandomGraph whole = testing::random_graph(rng, shape);
    GncOptions continuing;
    continuing.warm_start = true;
    PoseGraphOptimizer optimizer;
    int continued = 0, all = 0, factorizations = 0, from_scratch = 0;
    for (std::size_t nodes = 60; nodes <= 240; nodes += 6, ++all) {
      const PoseGraph graph = beginning(whole.graph, nodes);
      const GncResult result = optimizer.optimize_gnc(graph, continuing);
      const GncResult scratch = optimize_gnc(graph);
      continued += result.fresh ? 0 : 1;
      factorizations += result.optimization.factorizations;
      from_scratch += scratch.optimization.factorizations;
      REQUIRE(result.truncated_cost <= scratch.truncated_cost * 1.01);
      REQUIRE(result.weights.size() == graph.edges().size());
    }
    REQUIRE(2 * continued > all);
    REQUIRE(factorizations < from_scratch);
  }
}

TEST_CASE("starts: a graph that is another than the last is solved from scratch", "[optimization][gnc]") {
  Rng rng(3);
  testing::RandomGraph random = testing::random_graph(rng);
  GncOptions continuing;
  continuing.warm_start = true;
  PoseGraphOptimizer optimizer;
  REQUIRE(optimizer.optimize_gnc(random.graph, continuing).fresh);
  const GncResult same = optimizer.optimize_gnc(random.graph, continuing);
  REQUIRE_FALSE(same.fresh);
  REQUIRE(same.start == GncStart::kLastResult);
  SECTION("an edge was taken out") {
    random.graph.remove_edges_if([&](const Edge& edge) { return &edge == &random.graph.edges().back(); });
    random.graph.remove_edges_if([&](const Edge& edge) { return edge.from == 0 && edge.to > 1; });
    REQUIRE(optimizer.optimize_gnc(random.graph, continuing).fresh ==
            (random.graph.edges().size() != random.is_false.size()));
  }
  SECTION("other measurements between the same nodes") {
    const testing::RandomGraph other = testing::random_graph(rng);
    REQUIRE(optimizer.optimize_gnc(other.graph, continuing).fresh);
  }
  SECTION("it is not asked for") {
    REQUIRE(optimizer.optimize_gnc(random.graph, GncOptions()).fresh);
  }
  SECTION("a bound of 0 on growth") {
    continuing.warm_growth = 0.0;
    REQUIRE(optimizer.optimize_gnc(random.graph, continuing).fresh);
  }
}

TEST_CASE("starts: a false closure that came first is found when others contradict it",
          "[optimization][gnc]") {
  // Only odometry supports it at first; twenty true closures contradict it later.
  Rng rng(11);
  testing::RandomGraphOptions shape;
  shape.nodes = 120;
  shape.closures = 0;
  testing::RandomGraph random = testing::random_graph(rng, shape);
  GncOptions continuing;
  continuing.warm_start = true;
  PoseGraphOptimizer optimizer;
  const Matrix6d information = random.graph.edges().front().information;
  const auto join = [&](Key from, Key to, const Eigen::Isometry3d& error) {
    Edge edge{from, to, random.truth[from].inverse() * random.truth[to] * error, information};
    random.graph.add_edge(edge);
  };
  Eigen::Isometry3d wrong = Eigen::Isometry3d::Identity();
  wrong.translation() = Eigen::Vector3d(0.2, -0.2, 0.1);
  join(20, 100, wrong);
  const GncResult early = optimizer.optimize_gnc(random.graph, continuing);
  REQUIRE(early.inliers == 1);
  for (Key k = 0; k < 20; ++k) join(15 + k, 95 + k, Eigen::Isometry3d::Identity());
  const GncResult late = optimizer.optimize_gnc(random.graph, continuing);
  REQUIRE(late.inliers == 20);
  REQUIRE(late.weights[119] == 0.0);
}

TEST_CASE("starts: excluded closures that agree cause a solution from scratch if they are not few",
          "[optimization][gnc]") {
  for (const std::size_t excluded : {2, 6}) {
    CAPTURE(excluded);
    TwoRounds rounds;
    for (Key k = 0; k < 240; ++k) rounds.join(k % 40, Eigen::Isometry3d::Identity());
    GncOptions continuing;
    continuing.warm_start = true;
    PoseGraphOptimizer optimizer;
    REQUIRE(optimizer.optimize_gnc(rounds.graph(), continuing).inliers >= 236);
    const Eigen::Isometry3d shift(Eigen::Translation3d(30.0, 0.0, 0.0));
    for (Key k = 45; k < 45 + excluded; ++k) {
      const Eigen::Isometry3d& end = rounds.random.truth[k + 60];
      rounds.join(k, end.inverse() * shift * end);  // the same shift in the world
    }
    const GncResult result = optimizer.optimize_gnc(rounds.graph(), continuing);
    REQUIRE(result.outliers >= excluded);
    REQUIRE(result.fresh == (excluded > 2));  // of 240, one in a hundred
  }
}

TEST_CASE(
    "starts: a kept closure that no longer fits causes a solution from scratch if it is not the only one",
    "[optimization][gnc]") {
  for (const std::size_t false_ones : {1, 4}) {
    CAPTURE(false_ones);
    TwoRounds rounds;
    for (Key k = 0; k < 240; ++k) rounds.join(k % 40, Eigen::Isometry3d::Identity());
    // Odometry, with eleven steps from the last of these, allows the shift; one measurement of the truth does
    // too, but not eight.
    const Eigen::Isometry3d shift(
        Eigen::Translation3d(5.0 / std::sqrt(rounds.information()(0, 0)), 0.0, 0.0));
    for (Key k = 0; k < false_ones; ++k) rounds.join(50 + k, shift);
    GncOptions continuing;
    continuing.warm_start = true;
    PoseGraphOptimizer optimizer;
    const GncResult before = optimizer.optimize_gnc(rounds.graph(), continuing);
    for (std::size_t k = 0; k < false_ones; ++k)
      REQUIRE(before.weights[before.weights.size() - 1 - k] == 1.0);
    for (Key k = 0; k < 8 * false_ones; ++k) rounds.join(50 + k / 8, Eigen::Isometry3d::Identity());
    const GncResult result = optimizer.optimize_gnc(rounds.graph(), continuing);
    for (std::size_t k = 0; k < false_ones; ++k)
      REQUIRE(result.weights[before.weights.size() - 1 - k] == 0.0);
    REQUIRE(result.fresh == (false_ones > 1));
  }
}

TEST_CASE("starts: a solution from scratch ends at a minimum of its closures", "[optimization][gnc]") {
  // Large noise: descents that only decide about closures stop up to 3e-8 above the minimum.
  testing::RandomGraphOptions shape;
  shape.nodes = 300;
  shape.closures = 150;
  shape.false_closures = 37;
  shape.sigma_m = 0.2;
  shape.sigma_rad = 0.1;
  for (const std::uint64_t seed : {9, 10, 11}) {
    CAPTURE(seed);
    Rng rng(seed);
    PoseGraph graph = testing::random_graph(rng, shape).graph;
    const GncResult result = PoseGraphOptimizer().optimize_gnc(graph, {});
    graph.set_poses(result.optimization.poses);
    for (std::size_t e = 0; e < graph.edges().size(); ++e) graph.set_weight(e, result.weights[e]);
    const OptimizationResult again = optimize(graph);
    REQUIRE(result.outliers >= shape.false_closures);
    REQUIRE(again.cost_initial == Approx(result.optimization.cost).epsilon(1e-9));
    REQUIRE(again.cost == Approx(again.cost_initial).epsilon(1e-10));
  }
}

TEST_CASE("starts: kernels that do not truncate are not continued", "[optimization][gnc]") {
  Rng rng(6);
  testing::RandomGraphOptions shape;
  shape.false_closures = 4;
  const PoseGraph graph = testing::random_graph(rng, shape).graph;
  GncOptions cauchy;
  cauchy.kernel = RobustKernel::kCauchy;
  cauchy.warm_start = true;
  PoseGraphOptimizer optimizer;
  const GncResult first = optimizer.optimize_gnc(graph, cauchy),
                  again = optimizer.optimize_gnc(graph, cauchy);
  REQUIRE(again.fresh);
  REQUIRE(again.weights == first.weights);
}

TEST_CASE("starts: closures that contradict each other alone leave nothing free", "[optimization][gnc]") {
  PoseGraph graph;
  for (const Key key : {0, 1}) {
    Node node;
    node.key = key;
    node.pose.translation().x() = 5.0 * static_cast<double>(key);
    graph.add_node(node);
  }
  OptimizerOptions options;
  options.initialization = Initialization::kFile;
  GncOptions gnc;
  gnc.warm_start = true;
  PoseGraphOptimizer optimizer(options);
  REQUIRE(optimizer.optimize_gnc(graph, gnc).inliers == 0);
  for (const double x : {0.0, 10.0}) {
    Edge edge{0, 1, Eigen::Isometry3d::Identity(), 100.0 * Matrix6d::Identity()};
    edge.T_from_to.translation().x() = x;
    graph.add_edge(edge);
  }
  const GncResult result = optimizer.optimize_gnc(graph, gnc);
  REQUIRE(result.inliers <= 1);
  REQUIRE(result.optimization.poses.size() == 2);
}

TEST_CASE("starts: a request to stop before anything is solved leaves the graph's components",
          "[optimization][gnc]") {
  Rng rng(8);
  PoseGraph large;
  for (const std::size_t offset : {0, 100}) {
    for (Key k = 0; k < 40; ++k) {
      Node node;
      node.key = offset + k;
      large.add_node(node);
      if (k == 0) continue;
      Edge edge{node.key - 1, node.key, testing::random_pose(rng), Matrix6d::Identity()};
      edge.kind = EdgeKind::kOdometry;
      large.add_edge(edge);
    }
  }
  const PoseGraph small = testing::random_graph(rng).graph;
  StopSource stop;
  stop.request_stop();
  for (const RobustKernel kernel :
       {RobustKernel::kGncTls, RobustKernel::kTls, RobustKernel::kCauchy, RobustKernel::kGemanMcClure}) {
    GncOptions gnc;
    gnc.kernel = kernel;
    gnc.warm_start = true;
    PoseGraphOptimizer fresh, used;
    REQUIRE(used.optimize_gnc(large, gnc).optimization.held.size() == 2);
    for (PoseGraphOptimizer* optimizer : {&fresh, &used}) {
      const GncResult result = optimizer->optimize_gnc(small, gnc, stop.token());
      REQUIRE(result.optimization.termination == Termination::kStopped);
      REQUIRE(result.optimization.components == 1);
      REQUIRE(result.optimization.held.empty());
    }
  }
}

TEST_CASE("starts: the inverse between sparse columns is that of the whole matrix", "[optimization]") {
  Rng rng(4);
  testing::RandomGraphOptions shape;
  shape.nodes = 60;
  shape.closures = 60;
  const PoseGraph graph = testing::random_graph(rng, shape).graph;
  const Eigen::MatrixXd H = testing::dense_hessian(graph, nullptr);
  const detail::PoseProblem problem(graph);
  ThreadPool pool(1);
  const std::vector<detail::Pose> poses = problem.poses_of(graph.poses());
  for (const Factorization kind : {Factorization::kMultifrontal, Factorization::kSimplicial}) {
    std::vector<Vector6d> residuals;
    static_cast<void>(problem.cost(poses, pool, residuals));
    detail::NormalEquations equations(kind);
    equations.set_structure(problem);
    equations.linearize(problem, poses, residuals, pool);
    REQUIRE(equations.hessian().factorize());
    const detail::BlockCholesky& cholesky = equations.hessian();
    detail::SparseInverse inverse(cholesky.panels());
    // Several times, since the workspace is used again; once without any block, once with a block twice.
    for (const std::vector<std::uint32_t>& nodes :
         {std::vector<std::uint32_t>{7, 44}, {44, 3}, {59}, {}, {12, 12}, {7, 44}}) {
      Eigen::MatrixXd b = Eigen::MatrixXd::Zero(H.rows(), 6);
      std::vector<detail::SparseInverse::Block> blocks;
      for (const std::uint32_t node : nodes) {
        blocks.push_back({static_cast<std::uint32_t>(cholesky.position(node)), Matrix6d::Random()});
        b.middleRows<6>(6 * Eigen::Index{node}) += blocks.back().value;
      }
      const Eigen::MatrixXd expected = b.transpose() * H.ldlt().solve(b);
      REQUIRE((inverse.between(blocks) - expected).norm() <= 1e-8 * expected.norm());
    }
  }
}

}  // namespace loopwise::starts_test
