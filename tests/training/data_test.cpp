// SPDX-License-Identifier: BSD-3-Clause
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/training/judge.hpp>

#include "missions.hpp"
#include "packed.hpp"
#include "testing.hpp"

namespace loopwise::training::data_test {
namespace {

using loopwise::testing::small_data;
using loopwise::testing::small_options;
using loopwise::testing::small_record;
using loopwise::testing::TemporaryFolder;

std::vector<DataSetEntry> entries_of(std::size_t worlds, std::size_t each) {
  std::vector<DataSetEntry> out;
  for (std::size_t w = 0; w < worlds; ++w) {
    for (std::size_t k = 0; k < each; ++k) {
      const std::string name = "world" + std::to_string(w) + "-" + std::to_string(k);
      out.push_back({name, "world" + std::to_string(w), name, false});
    }
  }
  return out;
}

}  // namespace

TEST_CASE("data: targets are the exact traces", "[train]") {
  const MissionRecord record = small_record("walk", 3);
  const DataOptions options = small_options();
  const MissionData data = make_mission_data(record, options);
  REQUIRE(data.graphs.size() >= 3);
  for (const TrainingGraph& graph : data.graphs) {
    const StageGraph stage =
        stage_graph(record, stages()[graph.stage], static_cast<std::size_t>(options.candidates),
                    combine_seeds(options.seed, graph.stage));
    REQUIRE(stage.candidates.size() == graph.ends.size());
    CovarianceObjective exact(stage.graph, stage.candidates);
    REQUIRE(graph.sets.front().members.empty());
    double worst = 0.0;
    for (const TrainingSet& set : graph.sets) {
      exact.assign({set.members.begin(), set.members.end()});
      worst = std::max(worst, std::abs(exact.value() / set.trace_m2 - 1.0));
      // The remaining variances of the units add up to the trace, up to the error of a sample of the nodes.
      const double left =
          (graph.effects.share.array() * (-set.log_reduction.cast<double>().array()).exp()).sum() *
          graph.effects.trace_m2;
      REQUIRE(left == Approx(set.trace_m2).epsilon(0.25));
    }
    REQUIRE(worst < 1e-9);  // measured: below 1e-10
  }
}

TEST_CASE("data: earlier stages are parts of later ones; closed candidates are removed", "[train]") {
  const MissionRecord record = small_record("walk", 5, 60);
  const StageGraph part = stage_graph(record, {0.5, 0.0}, 100, 1);
  REQUIRE(part.graph.nodes().size() == 30);
  REQUIRE(part.graph.edges().size() == 29);
  const StageGraph closed = stage_graph(record, {1.0, 0.1}, 100, 1);
  REQUIRE(closed.graph.nodes().size() == 60);
  REQUIRE(closed.graph.edges().size() == 59 + 6);
  std::set<std::pair<Key, Key>> pairs;
  for (const Edge& edge : closed.graph.edges()) pairs.emplace(edge.from, edge.to);
  for (const LoopCandidate& c : closed.candidates) REQUIRE(pairs.count({c.from, c.to}) == 0);
}

TEST_CASE("data: written data are read back", "[train]") {
  const TemporaryFolder folder;
  const MissionData data = small_data(1).front();
  write_mission_data(folder / "a.cbor", data, "these options");
  REQUIRE(has_mission_data(folder / "a.cbor", "these options"));
  REQUIRE_FALSE(has_mission_data(folder / "a.cbor", "others"));
  REQUIRE_FALSE(has_mission_data(folder / "absent.cbor", "these options"));
  const MissionData back = read_mission_data(folder / "a.cbor");
  write_mission_data(folder / "b.cbor", back, "these options");
  REQUIRE(read_file(folder / "a.cbor") == read_file(folder / "b.cbor"));
  REQUIRE(back.graphs.size() == data.graphs.size());
  REQUIRE(back.graphs[0].effects.log_reduction == data.graphs[0].effects.log_reduction);
  REQUIRE(back.graphs[0].input.nodes == data.graphs[0].input.nodes);
  REQUIRE(back.record.graph.keys() == data.record.graph.keys());
}

TEST_CASE("data: the same options give the same bytes", "[train][property]") {
  const TemporaryFolder folder;
  write_mission_data(folder / "a.cbor", small_data(1).front());
  write_mission_data(folder / "b.cbor", small_data(1).front());
  REQUIRE(read_file(folder / "a.cbor") == read_file(folder / "b.cbor"));
}

TEST_CASE("data: bad files are refused by name", "[train][error]") {
  const TemporaryFolder folder;
  const auto file = folder / "mission.cbor";
  write_mission_data(file, small_data(1).front());
  const std::string whole = read_file(file);
  using Packed = nlohmann::json;
  const auto why = [&](const std::function<void(Packed&)>& spoil) {
    Packed all = Packed::from_cbor(whole);
    spoil(all);
    write_packed(file, all);
    try {
      (void)read_mission_data(file);
    } catch (const InputError& error) {
      REQUIRE_THAT(error.what(), Contains(file.string()));
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  REQUIRE(why([](Packed&) {}) == "accepted");
  for (const std::size_t length : {std::size_t{0}, std::size_t{1}, whole.size() / 2, whole.size() - 1}) {
    loopwise::testing::write_text(file, whole.substr(0, length));
    REQUIRE_THROWS_WITH(read_mission_data(file), Contains("cut short"));
  }
  REQUIRE_THAT(why([](Packed& j) { j["version"] = 99; }), Contains("version 99"));
  REQUIRE_THAT(why([](Packed& j) { j["format"] = "photo"; }), Contains("expected a file of format"));
  REQUIRE_THAT(why([](Packed& j) { j.erase("graphs"); }), Contains("graphs is missing"));
  REQUIRE_THAT(why([](Packed& j) { j["graphs"] = Packed::array(); }), Contains("no graphs"));
  const auto with_nan = [](const char* name, auto value) {
    return [=](Packed& j) {
      auto& bytes = j["graphs"][0][name].get_binary();
      std::memcpy(bytes.data(), &value, sizeof value);
    };
  };
  const double not_a_number = std::nan("");
  REQUIRE_THAT(why(with_nan("set_traces_m2", not_a_number)),
               Contains("graphs[0]: set_traces_m2: a value is not finite"));
  REQUIRE_THAT(why(with_nan("relief", std::nanf(""))), Contains("relief: a value is not finite"));
  REQUIRE_THAT(why(with_nan("nodes", not_a_number)), Contains("nodes: a value is not finite"));
  REQUIRE_THAT(why(with_nan("set_traces_m2", -1.0)), Contains("not positive"));
  REQUIRE_THAT(why(with_nan("set_members", std::uint32_t{9999})), Contains("no such candidate"));
  REQUIRE_THAT(why(with_nan("ends", std::uint32_t{9999})), Contains("no such node"));
  REQUIRE_THAT(why([](Packed& j) { j["graphs"][0]["gain"].get_binary().pop_back(); }),
               Contains("gain: cut short"));
  REQUIRE_THAT(why([](Packed& j) { j["graphs"][0]["gain"] = Packed::binary({}); }),
               Contains("0 values, expected"));

  REQUIRE_THAT(why([](Packed& j) { j["graphs"][0]["stage"] = -1.0; }),
               Contains("stage: expected an integer"));
  REQUIRE_THAT(why([](Packed& j) { j["graphs"][0]["stage"] = 99; }), Contains("no such stage"));
  REQUIRE_THAT(why(with_nan("anchor_nodes", std::uint32_t{9999})), Contains("anchor_nodes: no such node"));
  REQUIRE_THAT(why([](Packed& j) { j["graph"]["ends"].get_binary().resize(4); }),
               Contains("ends: cut short"));
  REQUIRE_THAT(why([](Packed& j) { j["robots"] = Packed::array(); }), Contains(file.string()));

  REQUIRE_THROWS_WITH(read_data_set(folder / "nowhere"), Contains("no dataset.json"));
  REQUIRE_THROWS_WITH(read_data_set(folder.path()), Contains("no dataset.json"));
  write_data_set(folder.path(), {}, {});
  REQUIRE_THROWS_WITH(read_data_set(folder.path()), Contains("no missions"));
  for (const char* outside : {"../other.cbor", "/etc/passwd", "missions/../../x", ""}) {
    write_data_set(folder.path(), {{"walk", "walks", outside, false}}, {});
    REQUIRE_THROWS_WITH(read_data_set(folder.path()), Contains("is outside of the data's folder"));
  }
  loopwise::testing::write_text(folder / "dataset.json", "{\"format\": \"loopwise-training-data\", \"ver");
  REQUIRE_THROWS_AS(read_data_set(folder.path()), InputError);

  Mission mission;
  mission.name = "short";
  REQUIRE_THROWS_WITH(record_of(mission, "", false), Contains("mission short has 0 nodes"));
}

TEST_CASE("split: by mission, in every group, for any order", "[train]") {
  std::vector<DataSetEntry> entries = entries_of(4, 8);
  entries.push_back({"big", "world0", "big", true});
  const std::vector<Role> roles = split_by_mission(entries, 7);
  std::map<std::string, Role> by_name;
  std::map<std::string, std::map<Role, int>> counts;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    by_name[entries[i].name] = roles[i];
    if (!entries[i].other_size) ++counts[entries[i].group][roles[i]];
  }
  REQUIRE(by_name.at("big") == Role::kTest);
  for (const auto& [group, roles_of] : counts) {
    REQUIRE(roles_of.at(Role::kTrain) == 5);
    REQUIRE(roles_of.at(Role::kValidation) == 1);
    REQUIRE(roles_of.at(Role::kTest) == 2);
  }
  Rng rng(1);
  rng.shuffle(entries);
  const std::vector<Role> again = split_by_mission(entries, 7);
  for (std::size_t i = 0; i < entries.size(); ++i) REQUIRE(by_name.at(entries[i].name) == again[i]);
  REQUIRE(split_by_mission(entries, 8) != again);

  REQUIRE(split_by_mission(entries_of(1, 3), 1).size() == 3);
  REQUIRE(split_by_mission(entries_of(3, 1), 1).size() == 3);
  REQUIRE_THROWS_WITH(split_by_mission(entries_of(1, 1), 1),
                      Contains("hold 1 mission to train with, 3 are needed"));
  REQUIRE_THROWS_WITH(split_by_mission({}, 1), Contains("hold 0 missions"));
  entries.push_back(entries.front());
  REQUIRE_THROWS_WITH(split_by_mission(entries, 1), Contains("is in the data twice"));
}

TEST_CASE("judge: rank correlation with ties", "[train]") {
  REQUIRE(spearman({1, 2, 3, 4}, {10, 20, 30, 40}) == Approx(1.0));
  REQUIRE(spearman({1, 2, 3, 4}, {4, 3, 2, 1}) == Approx(-1.0));
  REQUIRE(spearman({1, 2, 2, 3}, {1, 2, 3, 4}) == Approx(0.9486832981));  // mean ranks 0 1.5 1.5 3
  REQUIRE(std::isnan(spearman({1, 1, 1}, {1, 2, 3})));
  REQUIRE(std::isnan(spearman({1, 2}, {1, 2})));
}

TEST_CASE("judge: exact ways are below the others", "[train]") {
  JudgeOptions options;
  options.set_sizes = {3};
  options.candidates = 20;
  options.sets = 12;
  options.evaluations = 400;
  options.swaps = 20;
  const std::vector<Judgement> judgements = judge(small_record("walk", 4), {}, options);
  std::map<std::string, double> mean;
  for (const Judgement& j : judgements) {
    REQUIRE(j.chosen > 0.0);
    REQUIRE(j.chosen <= 1.0);
    mean[j.method] += j.chosen;
    if (j.method == "additive") {
      REQUIRE(j.spearman_mixed > 0.5);
      REQUIRE(std::isnan(j.log_error));
      REQUIRE(j.signs > 0.4);
    }
  }
  REQUIRE(mean.at("exact annealing") <= mean.at("random"));
  REQUIRE(mean.at("exact greedy") <= mean.at("separated"));
  const JudgementTables tables = summarize(judgements);
  REQUIRE_THAT(tables.markdown, Contains("exact annealing"));
  REQUIRE(parse_json(tables.json, "tables").size() == 5);
}

}  // namespace loopwise::training::data_test
