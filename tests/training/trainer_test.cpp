// SPDX-License-Identifier: BSD-3-Clause
#include "trainer.hpp"

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/prioritization/effect_network.hpp>

#include "missions.hpp"
#include "testing.hpp"

namespace loopwise::training::trainer_test {
namespace {

using loopwise::testing::small_data;
using loopwise::testing::TemporaryFolder;

FitOptions small_fit(NetworkKind kind) {
  FitOptions options;
  options.network = kind;
  options.epochs = 4;
  options.hidden = kind == NetworkKind::kPaper ? 8 : 0;
  return options;
}

struct Parts {
  std::vector<MissionData> training, validation;
};
const Parts& parts() {
  static const Parts all = [] {
    std::vector<MissionData> data = small_data(4);
    Parts out;
    out.validation.push_back(data.back());
    data.pop_back();
    out.training = std::move(data);
    return out;
  }();
  return all;
}

std::string weights_text(const Trainer& trainer, NetworkKind kind) {
  const TemporaryFolder folder;
  write_weights(folder / "weights.json", kind, trainer.weights(), "{}");
  return read_file(folder / "weights.json");
}

}  // namespace

TEST_CASE("trainer: libtorch and Eigen put out the same", "[train]") {
  for (const NetworkKind kind : {NetworkKind::kLoopwise, NetworkKind::kPaper}) {
    for (const Target target : {Target::kLog, Target::kTrace}) {
      if (kind == NetworkKind::kLoopwise && target == Target::kTrace) continue;
      FitOptions options = small_fit(kind);
      options.target = target;
      Trainer trainer(parts().training, parts().validation, options);
      REQUIRE(trainer.run_epoch());
      const TemporaryFolder folder;
      write_weights(folder / "weights.json", kind, trainer.weights(), R"({"note": "test"})");
      double worst = 0.0;
      for (const TrainingGraph& graph : parts().validation.front().graphs) {
        for (const TrainingSet& set : graph.sets) {
          const double torch = torch_evaluate(kind, trainer.weights(), graph, set.members);
          double eigen = 0.0;
          if (kind == NetworkKind::kLoopwise) {
            const EffectNetwork network(folder / "weights.json");
            eigen = network.evaluate(graph.effects, {set.members.begin(), set.members.end()});
          } else {
            const GraphNetwork network(folder / "weights.json");
            GraphNetwork::Input input = graph.input;
            const Eigen::Index before = input.edge_attributes.rows();
            input.edge_attributes.conservativeResize(before + static_cast<Eigen::Index>(set.members.size()),
                                                     4);
            for (std::size_t k = 0; k < set.members.size(); ++k) {
              input.edges.push_back(graph.ends[set.members[k]]);
              input.edge_attributes.row(before + static_cast<Eigen::Index>(k)) << 0, 0, 1, 0;
            }
            eigen = network.evaluate(input);
          }
          worst = std::max(worst, std::abs(torch - eigen) / std::max(1e-3, std::abs(eigen)));
        }
      }
      CAPTURE(enum_name(kind), enum_name(target));
      // Measured: 1.6e-9, from the nine digits of the file.
      REQUIRE(worst < 1e-5);
    }
  }
}

TEST_CASE("trainer: gradients are those of the loss", "[train]") {
  for (const NetworkKind kind : {NetworkKind::kLoopwise, NetworkKind::kPaper}) {
    Trainer trainer(parts().training, parts().validation, small_fit(kind));
    CAPTURE(enum_name(kind));
    REQUIRE(trainer.gradient_error(60, 5) < 1e-6);  // measured: 7e-10
  }
}

TEST_CASE("trainer: it learns, and starts from its seed", "[train]") {
  for (const NetworkKind kind : {NetworkKind::kLoopwise, NetworkKind::kPaper}) {
    FitOptions options = small_fit(kind);
    options.epochs = 12;
    options.patience = 12;
    Trainer trainer(parts().training, parts().validation, options);
    while (!trainer.done()) REQUIRE(trainer.run_epoch());
    CAPTURE(enum_name(kind));
    REQUIRE(trainer.history().back().training_loss < 0.7 * trainer.history().front().training_loss);

    FitOptions other = small_fit(kind);
    const std::string first = weights_text(Trainer(parts().training, parts().validation, other), kind);
    REQUIRE(weights_text(Trainer(parts().training, parts().validation, other), kind) == first);
    other.seed = 2;
    REQUIRE(weights_text(Trainer(parts().training, parts().validation, other), kind) != first);
  }
}

TEST_CASE("trainer: interrupted and resumed is uninterrupted, byte for byte", "[train][property]") {
  const TemporaryFolder folder;
  for (const NetworkKind kind : {NetworkKind::kLoopwise, NetworkKind::kPaper}) {
    const FitOptions options = small_fit(kind);
    Trainer whole(parts().training, parts().validation, options);
    while (!whole.done()) REQUIRE(whole.run_epoch());

    const auto checkpoint = folder / (enum_name(kind) + ".cbor");
    {
      Trainer first(parts().training, parts().validation, options);
      REQUIRE(first.run_epoch());
      REQUIRE(first.run_epoch());
      first.save(checkpoint);
      StopSource stop;
      stop.request_stop();
      REQUIRE_FALSE(first.run_epoch(stop.token()));
    }
    Trainer second(parts().training, parts().validation, options);
    second.load(checkpoint);
    REQUIRE(second.history().size() == 2);
    while (!second.done()) REQUIRE(second.run_epoch());
    REQUIRE(weights_text(second, kind) == weights_text(whole, kind));
    whole.save(folder / "whole.cbor");
    second.save(folder / "second.cbor");
    REQUIRE(read_file(folder / "whole.cbor") == read_file(folder / "second.cbor"));

    FitOptions other = options;
    other.seed = 9;
    REQUIRE_THROWS_WITH(Trainer(parts().training, parts().validation, other).load(checkpoint),
                        Contains("options: trained with"));
    REQUIRE_THROWS_WITH(Trainer(parts().validation, parts().training, options).load(checkpoint),
                        Contains("another data set"));
    const std::string bytes = read_file(checkpoint);
    loopwise::testing::write_text(folder / "cut.cbor", bytes.substr(0, bytes.size() / 2));
    REQUIRE_THROWS_WITH(Trainer(parts().training, parts().validation, options).load(folder / "cut.cbor"),
                        Contains("cut short"));
  }
}

TEST_CASE("trainer: statistics are those of the training missions", "[train]") {
  const Tensors loopwise =
      Trainer(parts().training, parts().validation, small_fit(NetworkKind::kLoopwise)).weights();
  const Tensors paper =
      Trainer(parts().training, parts().validation, small_fit(NetworkKind::kPaper)).weights();
  double log_reduction = 0.0, edges = 0.0, x = 0.0, nodes = 0.0, log_trace = 0.0, sets = 0.0;
  for (const MissionData& mission : parts().training) {
    for (const TrainingGraph& graph : mission.graphs) {
      log_reduction += graph.effects.log_reduction.cast<double>().sum();
      edges += static_cast<double>(graph.effects.log_reduction.size());
      x += graph.input.nodes.col(3).sum();
      nodes += static_cast<double>(graph.input.nodes.rows());
      for (const TrainingSet& set : graph.sets) log_trace += std::log(set.trace_m2);
      sets += static_cast<double>(graph.sets.size());
    }
  }
  REQUIRE(loopwise.at("edge.mean").data[0] == Approx(log_reduction / edges).epsilon(1e-5));
  REQUIRE(loopwise.at("edge.std").data[1] == 1.0F);  // one-hot: as it is
  REQUIRE(paper.at("input.mean").data[3] == Approx(x / nodes).epsilon(1e-5));
  REQUIRE(paper.at("input.mean").data[6] == 0.0F);  // the constant 1
  REQUIRE(paper.at("input.std").data[6] == 1.0F);
  REQUIRE(paper.at("output.mean").data[0] == Approx(log_trace / sets).epsilon(1e-5));
  REQUIRE(paper.at("output.log").data[0] == 1.0F);
}

TEST_CASE("trainer: nothing to train with", "[train][error]") {
  REQUIRE_THROWS_WITH(Trainer({}, parts().validation, {}), Contains("no missions to train with"));
  REQUIRE_THROWS_WITH(Trainer(parts().training, {}, {}), Contains("no missions to validate with"));
  FitOptions options;
  options.learning_rate = -1.0;
  REQUIRE_THROWS_AS(Trainer(parts().training, parts().validation, options), OptionError);
}

}  // namespace loopwise::training::trainer_test
