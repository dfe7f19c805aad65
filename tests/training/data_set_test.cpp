// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/training/data_set.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/training/weights.hpp>

#include "missions.hpp"
#include "testing.hpp"

namespace loopwise::training::data_set_test {
namespace {

using loopwise::testing::read_text;
using loopwise::testing::small_options;
using loopwise::testing::small_record;
using loopwise::testing::TemporaryFolder;
namespace fs = std::filesystem;

std::vector<DataSource> small_sources(std::size_t count) {
  std::vector<DataSource> sources;
  for (std::size_t k = 0; k < count; ++k) {
    DataSource source;
    source.name = "walk/" + std::to_string(k);
    source.group = "walk";
    source.made_with = "seed " + std::to_string(k);
    source.record = [name = source.name, k](const StopToken&) { return small_record(name, k + 1, 34); };
    sources.push_back(std::move(source));
  }
  return sources;
}

}  // namespace

TEST_CASE("data set: files are the same for any number of threads", "[train]") {
  const TemporaryFolder one, two;
  ThreadPool single(1), pair(2);
  const std::vector<DataSource> sources = small_sources(4);
  const DataSetCounts counts = make_data_set(one.path(), sources, small_options(), single);
  static_cast<void>(make_data_set(two.path(), sources, small_options(), pair));
  REQUIRE(counts.missions == 4);
  REQUIRE(counts.kept == 0);
  const DataSet data = read_data_set(one.path());
  REQUIRE(data.entries.size() == 4);
  REQUIRE(data.entries[1].file == "missions/walk_1.cbor");
  std::size_t graphs = 0, sets = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const MissionData of_mission = data.read(i);
    REQUIRE(of_mission.record.name == sources[i].name);
    graphs += of_mission.graphs.size();
    for (const TrainingGraph& graph : of_mission.graphs) sets += graph.sets.size();
    REQUIRE(read_text(one / data.entries[i].file) == read_text(two / data.entries[i].file));
  }
  REQUIRE(counts.graphs == graphs);
  REQUIRE(counts.sets == sets);
}

TEST_CASE("data set: finished missions are kept, those of other input are made again", "[train]") {
  const TemporaryFolder folder;
  ThreadPool pool(2);
  const std::vector<DataSource> sources = small_sources(4);
  static_cast<void>(
      make_data_set(folder.path(), {sources.begin(), sources.begin() + 3}, small_options(), pool));
  const DataSetCounts more = make_data_set(folder.path(), sources, small_options(), pool);
  REQUIRE(more.missions == 4);
  REQUIRE(more.kept == 3);
  DataOptions other = small_options();
  other.random_sets += 1;
  REQUIRE(make_data_set(folder.path(), sources, other, pool).kept == 0);
}

TEST_CASE("data set: an interrupted set is not complete", "[train]") {
  const TemporaryFolder folder;
  ThreadPool pool(1);
  std::vector<DataSource> sources = small_sources(3);
  static_cast<void>(make_data_set(folder.path(), sources, small_options(), pool));
  StopSource stop;
  sources[0].made_with = "changed";
  sources[1].record = [&](const StopToken&) -> MissionRecord {
    stop.request_stop();
    throw StoppedError("interrupted");
  };
  sources[1].made_with = "changed";
  REQUIRE_THROWS_AS(make_data_set(folder.path(), sources, small_options(), pool, stop.token()), Error);
  REQUIRE_THROWS_AS(read_data_set(folder.path()), InputError);
}

TEST_CASE("data set: names must differ, and every role needs a mission", "[train]") {
  std::vector<DataSource> sources = small_sources(3);
  REQUIRE(data_set_entries(sources).size() == 3);
  sources[2].name = "walk:0";  // the same file name as walk/0
  REQUIRE_THROWS_WITH(data_set_entries(sources), "two missions are named walk:0");
  REQUIRE_THROWS_AS(data_set_entries(small_sources(2)), InputError);
}

TEST_CASE("data set: a recorded mission is in the group of its world", "[train]") {
  const MissionRecord record = small_record("walk", 2, 34);
  Mission mission;
  mission.name = "walk";
  mission.robots = record.robots;
  mission.graph = record.graph;
  REQUIRE(data_source(mission, false).group == "recorded");
  mission.provenance_json = R"({"options": {"world": "mine"}})";
  const DataSource source = data_source(mission, true);
  REQUIRE(source.group == "mine");
  REQUIRE(source.other_size);
  REQUIRE(source.record({}).graph.edges().size() == record.graph.edges().size());
  REQUIRE(source.made_with != data_source(mission, false).made_with);
}

TEST_CASE("weights: the missions of a network are in its file", "[train]") {
  const TemporaryFolder folder;
  write_weights(folder / "weights.json", NetworkKind::kLoopwise, {},
                R"({"missions": {"train": ["a", "b"], "validation": ["c", 5]}})");
  REQUIRE(missions_of_weights(folder / "weights.json") == std::set<std::string>{"a", "b", "c"});
  write_weights(folder / "bare.json", NetworkKind::kLoopwise, {}, "{}");
  REQUIRE(missions_of_weights(folder / "bare.json").empty());
  loopwise::testing::write_text(folder / "list.json", "[]");
  REQUIRE(missions_of_weights(folder / "list.json").empty());
  REQUIRE_THROWS_AS(missions_of_weights(folder / "absent.json"), IoError);
}

}  // namespace loopwise::training::data_set_test
