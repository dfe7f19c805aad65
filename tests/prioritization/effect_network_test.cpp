// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/effect_network.hpp>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/prioritization/gnn.hpp>

#include "graphs.hpp"
#include "testing.hpp"

namespace loopwise::effect_network_test {
namespace {

using Json = nlohmann::json;
using testing::TemporaryFolder;

Json tensor(const std::vector<std::size_t>& shape, Rng& rng, double scale, double shift = 0.0) {
  std::size_t size = 1;
  for (const std::size_t s : shape) size *= s;
  std::vector<double> data(size);
  for (double& value : data) value = shift + scale * rng.normal();
  return {{"shape", shape}, {"data", data}};
}

Json random_weights(Rng& rng, std::size_t M = 5, std::size_t K = 3, std::size_t H = 6) {
  Json json;
  json["__meta__"] = {{"kind", "loopwise"}};
  json["edge.mean"] = tensor({9}, rng, 0.1);
  json["edge.std"] = tensor({9}, rng, 0.1, 1.0);
  json["unit.mean"] = tensor({5}, rng, 0.1);
  json["unit.std"] = tensor({5}, rng, 0.1, 1.0);
  json["message.0.weight"] = tensor({M, 9}, rng, 0.5);
  json["message.0.bias"] = tensor({M}, rng, 0.5);
  json["message.1.weight"] = tensor({K, M}, rng, 0.5);
  json["message.1.bias"] = tensor({K}, rng, 0.5);
  json["message.skip.weight"] = tensor({K, 9}, rng, 0.5);
  json["readout.0.weight"] = tensor({H, 3 * (K + 2) + 5}, rng, 0.3);
  json["readout.0.bias"] = tensor({H}, rng, 0.3);
  json["readout.1.weight"] = tensor({H, H}, rng, 0.3);
  json["readout.1.bias"] = tensor({H}, rng, 0.3);
  json["readout.2.weight"] = tensor({2, H}, rng, 0.3);
  json["readout.2.bias"] = tensor({2}, rng, 0.3);
  return json;
}

std::shared_ptr<const EffectNetwork> load(const Json& json) {
  const TemporaryFolder folder;
  testing::write_text(folder / "weights.json", json.dump());
  return std::make_shared<const EffectNetwork>(folder / "weights.json");
}

struct Instance {
  PoseGraph graph;
  std::vector<LoopCandidate> candidates;
};

Instance problem(Rng& rng, std::size_t nodes = 60, std::size_t candidates = 40) {
  testing::RandomGraphOptions shape;
  shape.nodes = nodes;
  shape.closures = 4;
  Instance p;
  p.graph = testing::random_graph(rng, shape).graph;
  p.candidates = testing::random_candidates(p.graph, candidates, rng);
  return p;
}

}  // namespace

TEST_CASE("effects: the effect of one closure is exact", "[prioritization][effects]") {
  Rng rng(3);
  const Instance p = problem(rng);
  const ClosureModelOptions options;
  const ClosureModel model = closure_model(options);
  const ClosureEffects effects = closure_effects(p.graph, p.candidates, options, model, 16);
  REQUIRE(effects.anchors.size() >= 8);
  REQUIRE(effects.anchors.size() <= 16);
  REQUIRE(effects.share.sum() == Approx(1.0).epsilon(1e-12));
  REQUIRE(effects.trace_m2 == Approx(marginals(p.graph).trace_translation).epsilon(1e-10));
  CovarianceObjective exact(p.graph, p.candidates);
  double worst = 0.0, worst_gain = 0.0;
  for (std::size_t c = 0; c < p.candidates.size(); ++c) {
    const Marginals after = marginals(testing::with_closures(p.graph, p.candidates, {c}, model.covariance));
    const Eigen::VectorXd expected = unit_log_reductions(effects, p.graph, after.covariances);
    const Eigen::VectorXd log_reduction =
        effects.log_reduction.col(static_cast<Eigen::Index>(c)).cast<double>();
    worst = std::max(
        worst, (log_reduction - expected.cwiseMin(ClosureEffects::kMaxLogReduction)).cwiseAbs().maxCoeff());
    worst_gain = std::max(worst_gain, std::abs(effects.gain[static_cast<Eigen::Index>(c)] * effects.trace_m2 +
                                               exact.add_change(c)));
  }
  // Measured: 4e-8, single precision.
  REQUIRE(worst < 1e-5);
  REQUIRE(worst_gain < 1e-8 * effects.trace_m2);
}

TEST_CASE("effects: do not depend on the world frame or the threads", "[prioritization][effects][property]") {
  Rng rng(8);
  const Instance p = problem(rng);
  const auto network = load(random_weights(rng));
  const ClosureModelOptions options;
  const ClosureModel model = closure_model(options);
  const ClosureEffects effects = closure_effects(p.graph, p.candidates, options, model);
  const double value = network->evaluate(effects, {1, 5, 9});

  const Eigen::Isometry3d T = testing::random_pose(rng, 50.0);
  PoseGraph moved;
  for (Node node : p.graph.nodes()) {
    node.pose = T * node.pose;
    moved.add_node(node);
  }
  for (PriorFactor prior : p.graph.priors()) {
    prior.pose = T * prior.pose;
    moved.add_prior(prior);
  }
  for (const Edge& edge : p.graph.edges()) moved.add_edge(edge);
  const ClosureEffects there = closure_effects(moved, p.candidates, options, model);
  // Measured: equal in ten digits.
  REQUIRE(network->evaluate(there, {1, 5, 9}) == Approx(value).epsilon(1e-5));

  ClosureModelOptions threaded = options;
  threaded.threads = 4;
  const ClosureEffects again = closure_effects(p.graph, p.candidates, threaded, model);
  REQUIRE(again.log_reduction == effects.log_reduction);
  REQUIRE(again.gain == effects.gain);
}

TEST_CASE("effect network: a change of the set equals the whole", "[prioritization][effects]") {
  Rng rng(4);
  const auto network = load(random_weights(rng));
  const Instance p = problem(rng);
  const ClosureModelOptions options;
  EffectObjective objective(p.graph, p.candidates, network, options, closure_model(options));
  REQUIRE(objective.value() == Approx(objective.effects().trace_m2).epsilon(1e-12));
  objective.assign({0, 5, 7, 9, 20, 33});
  double worst = 0.0;
  for (int k = 0; k < 120; ++k) {
    const std::size_t out = objective.selected()[rng.below(objective.selected().size())];
    std::size_t in = rng.below(objective.size());
    while (objective.contains(in)) in = rng.below(objective.size());
    const double before = objective.value();
    double change = 0.0;
    switch (k % 3) {
      case 0:
        change = objective.swap_change(out, in);
        objective.swap(out, in);
        break;
      case 1:
        change = objective.add_change(in);
        objective.add(in);
        break;
      default:
        change = objective.remove_change(out);
        objective.remove(out);
    }
    const double whole = network->evaluate(objective.effects(), objective.selected());
    worst = std::max({worst, std::abs(objective.value() - before - change) / before,
                      std::abs(objective.value() - whole) / before});
  }
  // Measured: below 1e-10. Subtracting alone loses a small rest of a sum beside one message of e^54.
  REQUIRE(worst < 1e-9);
}

TEST_CASE("effect network: weights that cannot be used are refused by name",
          "[prioritization][effects][error]") {
  Rng rng(1);
  const Json good = random_weights(rng);
  const auto why = [&](const std::function<void(Json&)>& spoil) {
    Json json = good;
    spoil(json);
    try {
      (void)load(json);
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  REQUIRE(why([](Json&) {}) == "accepted");
  REQUIRE_THAT(why([](Json& j) { j.erase("edge.std"); }), Contains("edge.std: missing"));
  REQUIRE_THAT(why([](Json& j) { j["unit.std"]["data"][0] = 0.0; }),
               Contains("unit.std: a value is not positive"));
  REQUIRE_THAT(why([](Json& j) {
                 j["readout.0.weight"]["shape"] = {15, 6};
               }),
               Contains("readout.0.weight: shape"));
  REQUIRE_THAT(why([](Json& j) { j["__meta__"]["kind"] = "paper"; }), Contains("of kind paper"));
  REQUIRE_THAT(why([](Json& j) { j["__meta__"]["kind"] = 3; }), Contains("__meta__.kind"));

  const TemporaryFolder folder;
  testing::write_text(folder / "loopwise.json", good.dump());
  REQUIRE(network_kind(folder / "loopwise.json") == "loopwise");
  REQUIRE_THROWS_WITH(GraphNetwork(folder / "loopwise.json"), Contains("of kind loopwise, expected paper"));
  testing::write_text(folder / "other.json", R"({"__meta__": {"kind": "other"}})");
  REQUIRE_THROWS_WITH(network_kind(folder / "other.json"), Contains("of kind other"));

  const Instance p = problem(rng, 20, 5);
  const ClosureModelOptions options;
  const ClosureEffects effects = closure_effects(p.graph, p.candidates, options, closure_model(options));
  REQUIRE_THROWS_AS(load(good)->evaluate(effects, {5}), InputError);
  REQUIRE_THROWS_AS(EffectObjective(effects, nullptr), InputError);
  REQUIRE_THROWS_AS(closure_effects(p.graph, p.candidates, options, closure_model(options), 0), OptionError);
  // A graph without nodes and one without candidates are no errors.
  REQUIRE(EffectObjective({}, {}, load(good), options, closure_model(options)).value() == 0.0);
  EffectObjective bare(p.graph, {}, load(good), options, closure_model(options));
  REQUIRE(bare.value() == Approx(effects.trace_m2));
}

}  // namespace loopwise::effect_network_test
