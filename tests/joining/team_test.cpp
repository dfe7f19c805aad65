// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Whole missions whose robots or sessions have lost their common frame.
#include <loopwise/replay/read_team.hpp>

#include <loopwise/core/error.hpp>
#ifdef LOOPWISE_HAS_SIMULATION
#include <loopwise/simulation/simulate.hpp>
#endif

#include "scrambled.hpp"
#include "testing.hpp"

namespace loopwise::team_test {
namespace {

using testing::fs::path;

TeamFrames found(const Mission& mission, int threads = 2) {
  ThreadPool pool(threads);
  return find_team_frames(mission, Config{}, pool);
}

#ifdef LOOPWISE_HAS_SIMULATION
Mission simulated(WorldKind world, std::uint64_t seed, int robots) {
  SimulationOptions options;
  options.world = world;
  options.length_m = 150.0 * robots;
  options.robots = robots;
  options.radio = false;
  return simulate(options, seed).mission;
}
#endif

/// Sessions of the shared data, or nothing.
std::optional<std::vector<path>> sessions(const std::vector<std::string>& names) {
  std::vector<path> paths;
  for (const std::string& name : names) {
    const auto at = testing::test_data(name);
    if (!at) return std::nullopt;
    paths.push_back(*at);
  }
  return paths;
}

}  // namespace

#ifdef LOOPWISE_HAS_SIMULATION
TEST_CASE("team: robots of a simulated mission that start anywhere", "[joining][team]") {
  const auto world = GENERATE(WorldKind::kFinals, WorldKind::kMine);
  CAPTURE(enum_name(world));
  const testing::ScrambledMission made = testing::scrambled(simulated(world, 3, 2), 5);
  const TeamFrames frames = found(made.mission);
  CAPTURE(to_string(frames.result, frames.components), frames.result.ties[0].reason);
  REQUIRE(frames.result.groups == 1);
  const testing::FrameError error = testing::frame_error(made, 0, 1, frames.result.frames[1].pose);
  // The frame is that of the robot's first pose: the drift of both robots up to the shared places is in it,
  // 0.1 rad in finals.
  CHECK(error.translation_m < 1.5);
  CHECK(error.rotation_rad < 0.15);

  const Mission placed = placed_team(made.mission, frames);
  CHECK(placed.graph.nodes().size() == made.mission.graph.nodes().size());
  CHECK(placed.graph.edges().size() ==
        made.mission.graph.edges().size() + frames.result.ties[0].closures.size());
  CHECK(placed.graph.priors().size() == 2);
  CHECK(placed.problems.count("no prior given") == 0);
}

TEST_CASE("team: places with nothing in common stay apart, and the error says why", "[joining][team]") {
  const testing::TemporaryFolder folder;
  write_mission(folder / "one", simulated(WorldKind::kTunnel, 3, 1));
  write_mission(folder / "two", simulated(WorldKind::kUrban, 4, 1));
  ThreadPool pool(2);
  Config config;
  config.mission.frames = "auto";
  config.joining.max_pairs = 300;
  CHECK_THROWS_WITH(read_team({folder / "one", folder / "two"}, config, false, pool),
                    Contains("0 of 2 joined; tunnel-3 is not joined: ") &&
                        Contains("pairs computed, best overlap") && Contains("--frames FILE"));
  config.mission.frames = "common";
  const Team team = read_team({folder / "one", folder / "two"}, config, true, pool);
  CHECK_FALSE(team.frames);
  CHECK(team.mission.robots.size() == 2);
}

TEST_CASE("team: a component without scans is named", "[joining][team][error]") {
  Mission mission = simulated(WorldKind::kTunnel, 3, 1);
  ThreadPool pool(1);
  CHECK_THROWS_WITH(find_team_frames(mission, Config{}, pool), Contains("has only one robot"));
  mission = testing::cut(mission, 2);
  mission.scans = std::make_shared<ScanStore>();
  CHECK_THROWS_WITH(find_team_frames(mission, Config{}, pool), Contains("a: has no scans"));
}
#endif

TEST_CASE("team: two sessions of one place are joined", "[joining][team][data]") {
  const auto paths = sessions({"hku1", "hku2"});
  if (!paths) return;
  const testing::ScrambledMission made = testing::scrambled(read_missions(*paths), 7);
  const TeamFrames frames = found(made.mission);
  CAPTURE(to_string(frames.result, frames.components), frames.result.ties[0].reason);
  REQUIRE(frames.result.groups == 1);
  // Their own frames nearly agree, which is no truth: 306 closures of both say 0.08 rad.
  const testing::FrameError error = testing::frame_error(made, 0, 1, frames.result.frames[1].pose);
  CHECK(error.translation_m < 2.0);
  CHECK(error.rotation_rad < 0.12);
}

TEST_CASE("team: a session cut in two is joined", "[joining][team][data]") {
  const auto paths = sessions({"kaist03"});
  if (!paths) return;
  const testing::ScrambledMission made = testing::scrambled(testing::cut(read_mission(paths->front()), 2), 7);
  const TeamFrames frames = found(made.mission);
  CAPTURE(to_string(frames.result, frames.components), frames.result.ties[0].reason);
  REQUIRE(frames.result.groups == 1);
  const testing::FrameError error = testing::frame_error(made, 0, 1, frames.result.frames[1].pose);
  CHECK(error.translation_m < 0.5);
  CHECK(error.rotation_rad < 0.035);
}

TEST_CASE("team: sessions of different towns stay apart", "[joining][team][data]") {
  const auto paths = sessions({"kaist03", "hku1"});
  if (!paths) return;
  CHECK(found(testing::scrambled(read_missions(*paths), 7).mission).result.groups == 2);
}

}  // namespace loopwise::team_test
