// SPDX-License-Identifier: BSD-3-Clause
#include "graph_hessian.hpp"

#include "support.hpp"

namespace loopwise::graph_hessian_test {

TEST_CASE("graph Hessian: equals the dense one by differences, over the nodes that are not held",
          "[optimization][property]") {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    CAPTURE(seed);
    Rng rng(seed);
    testing::RandomGraphOptions shape;
    shape.nodes = 25;
    shape.closures = 12;
    shape.prior = seed != 2;
    testing::RandomGraph random = testing::random_graph(rng, shape);
    PoseGraph& graph = random.graph;
    // Two closures of one pair; one of them counts half, another one not at all.
    Edge repeated = graph.edges().back();
    repeated.weight = 0.5;
    graph.add_edge(repeated);
    graph.set_weight(graph.edges().size() - 3, 0.0);
    const detail::GraphHessian hessian(graph);
    REQUIRE(hessian.variable.size() == graph.nodes().size());
    REQUIRE(hessian.nodes.size() == graph.nodes().size() - (seed == 2 ? 1 : 0));

    const auto n = static_cast<Eigen::Index>(hessian.nodes.size());
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(6 * n, 6 * n);
    const auto block = [&](const detail::BlockMatrix::Slot& slot) {
      return Eigen::Map<const Matrix6d>(hessian.blocks.values().data() + slot.offset);
    };
    for (std::size_t v = 0; v < hessian.nodes.size(); ++v) {
      const auto at = 6 * static_cast<Eigen::Index>(v);
      H.block<6, 6>(at, at) += block(hessian.blocks.diagonal_slot(v));
    }
    for (std::size_t k = 0; k < hessian.blocks.pairs().size(); ++k) {
      const auto [a, b] = hessian.blocks.pairs()[k];
      const Eigen::Index row = 6 * Eigen::Index{a}, column = 6 * Eigen::Index{b};
      H.block<6, 6>(row, column) += block(hessian.blocks.pair_slot(k));
      H.block<6, 6>(column, row) += block(hessian.blocks.pair_slot(k)).transpose();
    }
    const Eigen::MatrixXd whole = testing::dense_hessian(graph);
    double worst = 0.0;
    for (std::size_t i = 0; i < hessian.nodes.size(); ++i) {
      for (std::size_t j = 0; j < hessian.nodes.size(); ++j) {
        const auto r = 6 * static_cast<Eigen::Index>(i), c = 6 * static_cast<Eigen::Index>(j);
        const Matrix6d expected =
            whole.block<6, 6>(6 * Eigen::Index{hessian.nodes[i]}, 6 * Eigen::Index{hessian.nodes[j]});
        worst = std::max(worst, (H.block<6, 6>(r, c) - expected).cwiseAbs().maxCoeff());
      }
    }
    // The differences limit the agreement.
    REQUIRE(worst < 1e-7 * whole.cwiseAbs().maxCoeff());
  }
}

}  // namespace loopwise::graph_hessian_test
