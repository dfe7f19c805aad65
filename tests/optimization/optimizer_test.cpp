// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/optimizer.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "support.hpp"

namespace loopwise {
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

}  // namespace loopwise
