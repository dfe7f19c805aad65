// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How well sources without a common frame are joined: simulated missions whose robots start anywhere, pairs
/// of places that have nothing in common, recordings. Prints rows of tables.
#include <chrono>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/replay/read_team.hpp>
#include <loopwise/replay/registration.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "scrambled.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr double kDegrees = 180.0 / 3.14159265358979323846;
constexpr WorldKind kWorlds[] = {WorldKind::kTunnel, WorldKind::kUrban, WorldKind::kFinals, WorldKind::kMine};

/// Kept in the folder from one run to the next.
Mission simulated(const fs::path& folder, WorldKind world, std::uint64_t seed, double length_m, int robots) {
  const std::string name = enum_name(world) + "-" + std::to_string(seed) + "-" +
                           std::to_string(static_cast<int>(length_m)) + "-" + std::to_string(robots);
  const fs::path path = folder / name;
  if (!fs::exists(path / "mission.json")) {
    fs::remove_all(path);
    SimulationOptions options;
    options.world = world;
    options.length_m = length_m;
    options.robots = robots;
    options.radio = false;
    simulate_to_folder(path, options, seed);
  }
  return read_mission(path);
}

void print_ties(const TeamFrames& frames) {
  for (const Tie& tie : frames.result.ties) {
    std::printf(
        "    %s - %s: %s; %zu computed, %zu verified, %zu agree, %zu places, %zu/%zu confirm, rival %zu "
        "(%.2f), sigma %.2f m %.2f deg, overlap %.2f: %s\n",
        frames.components[tie.a].name.c_str(), frames.components[tie.b].name.c_str(),
        tie.joined ? "JOINED" : "apart", tie.computed, tie.verified, tie.closures.size(), tie.places,
        tie.confirmed, tie.tested, tie.rival_closures, tie.rival_confirmed, tie.sigma_m,
        tie.sigma_rad * kDegrees, tie.best_overlap, tie.reason.c_str());
  }
}

/// Estimate of a replay of the mission.
PosesByKey replayed(const Mission& mission, const Config& config, ThreadPool& threads) {
  const MissionReplay replay(mission, config.replay,
                             make_registration(config.replay.registration, mission.scans->loader()));
  return poses_by_key(replay.run(threads).graph);
}

/// Error of the maps that two replays make: robots in the frames that were found, and in the given ones. Both
/// are judged after the best rigid motion, at the nodes of the robots that were joined.
void compare_maps(const Mission& given, const Mission& found, const Config& config, ThreadPool& threads) {
  const PosesByKey by_found = replayed(found, config, threads);
  PosesByKey by_given = replayed(given, config, threads);
  for (auto node = by_given.begin(); node != by_given.end();)
    node = by_found.count(node->first) == 0 ? by_given.erase(node) : std::next(node);
  const auto error = [&](const PosesByKey& estimate) {
    return evaluate_trajectory(estimate, given.ground_truth, Alignment::kSe3, given.robots).ate_m.mean;
  };
  const double with_found = error(by_found), with_given = error(by_given);
  std::printf("    map: ATE %.3f m with the found frames, %.3f m with the given ones, ratio %.2f\n",
              with_found, with_given, with_found / with_given);
}

/// Joins, prints a row and the ties, and says how the frames compare with the truth. `given`: the mission
/// with its own frames, if its map is to be compared.
void study(const std::string& name, const testing::ScrambledMission& made, const Config& config,
           const Mission* given = nullptr) {
  ThreadPool threads(2);
  const auto start = std::chrono::steady_clock::now();
  const TeamFrames frames = find_team_frames(made.mission, config, threads);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::size_t joined = 0, wrong = 0, ties = 0, wrong_ties = 0;
  double worst_m = 0.0, worst_rad = 0.0;
  std::map<std::size_t, std::size_t> first_of_group;
  for (std::size_t c = 0; c < frames.components.size(); ++c) {
    const ComponentFrame& frame = frames.result.frames[c];
    const auto [first, is_new] = first_of_group.emplace(frame.group, c);
    if (is_new) continue;
    ++joined;
    const testing::FrameError error = testing::frame_error(made, first->second, c, frame.pose);
    if (error.translation_m > 5.0 || error.rotation_rad > 0.2) ++wrong;
    worst_m = std::max(worst_m, error.translation_m);
    worst_rad = std::max(worst_rad, error.rotation_rad);
  }
  for (const Tie& tie : frames.result.ties) {
    if (!tie.joined) continue;
    ++ties;
    const testing::FrameError error = testing::frame_error(made, tie.a, tie.b, *tie.T_a_b);
    if (error.translation_m > 10.0 || error.rotation_rad > 0.4) ++wrong_ties;
  }
  std::printf("| %s | %zu | %zu of %zu | %zu of %zu | %zu | %.2f | %.2f | %zu | %.1f |\n", name.c_str(),
              frames.components.size(), joined + 1, frames.components.size(), wrong_ties, ties, wrong,
              worst_m, worst_rad * kDegrees, frames.result.computed, seconds);
  print_ties(frames);
  if (given != nullptr && joined > 0)
    compare_maps(*given, placed_team(made.mission, frames), config, threads);
  std::fflush(stdout);
}

/// Two missions as robots of one, without anything in common.
Mission together(const Mission& a, const Mission& b, const fs::path& folder) {
  const fs::path left = folder / "left", right = folder / "right";
  fs::remove_all(left);
  fs::remove_all(right);
  write_mission(left, a);
  write_mission(right, b);
  MissionOptions options;
  return read_missions({left, right}, options);
}

/// One robot of a mission.
Mission alone(const Mission& mission, std::size_t robot) {
  MissionPart part;
  part.robots = {robot};
  return place_parts(mission, {part}, {}, false);
}

void apart(const fs::path& folder, std::size_t pairs, double length_m, const Config& config) {
  for (std::size_t i = 0; i < pairs; ++i) {
    const WorldKind one = kWorlds[i % 4], two = kWorlds[(i + i / 4) % 4];
    const Mission a = alone(simulated(folder, one, 100 + i, length_m, 2), 0);
    const Mission b = alone(simulated(folder, two, 200 + i, length_m, 2), 1);
    const testing::ScrambledMission made = testing::scrambled(together(a, b, folder), i);
    study(enum_name(one) + " " + std::to_string(100 + i) + " and " + enum_name(two) + " " +
              std::to_string(200 + i),
          made, config);
  }
}

int run(const std::vector<std::string>& arguments) {
  const fs::path folder = arguments.at(0);
  const std::string& what = arguments.at(1);
  Config config;
  std::vector<std::string> rest;
  for (std::size_t i = 2; i < arguments.size(); ++i) {
    if (arguments[i].find('=') == std::string::npos) {
      rest.push_back(arguments[i]);
    } else {
      set_config_option(arguments[i], config);
    }
  }
  const auto number = [&](std::size_t i) { return std::stod(rest.at(i)); };
  if (what == "worlds" || what == "maps") {  // SEEDS LENGTH ROBOTS [FIRST SEED]
    const int first = rest.size() > 3 ? static_cast<int>(number(3)) : 1;
    for (int seed = first; seed < first + static_cast<int>(number(0)); ++seed) {
      for (const WorldKind world : kWorlds) {
        const Mission mission = simulated(folder, world, static_cast<std::uint64_t>(seed), number(1),
                                          static_cast<int>(number(2)));
        study(enum_name(world) + " " + std::to_string(seed),
              testing::scrambled(mission, static_cast<std::uint64_t>(seed)), config,
              what == "maps" ? &mission : nullptr);
      }
    }
  } else if (what == "apart") {  // PAIRS LENGTH
    apart(folder, static_cast<std::size_t>(number(0)), number(1), config);
  } else if (what == "cut") {  // PIECES SESSION
    const Mission mission = testing::cut(read_mission(rest.at(1)), static_cast<std::size_t>(number(0)));
    study("cut " + fs::path(rest[1]).filename().string(), testing::scrambled(mission, 7), config);
  } else if (what == "sources") {  // SESSION...
    MissionOptions options;
    const std::vector<fs::path> paths(rest.begin(), rest.end());
    study("sources", testing::scrambled(read_missions(paths, options), 7), config);
  } else {
    throw OptionError("unknown study " + what);
  }
  return 0;
}

}  // namespace
}  // namespace loopwise

int main(int argc, char** argv) {
  try {
    return loopwise::run(std::vector<std::string>(argv + 1, argv + argc));
  } catch (const std::exception& error) {
    std::fprintf(stderr,
                 "joining study: %s\nusage: FOLDER worlds|maps SEEDS LENGTH ROBOTS [FIRST SEED] | apart "
                 "PAIRS LENGTH | cut PIECES "
                 "SESSION | sources SESSION...  [SECTION.FIELD=VALUE...]\n",
                 error.what());
    return 1;
  }
}
