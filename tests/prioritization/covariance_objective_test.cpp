// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/covariance_objective.hpp>

#include <numeric>

#include <loopwise/core/error.hpp>

#include "graphs.hpp"
#include "testing.hpp"

namespace loopwise::covariance_objective_test {
namespace {

using testing::brute_force;
using testing::random_candidates;

std::vector<std::size_t> random_set(std::size_t size, std::size_t count, Rng& rng) {
  std::vector<std::size_t> all(size);
  std::iota(all.begin(), all.end(), std::size_t{0});
  rng.shuffle(all);
  all.resize(count);
  return all;
}

std::size_t random_outside(const GraphObjective& objective, Rng& rng) {
  while (true) {
    const std::size_t i = rng.below(objective.size());
    if (!objective.contains(i)) return i;
  }
}

std::vector<std::size_t> plus(std::vector<std::size_t> set, std::size_t in) {
  set.push_back(in);
  return set;
}

std::vector<std::size_t> minus(std::vector<std::size_t> set, std::size_t out) {
  set.erase(std::find(set.begin(), set.end(), out));
  return set;
}

/// Compares the objective's value, additions, removals and swaps with brute force. \returns the largest error
/// in units of e(now) · max(1, e(nothing) / e(now)).
template <class Score>
double worst_error(GraphObjective& objective, const Score& score, double empty, int samples, Rng& rng) {
  const std::vector<std::size_t> set = objective.selected();
  const double now = score(set);
  const double unit = std::abs(now) * std::max(1.0, empty / now);
  double worst = std::abs(objective.value() - now) / unit;
  for (int k = 0; k < samples; ++k) {
    const std::size_t in = random_outside(objective, rng);
    const std::size_t out = set[rng.below(set.size())];
    worst = std::max(worst, std::abs(now + objective.add_change(in) - score(plus(set, in))) / unit);
    worst = std::max(worst, std::abs(now + objective.remove_change(out) - score(minus(set, out))) / unit);
    worst = std::max(
        worst, std::abs(now + objective.swap_change(out, in) - score(plus(minus(set, out), in))) / unit);
  }
  return worst;
}

/// Swaps back and forth at random, as a hot annealing does.
void swap_at_random(GraphObjective& objective, int moves, Rng& rng) {
  for (int k = 0; k < moves; ++k) {
    const std::size_t out = objective.selected()[rng.below(objective.selected().size())];
    objective.swap(out, random_outside(objective, rng));
  }
}

}  // namespace

TEST_CASE("covariance objective: equals adding, refactorising and inverting", "[prioritization][graph]") {
  const std::uint64_t seed = GENERATE(range(1, 25));
  const BlockStorage storage = GENERATE(BlockStorage::kColumns, BlockStorage::kDense);
  CAPTURE(seed, storage);
  Rng rng(seed);
  testing::RandomGraphOptions shape;
  shape.nodes = 20 + 2 * seed;
  shape.closures = seed % 3 == 0 ? 0 : seed;  // some with odometry alone
  testing::RandomGraph random = testing::random_graph(rng, shape);
  if (seed % 2 == 0) testing::add_auxiliary_factors(random, rng);
  const PoseGraph& graph = random.graph;
  const auto candidates = random_candidates(graph, 40, rng);
  ClosureModelOptions options;
  options.storage = storage;
  options.trace = seed % 4 == 0 ? TraceKind::kFull : TraceKind::kTranslation;
  CovarianceObjective objective(graph, candidates, options);
  REQUIRE(objective.storage() == storage);
  const auto score = [&](const std::vector<std::size_t>& set) {
    return brute_force(graph, candidates, set, options);
  };
  const double empty = score({});
  // Measured 2e-11 with ranges and odometry alone, 1e-12 else.
  REQUIRE(objective.value() == Approx(empty).epsilon(1e-10));
  objective.assign(random_set(candidates.size(), 15, rng));
  // Measured over the seeds: 3e-13 fresh, 2e-12 after 1000 swaps; leaving out the cross terms of a swap gives
  // 1e-2.
  REQUIRE(worst_error(objective, score, empty, 4, rng) < 1e-10);
  swap_at_random(objective, 1000, rng);
  REQUIRE(worst_error(objective, score, empty, 4, rng) < 1e-9);
  // Growing and shrinking as well.
  for (int k = 0; k < 10; ++k) objective.add(random_outside(objective, rng));
  for (int k = 0; k < 5; ++k) objective.remove(objective.selected()[rng.below(objective.selected().size())]);
  REQUIRE(worst_error(objective, score, empty, 4, rng) < 1e-9);
}

TEST_CASE("covariance objective: bulk gains follow a growing set", "[prioritization][graph]") {
  Rng rng(3);
  testing::RandomGraphOptions shape;
  shape.nodes = 60;
  shape.closures = 3;
  const PoseGraph graph = testing::random_graph(rng, shape).graph;
  const auto candidates = random_candidates(graph, 150, rng);
  for (const BlockStorage storage : {BlockStorage::kColumns, BlockStorage::kDense}) {
    ClosureModelOptions options;
    options.storage = storage;
    CovarianceObjective one(graph, candidates, options);
    options.threads = 2;
    CovarianceObjective two(graph, candidates, options);
    for (int k = 0; k < 40; ++k) {
      const std::vector<double> changes = one.add_changes();
      REQUIRE(two.add_changes() == changes);  // bit for bit
      for (const std::size_t i : {std::size_t{7}, static_cast<std::size_t>(rng.below(150))}) {
        // Measured: 2e-12.
        if (one.contains(i)) {
          REQUIRE(changes[i] == 0.0);
        } else {
          REQUIRE(changes[i] == Approx(one.add_change(i)).epsilon(1e-6));
        }
      }
      const std::size_t best =
          static_cast<std::size_t>(std::min_element(changes.begin(), changes.end()) - changes.begin());
      one.add(best);
      two.add(best);
    }
    REQUIRE(one.value() == Approx(brute_force(graph, candidates, one.selected(), options)).epsilon(1e-10));
  }
}

TEST_CASE("log-determinant objective: equals adding and refactorising", "[prioritization][graph]") {
  const std::uint64_t seed = GENERATE(range(1, 21));
  CAPTURE(seed);
  Rng rng(seed);
  testing::RandomGraphOptions shape;
  shape.nodes = 20 + 2 * seed;
  shape.closures = seed % 3 == 0 ? 0 : seed;
  const PoseGraph graph = testing::random_graph(rng, shape).graph;
  const auto candidates = random_candidates(graph, 40, rng);
  LogDetObjective objective(graph, candidates);
  const Matrix6d covariance = closure_model({}).covariance;
  const auto score = [&](const std::vector<std::size_t>& set) {
    return -HessianFactor(testing::with_closures(graph, candidates, set, covariance)).log_determinant();
  };
  objective.assign(random_set(candidates.size(), 15, rng));
  // Measured: 4e-15 of a value of some -2000.
  REQUIRE(worst_error(objective, score, score({}), 4, rng) < 1e-12);
  swap_at_random(objective, 300, rng);
  REQUIRE(worst_error(objective, score, score({}), 4, rng) < 1e-12);

  // Submodularity: a gain never grows with the set. Lazy greedy choice depends on this.
  const std::vector<double> before = objective.add_changes();
  objective.add(random_outside(objective, rng));
  const std::vector<double> after = objective.add_changes();
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (objective.contains(i)) continue;
    REQUIRE(-after[i] <= -before[i] + 1e-9);
    REQUIRE(after[i] == Approx(objective.add_change(i)).epsilon(1e-9));
  }
}

TEST_CASE("covariance objective: a factor scales information, and gains to first order",
          "[prioritization][graph]") {
  Rng rng(5);
  const PoseGraph graph = testing::random_graph(rng).graph;
  const auto candidates = random_candidates(graph, 20, rng);
  ClosureModelOptions options;
  options.sigma_m = options.sigma_rad = 100.0;  // gains small enough for the first order
  ClosureModel model = closure_model(options);
  CovarianceObjective certain(graph, candidates, options, model);
  model.information_factors.assign(candidates.size(), 0.25);
  model.information_factors[3] = 0.0;
  CovarianceObjective doubtful(graph, candidates, options, model);
  REQUIRE(doubtful.add_change(3) == 0.0);
  REQUIRE(doubtful.add_change(4) == Approx(0.25 * certain.add_change(4)).epsilon(1e-4));
  doubtful.add(3);
  doubtful.add(4);
  REQUIRE(doubtful.swap_change(3, 5) == Approx(doubtful.add_change(5)));
  REQUIRE(doubtful.remove_change(3) == 0.0);
}

TEST_CASE(
    "covariance objective: components without a prior count separately, as do candidates that connect them",
    "[prioritization][graph]") {
  // Two chains; the first has a prior, the second floats. A third node floats alone.
  PoseGraph graph;
  Rng rng(2);
  for (Key key = 0; key < 21; ++key) {
    Node node;
    node.key = key;
    node.pose = testing::random_pose(rng, 3.0);
    graph.add_node(node);
    if (key == 0 || key == 10 || key == 20) continue;
    Edge edge;
    edge.from = key - 1;
    edge.to = key;
    edge.kind = EdgeKind::kOdometry;
    edge.T_from_to = graph.node(key - 1).pose.inverse() * node.pose;
    edge.information = 100.0 * Matrix6d::Identity();
    graph.add_edge(edge);
  }
  graph.add_prior(testing::prior_at(0, graph.node(0).pose));
  const std::vector<LoopCandidate> candidates{
      testing::candidate_of(0, 8, 1), testing::candidate_of(1, 18, 11), testing::candidate_of(2, 15, 5),
      testing::candidate_of(3, 20, 3)};
  CovarianceObjective objective(graph, candidates);
  REQUIRE_FALSE(objective.connecting(0));
  REQUIRE_FALSE(objective.connecting(1));
  REQUIRE(objective.connecting(2));
  REQUIRE(objective.connecting(3));
  const double empty = objective.value();
  REQUIRE(empty == Approx(marginals(graph).trace_translation).epsilon(1e-11));
  REQUIRE(objective.add_change(0) < 0.0);
  REQUIRE(objective.add_change(1) < 0.0);
  REQUIRE(objective.add_change(2) == 0.0);
  objective.assign({2, 3});
  REQUIRE(objective.value() == empty);
  objective.swap(2, 1);
  REQUIRE(objective.value() == Approx(brute_force(graph, candidates, {1})).epsilon(1e-11));
  objective.remove(1);
  REQUIRE(objective.value() == Approx(empty).epsilon(1e-11));
  REQUIRE(sketched_gains(graph, candidates, {}, closure_model({}))[2] == 0.0);

  // With a prior in the second part the two are tied through the world, and 2 is as any other.
  graph.add_prior(testing::prior_at(10, graph.node(10).pose));
  CovarianceObjective tied(graph, candidates);
  REQUIRE_FALSE(tied.connecting(2));
  REQUIRE(tied.connecting(3));
  REQUIRE(tied.value() + tied.add_change(2) == Approx(brute_force(graph, candidates, {2})).epsilon(1e-10));
}

TEST_CASE("sketched gains: near the exact ones, better with more probes", "[prioritization][graph]") {
  Rng rng(8);
  testing::RandomGraphOptions shape;
  shape.nodes = 200;
  shape.closures = 5;
  const PoseGraph graph = testing::random_graph(rng, shape).graph;
  const auto candidates = random_candidates(graph, 300, rng);
  CovarianceObjective objective(graph, candidates);
  const std::vector<double> exact = objective.add_changes();
  const auto errors = [&](std::size_t probes) {
    const auto gains = sketched_gains(graph, candidates, {}, closure_model({}), probes, 3);
    double squares = 0.0;
    for (std::size_t i = 0; i < gains.size(); ++i) {
      const double relative = gains[i] / -exact[i] - 1.0;
      squares += relative * relative;
    }
    return std::sqrt(squares / static_cast<double>(gains.size()));
  };
  // The estimate of one entry is off by √(2/k): 0.18 for 64 probes, 0.044 for 1024.
  const double rough = errors(64), fine = errors(1024);
  CAPTURE(rough, fine);
  REQUIRE(rough < 0.25);
  REQUIRE(fine < 0.07);
  ClosureModelOptions threads;
  threads.threads = 2;
  REQUIRE(sketched_gains(graph, candidates, threads, closure_model({}), 64, 3) ==
          sketched_gains(graph, candidates, {}, closure_model({}), 64, 3));
}

TEST_CASE("shortlist: the best of each pair of places first", "[prioritization][graph]") {
  PoseGraph graph;
  for (Key key = 0; key < 40; ++key) {
    Node node;
    node.key = key;
    node.pose.translation().x() = 2.0 * static_cast<double>(key) + 0.5;
    graph.add_node(node);
  }
  // Three candidates join the cells around 0 and 70 m, one joins 20 and 50 m, one joins 30 and 60 m.
  const std::vector<LoopCandidate> candidates{
      testing::candidate_of(0, 36, 1), testing::candidate_of(1, 37, 2), testing::candidate_of(2, 38, 3),
      testing::candidate_of(3, 26, 11), testing::candidate_of(4, 31, 16)};
  const std::vector<double> gains{9.0, 10.0, 8.0, 1.0, 2.0};
  REQUIRE(spread_shortlist(graph, candidates, gains, 2) == std::vector<std::size_t>{1, 4});
  REQUIRE(spread_shortlist(graph, candidates, gains, 3) == std::vector<std::size_t>{1, 3, 4});
  REQUIRE(spread_shortlist(graph, candidates, gains, 4) == std::vector<std::size_t>{0, 1, 3, 4});
  REQUIRE(spread_shortlist(graph, candidates, gains, 9).size() == 5);
  REQUIRE(spread_shortlist(graph, {}, {}, 9).empty());
}

TEST_CASE("shortlist: places as far off as numbers go", "[prioritization][graph][error]") {
  PoseGraph graph;
  for (Key key = 0; key < 4; ++key) {
    Node node;
    node.key = key;
    if (key > 0) node.pose.translation().x() = key == 3 ? -1e300 : 1e300;
    graph.add_node(node);
  }
  const std::vector<LoopCandidate> candidates{testing::candidate_of(0, 1, 1), testing::candidate_of(0, 2, 2),
                                              testing::candidate_of(0, 3, 3)};
  REQUIRE(spread_shortlist(graph, candidates, {10.0, 9.0, 1.0}, 2) == std::vector<std::size_t>{0, 2});
}

TEST_CASE("graph objectives: bad input", "[prioritization][graph][error]") {
  Rng rng(1);
  const PoseGraph graph = testing::random_graph(rng).graph;
  const auto candidates = random_candidates(graph, 5, rng);
  auto unknown = candidates;
  unknown[2].to = 999;
  REQUIRE_THROWS_AS(CovarianceObjective(graph, unknown), UnknownKeyError);
  auto self = candidates;
  self[2].to = self[2].from;
  REQUIRE_THROWS_AS(CovarianceObjective(graph, self), InputError);
  ClosureModelOptions options;
  options.sigma_m = 0.0;
  REQUIRE_THROWS_WITH(CovarianceObjective(graph, candidates, options), "sigma_m = 0, must be > 0");
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity(), -1.0}) {
    ClosureModel model = closure_model({});
    model.covariance(3, 3) = bad;
    REQUIRE_THROWS_AS(CovarianceObjective(graph, candidates, {}, model), InputError);
    REQUIRE_THROWS_AS(LogDetObjective(graph, candidates, {}, model), InputError);
    REQUIRE_THROWS_AS(sketched_gains(graph, candidates, {}, model), InputError);
  }
  ClosureModel model = closure_model({});
  model.information_factors = {1.0, 2.0};
  REQUIRE_THROWS_AS(CovarianceObjective(graph, candidates, {}, model), InputError);
  CovarianceObjective objective(graph, candidates);
  REQUIRE_THROWS_AS(objective.assign({1, 1}), InputError);
  REQUIRE_THROWS_AS(objective.assign({5}), InputError);
  // No candidates at all.
  CovarianceObjective none(graph, {});
  REQUIRE(none.add_changes().empty());
  REQUIRE(none.value() == Approx(brute_force(graph, {}, {})));
  // Factors that leave a direction free.
  PoseGraph loose;
  Node node;
  loose.add_node(node);
  node.key = 1;
  loose.add_node(node);
  Edge edge;
  edge.to = 1;
  edge.information(5, 5) = 0.0;
  loose.add_edge(edge);
  REQUIRE_THROWS_WITH(CovarianceObjective(loose, {}), Contains("node 1"));
}

TEST_CASE("covariance objective: odometry alone over two long paths", "[prioritization][graph][data]") {
  const auto folder = testing::test_data("g2o");
  if (!folder) return;
  const PoseGraph graph = testing::odometry_only(testing::read_graph(*folder / "tunnel1250.g2o", {0, 625}));
  Rng rng(11);
  const auto candidates = random_candidates(graph, 500, rng);
  CovarianceObjective objective(graph, candidates);
  const auto score = [&](const std::vector<std::size_t>& set) { return brute_force(graph, candidates, set); };
  const double empty = score({});
  REQUIRE(objective.value() == Approx(empty).epsilon(1e-9));
  objective.assign(random_set(candidates.size(), 250, rng));
  const double fresh = worst_error(objective, score, empty, 3, rng);
  swap_at_random(objective, 1000, rng);
  const double after = worst_error(objective, score, empty, 6, rng);
  std::cerr << "tunnel1250: e(PG) / e(PG ∪ l) = " << empty / objective.value() << ", error fresh " << fresh
            << ", after 1000 swaps " << after << "\n";
  REQUIRE(fresh < 1e-9);
  REQUIRE(after < 1e-9);
}

}  // namespace loopwise::covariance_objective_test
