// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/gnn.hpp>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>

#include "graphs.hpp"
#include "testing.hpp"

namespace loopwise::gnn_test {
namespace {

using Json = nlohmann::json;
using testing::TemporaryFolder;

Json tensor(const std::vector<std::size_t>& shape, Rng& rng, double scale = 0.3, double shift = 0.0) {
  std::size_t size = 1;
  for (const std::size_t s : shape) size *= s;
  std::vector<double> data(size);
  for (double& value : data) value = shift + scale * rng.normal();
  return {{"shape", shape}, {"data", data}};
}

/// A small network of the same form with random weights.
Json random_weights(Rng& rng, std::size_t H = 6, std::size_t K = 3, std::size_t convolutions = 3,
                    std::size_t dense = 2) {
  Json json;
  json["__meta__"] = {{"source", "random"}};
  json["node_encoder.weight"] = tensor({H, 7}, rng, 0.1);
  json["node_encoder.bias"] = tensor({H}, rng);
  for (std::size_t l = 0; l < convolutions; ++l) {
    const std::string name = l == 0 ? "conv1" : "gcs." + std::to_string(l - 1);
    json[name + ".g"] = tensor({H, K * H}, rng);
    json[name + ".mu"] = tensor({K, 4}, rng, 0.5);
    json[name + ".sigma"] = tensor({K, 4}, rng, 0.2, 0.8);
    json[name + ".root"] = tensor({H, H}, rng);
    json[name + ".bias"] = tensor({H}, rng);
  }
  for (std::size_t l = 0; l < dense; ++l) {
    json["lins." + std::to_string(l) + ".weight"] = tensor({H, H}, rng);
    json["lins." + std::to_string(l) + ".bias"] = tensor({H}, rng);
  }
  for (std::size_t l = 1; l <= dense + 1; ++l) {
    const std::string name = "batch_norms." + std::to_string(l);
    json[name + ".weight"] = tensor({H}, rng, 0.1, 1.0);
    json[name + ".bias"] = tensor({H}, rng);
    json[name + ".running_mean"] = tensor({H}, rng);
    json[name + ".running_var"] = tensor({H}, rng, 0.1, 5.0);
  }
  json["lin.weight"] = tensor({1, H}, rng);
  json["lin.bias"] = tensor({1}, rng);
  return json;
}

std::shared_ptr<const GraphNetwork> load(const Json& json) {
  const TemporaryFolder folder;
  testing::write_text(folder / "weights.json", json.dump());
  return std::make_shared<const GraphNetwork>(folder / "weights.json");
}

/// Random swaps, additions and removals against the network run on the whole graph.
double worst_against_full(GnnObjective& objective, const GraphNetwork& network, int rounds, Rng& rng) {
  double worst = std::abs(objective.value() - network.evaluate(objective.input()));
  for (int k = 0; k < rounds; ++k) {
    const std::size_t out = objective.selected()[rng.below(objective.selected().size())];
    std::size_t in = rng.below(objective.size());
    while (objective.contains(in)) in = rng.below(objective.size());
    const double before = objective.value();
    const auto check = [&](double expected) {
      worst = std::max(worst, std::abs(objective.value() - before - expected));
      worst = std::max(worst, std::abs(objective.value() - network.evaluate(objective.input())));
    };
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
    check(change);
  }
  return worst;
}

}  // namespace

TEST_CASE("network: golden outputs", "[prioritization][gnn][data]") {
  const auto folder = testing::test_data("gnn");
  if (!folder) return;
  const GraphNetwork network(*folder / "lamp_gnn.json");
  REQUIRE(network.node_features() == 7);
  REQUIRE(network.convolutions() == 3);
  std::size_t files = 0;
  for (const auto& entry : testing::fs::directory_iterator(*folder / "golden")) {
    if (entry.path().extension() != ".json") continue;
    CAPTURE(entry.path().filename().string());
    const Json json = Json::parse(testing::read_text(entry.path()));
    GraphNetwork::Input input;
    const auto matrix = [](const Json& rows, Eigen::Index columns) {
      Eigen::MatrixXd m(static_cast<Eigen::Index>(rows.size()), columns);
      for (std::size_t r = 0; r < rows.size(); ++r) {
        for (std::size_t c = 0; c < rows[r].size(); ++c) {
          m(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c)) = rows[r][c].get<double>();
        }
      }
      return m;
    };
    input.nodes = matrix(json.at("nodes"), 7);
    input.edge_attributes = matrix(json.at("edge_attr"), 4);
    for (const Json& edge : json.at("edges")) {
      input.edges.emplace_back(edge[0].get<std::uint32_t>(), edge[1].get<std::uint32_t>());
    }
    const double expected = json.at("expected").at("float64").get<double>();
    // Measured: 6e-15 relative and 3e-4 absolute; a kernel left out is off by more than 1e-2.
    REQUIRE(std::abs(network.evaluate(input) - expected) <= 1e-9 * std::abs(expected));
    REQUIRE(std::abs(static_cast<double>(network.evaluate_single(input)) - expected) <= 1e-3);
    ++files;
  }
  REQUIRE(files > 0);
}

TEST_CASE("network: a change of the set costs its neighbourhood and equals the whole",
          "[prioritization][gnn]") {
  Rng rng(4);
  for (const GnnFeatures features : {GnnFeatures::kWorld, GnnFeatures::kLamp}) {
    const auto network = load(random_weights(rng));
    testing::RandomGraphOptions shape;
    shape.nodes = 60;
    const PoseGraph graph = testing::random_graph(rng, shape).graph;
    const auto candidates = testing::random_candidates(graph, 50, rng);
    GnnObjective objective(graph, candidates, network, features, marginals(graph).covariances);
    objective.assign({0, 5, 7, 9, 20, 33});
    // Measured: 2e-16 on values about 1.
    REQUIRE(worst_against_full(objective, *network, 90, rng) < 1e-12);
  }
}

TEST_CASE("network: its input features", "[prioritization][gnn]") {
  Rng rng(6);
  const auto network = load(random_weights(rng));
  PoseGraph graph;
  for (Key key = 0; key < 4; ++key) {
    Node node;
    node.key = key;
    node.pose = testing::random_pose(rng);
    graph.add_node(node);
    if (key > 0) {
      graph.add_edge({key - 1, key, Eigen::Isometry3d::Identity(), Matrix6d::Identity(),
                      key == 3 ? EdgeKind::kLoopClosure : EdgeKind::kOdometry});
    }
  }
  graph.add_edge({0, 2, Eigen::Isometry3d::Identity(), Matrix6d::Identity(), EdgeKind::kLoopClosure, false,
                  0.0});  // false, says the back end
  graph.add_prior(testing::prior_at(0, graph.node(0).pose));
  std::vector<Matrix6d> covariances(4, testing::random_information(rng));
  covariances[3](0, 0) = std::nan("");
  const std::vector<LoopCandidate> candidates{testing::candidate_of(0, 3, 0)};

  GnnObjective world(graph, candidates, network, GnnFeatures::kWorld, covariances);
  world.add(0);
  GraphNetwork::Input input = world.input();
  const Eigen::Matrix3d R = graph.node(1).pose.linear();
  const Eigen::Vector3d variance = (R * covariances[1].topLeftCorner<3, 3>() * R.transpose()).diagonal();
  REQUIRE((input.nodes.row(1).head<3>().transpose() - variance).norm() < 1e-14);
  REQUIRE((input.nodes.row(1).segment<3>(3).transpose() - graph.node(1).pose.translation()).norm() == 0.0);
  REQUIRE(input.nodes(1, 6) == 1.0);
  REQUIRE(input.nodes.row(3).head<3>().norm() == 0.0);
  using Edges = std::vector<std::pair<std::uint32_t, std::uint32_t>>;
  REQUIRE(input.edges == Edges{{0, 0}, {0, 1}, {1, 2}, {2, 3}, {3, 0}});
  const auto slots = [](const GraphNetwork::Input& in) {
    std::vector<int> out;
    for (Eigen::Index e = 0; e < in.edge_attributes.rows(); ++e) {
      Eigen::Index slot = 0;
      in.edge_attributes.row(e).maxCoeff(&slot);
      out.push_back(static_cast<int>(slot));
    }
    return out;
  };
  REQUIRE(slots(input) == std::vector<int>{0, 3, 3, 2, 2});

  GnnObjective lamp(graph, candidates, network, GnnFeatures::kLamp, covariances);
  lamp.add(0);
  input = lamp.input();
  REQUIRE(slots(input) == std::vector<int>{0, 3, 3, 2, 3});
  REQUIRE(input.nodes(1, 0) == static_cast<double>(static_cast<float>(covariances[1](3, 3))));
}

TEST_CASE("network: weights that cannot be used are refused by name", "[prioritization][gnn][error]") {
  Rng rng(1);
  const Json good = random_weights(rng);
  REQUIRE(load(good)->hidden() == 6);
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
  REQUIRE_THAT(why([](Json& j) { j.erase("gcs.0.mu"); }), Contains("gcs.0.mu: missing"));
  REQUIRE_THAT(why([](Json& j) {
                 j["conv1.root"]["shape"] = {3, 12};
               }),
               Contains("conv1.root: shape 3x12, expected 6x6"));
  REQUIRE_THAT(why([](Json& j) { j["lins.1.bias"]["data"].erase(0); }),
               Contains("lins.1.bias: 5 values, expected 6"));
  REQUIRE_THAT(why([](Json& j) { j["lin.weight"]["data"][2] = nullptr; }), Contains("lin.weight"));
  REQUIRE_THAT(why([](Json& j) { j["lin.weight"]["data"] = "many"; }), Contains("lin.weight: expected"));
  REQUIRE_THAT(why([](Json& j) { j["conv1.mu"]["shape"] = {2, -4}; }), Contains("conv1.mu: shape"));
  REQUIRE_THAT(why([](Json& j) { j["batch_norms.1.running_var"]["data"][0] = -1.0; }), Contains("negative"));
  REQUIRE_THAT(why([](Json& j) { j = Json::array(); }), Contains("expected an object"));
  const TemporaryFolder folder;
  testing::write_text(folder / "broken.json", "{\"lin.weight\": {\"data\": [NaN]}");
  REQUIRE_THROWS_AS(GraphNetwork(folder / "broken.json"), InputError);
  Json huge = good;
  std::string text = huge.dump();
  testing::write_text(folder / "huge.json", text.insert(text.find("\"data\":[") + 8, "1e999,"));
  REQUIRE_THROWS_AS(GraphNetwork(folder / "huge.json"), InputError);
  REQUIRE_THROWS_AS(GraphNetwork(folder / "absent.json"), IoError);

  const auto network = load(good);
  REQUIRE_THROWS_AS(GnnObjective({}, {}, nullptr, GnnFeatures::kWorld, {}), InputError);
  REQUIRE_THROWS_AS(GnnObjective({}, {testing::candidate_of(0, 1, 2)}, network, GnnFeatures::kWorld, {}),
                    UnknownKeyError);
  REQUIRE_THROWS_AS(GnnObjective({}, {}, network, GnnFeatures::kWorld, {Matrix6d::Identity()}), InputError);
  GraphNetwork::Input input;
  input.nodes = Eigen::MatrixXd::Zero(2, 5);
  REQUIRE_THROWS_AS(network->evaluate(input), InputError);
  input.nodes = Eigen::MatrixXd::Zero(2, 7);
  input.edges = {{0, 2}};
  input.edge_attributes = Eigen::MatrixXd::Zero(1, 4);
  REQUIRE_THROWS_AS(network->evaluate(input), InputError);
  input.edges = {{0, 1}};
  REQUIRE(std::isfinite(network->evaluate(input)));
  input.edge_attributes = Eigen::MatrixXd::Zero(1, 3);
  REQUIRE_THROWS_AS(network->evaluate(input), InputError);
}

}  // namespace loopwise::gnn_test
