// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/effect_network.hpp>
#include <loopwise/prioritization/gnn.hpp>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(weights, bytes) {
  using namespace loopwise;
  const auto file = fuzz::scratch() / "weights.json";
  fuzz::put_file(file, bytes);
  const auto kind = fuzz::attempt([&] { return network_kind(file); });
  // Each reads the file from its beginning: one of another kind seldom.
  const bool both = fuzz::one_in(4, bytes);
  if (both || kind.value_or("") == "loopwise") {
    static_cast<void>(fuzz::attempt([&] {
      const EffectNetwork network(file);
      fuzz::expect(kind.has_value(), "a network has a kind");
      return true;
    }));
  }
  if (!both && kind.value_or("") != "paper") return;
  static_cast<void>(fuzz::attempt([&] {
    const GraphNetwork network(file);
    fuzz::expect(kind.has_value(), "a network has a kind");
    fuzz::expect(network.hidden() > 0 && network.node_features() > 0 && network.edge_features() > 0,
                 "a network has a size");
    if (network.hidden() > 100 || network.node_features() > 100 || network.edge_features() > 100) return true;
    GraphNetwork::Input input;
    input.nodes = Eigen::MatrixXd::Ones(2, network.node_features());
    input.edges = {{0, 1}};
    input.edge_attributes = Eigen::MatrixXd::Ones(1, network.edge_features());
    static_cast<void>(network.evaluate(input));
    return true;
  }));
}
