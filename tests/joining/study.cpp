// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How well sources without a common frame are joined: simulated missions whose robots start anywhere, pairs
/// of places that have nothing in common, recordings. Also how much candidates by appearance help where
/// odometry drifts. Prints rows of tables.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <iterator>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/replay/read_team.hpp>
#include <loopwise/replay/registration.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "exhaustive.hpp"
#include "scrambled.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr double kDegrees = 180.0 / 3.14159265358979323846;
constexpr WorldKind kWorlds[] = {WorldKind::kTunnel, WorldKind::kUrban, WorldKind::kFinals, WorldKind::kMine};

/// What all steps need.
struct Setting {
  fs::path folder;  ///< Keeps simulated missions from one run to the next.
  const Config& config;
  ThreadPool& threads;
  std::vector<WorldKind> worlds;  ///< To simulate.
};

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
    double longest_m = 0.0;
    for (const LoopClosure& closure : tie.closures)
      longest_m = std::max(longest_m, closure.T_from_to.translation().norm());
    std::printf(
        "    %s - %s: %s; %zu computed, %zu verified, %zu agree over up to %.1f m, %zu places, %zu/%zu "
        "confirm, rival %zu "
        "(%.2f), sigma %.2f m %.2f deg, overlap %.2f: %s\n",
        frames.components[tie.a].name.c_str(), frames.components[tie.b].name.c_str(),
        tie.joined ? "JOINED" : "apart", tie.computed, tie.verified, tie.closures.size(), longest_m,
        tie.places, tie.confirmed, tie.tested, tie.rival_closures, tie.rival_confirmed, tie.sigma_m,
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
void study(const std::string& name, const testing::ScrambledMission& made, const Setting& setting,
           const Mission* given = nullptr) {
  const auto start = std::chrono::steady_clock::now();
  const TeamFrames frames = find_team_frames(made.mission, setting.config, setting.threads);
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
    compare_maps(*given, placed_team(made.mission, frames), setting.config, setting.threads);
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

void apart(std::size_t pairs, double length_m, const Setting& setting) {
  for (std::size_t i = 0; i < pairs; ++i) {
    const WorldKind one = kWorlds[i % 4], two = kWorlds[(i + i / 4) % 4];
    const Mission a = alone(simulated(setting.folder, one, 100 + i, length_m, 2), 0);
    const Mission b = alone(simulated(setting.folder, two, 200 + i, length_m, 2), 1);
    const testing::ScrambledMission made = testing::scrambled(together(a, b, setting.folder), i);
    study(enum_name(one) + " " + std::to_string(100 + i) + " and " + enum_name(two) + " " +
              std::to_string(200 + i),
          made, setting);
  }
}

/// Two stretches of a mission's paths, and their distance.
struct Stretches {
  std::vector<Key> a, b;
  double gap_m = 0.0;  ///< Between the two nearest key frames, by the truth.
};

/// The two stretches of this length that are farthest apart.
Stretches farthest_stretches(const Mission& mission, double length_m, double spacing_m) {
  const auto count = static_cast<std::size_t>(length_m / spacing_m);
  constexpr std::size_t kStep = 5;  // key frames between the stretches that are compared
  std::vector<std::vector<Key>> all;
  for (const std::vector<Key>& path : robot_paths(mission.graph, mission.robots)) {
    for (std::size_t first = 0; first + count <= path.size(); first += kStep) {
      const auto begin = path.begin() + static_cast<std::ptrdiff_t>(first);
      all.emplace_back(begin, begin + static_cast<std::ptrdiff_t>(count));
    }
  }
  Stretches best;
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t j = i + 1; j < all.size(); ++j) {
      double gap_m = std::numeric_limits<double>::infinity();
      for (const Key x : all[i]) {
        const Eigen::Vector3d at = mission.ground_truth.at(x).translation();
        for (const Key y : all[j])
          gap_m = std::min(gap_m, (mission.ground_truth.at(y).translation() - at).norm());
        if (gap_m <= best.gap_m) break;
      }
      if (gap_m > best.gap_m) best = {all[i], all[j], gap_m};
    }
  }
  return best;
}

/// Share of the cubes of a metre with points of b that also hold points of a, at the true poses.
double seen_by_both(const Mission& mission, const std::vector<Key>& a, const std::vector<Key>& b) {
  const auto cubes = [&](const std::vector<Key>& keys) {
    std::vector<std::array<int, 3>> out;
    for (const Key key : keys) {
      const auto scan = mission.scans->load(key);
      if (!scan) continue;
      const Eigen::Isometry3f T = mission.ground_truth.at(key).cast<float>();
      for (const Eigen::Vector3f& point : scan->points) {
        const Eigen::Vector3i cube = (T * point).array().floor().cast<int>();
        out.push_back({cube.x(), cube.y(), cube.z()});
      }
    }
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
    return out;
  };
  const auto of_a = cubes(a), of_b = cubes(b);
  std::vector<std::array<int, 3>> common;
  std::set_intersection(of_a.begin(), of_a.end(), of_b.begin(), of_b.end(), std::back_inserter(common));
  return of_b.empty() ? 0.0 : static_cast<double>(common.size()) / static_cast<double>(of_b.size());
}

/// A step over simulated missions: each of the worlds with some seeds.
struct Missions {
  int seeds = 1;
  double length_m = 600.0;
  int robots = 3;
  int first_seed = 1;
};

template <class Step>
void for_each_mission(const Missions& missions, const Setting& setting, const Step& step) {
  for (int seed = missions.first_seed; seed < missions.first_seed + missions.seeds; ++seed) {
    for (const WorldKind world : setting.worlds) {
      step(enum_name(world) + " " + std::to_string(seed), static_cast<std::uint64_t>(seed),
           simulated(setting.folder, world, static_cast<std::uint64_t>(seed), missions.length_m,
                     missions.robots));
    }
  }
}

/// Two robots in one world that never see the same place: the two stretches that are farthest apart.
void disjoint(const Missions& missions, double stretch_m, const Setting& setting) {
  for_each_mission(
      missions, setting, [&](const std::string& name, std::uint64_t seed, const Mission& mission) {
        const Stretches far = farthest_stretches(mission, stretch_m, SimulationOptions().node_spacing_m);
        const double common = 100.0 * seen_by_both(mission, far.a, far.b);
        char figures[64];
        std::snprintf(figures, sizeof figures, ", %.0f m apart, %.2f %% seen by both", far.gap_m, common);
        study(name + figures, testing::scrambled(testing::as_robots(mission, {far.a, far.b}), seed), setting);
      });
}

/// Prints a line on the error stream whenever another twentieth of the work is done.
ProgressCallback progress_lines() {
  return [shown = std::size_t{0}, stage = std::string()](const Progress& progress) mutable {
    const std::size_t twentieth = 20 * progress.done / std::max<std::size_t>(1, progress.total);
    if (progress.stage == stage && twentieth == shown) return;
    stage = progress.stage;
    shown = twentieth;
    std::fprintf(stderr, "%s: %zu of %zu, %s\n", stage.c_str(), progress.done, progress.total,
                 progress.detail.c_str());
  };
}

/// Compares the frame that joining finds between two sources with that of exhaustive registration.
void exhaustive(std::size_t stride, const std::vector<fs::path>& sources, const Setting& setting) {
  constexpr std::size_t kMostCompared = 4000;
  const testing::ScrambledMission made = testing::scrambled(read_missions(sources, MissionOptions()), 7);
  study("sources", made, setting);
  const TeamFrames found = find_team_frames(made.mission, setting.config, setting.threads);
  const testing::ExhaustiveFrame all = testing::exhaustive_frame(
      made.mission, setting.config, stride, kMostCompared, setting.threads, progress_lines());
  std::printf(
      "    exhaustive: %zu of %zu pairs registered, %zu verified, %zu of %zu compared agree, ends within "
      "%.2f m of one frame\n",
      all.computed, all.pairs, all.verified, all.agreeing, all.compared, all.scatter_m);
  if (found.result.groups == 1) {
    const testing::FrameError difference =
        testing::frame_difference(made.mission, 1, found.result.frames[1].pose, all.T_a_b);
    std::printf("    the frame that was found differs by %.2f m, %.2f deg\n", difference.translation_m,
                difference.rotation_rad * kDegrees);
  }
}

/// Error of the positions in the common frame after a replay, without alignment, and its closures.
struct DriftRun {
  double rmse_m = 0.0;
  std::size_t registrations = 0, verified = 0;
};

DriftRun drift_run(const Mission& mission, const ReplayOptions& options, ThreadPool& threads) {
  const ReplayResult result =
      MissionReplay(mission, options, make_registration(options.registration, mission.scans->loader()))
          .run(threads);
  DriftRun run;
  run.rmse_m =
      evaluate_trajectory(poses_by_key(result.graph), mission.ground_truth, Alignment::kNone, mission.robots)
          .ate_m.rmse;
  run.registrations = result.computed.size();
  run.verified = static_cast<std::size_t>(
      std::count_if(result.computed.begin(), result.computed.end(),
                    [](const ComputedCandidate& computed) { return computed.result.verified(); }));
  return run;
}

/// How candidates by appearance help where odometry drifts beyond the search radius: odometry made five times
/// worse, and the same number of registrations with each kind of candidates.
void drift(const Missions& missions, const Setting& setting) {
  std::printf(
      "| mission | odometry alone, m | proximity | proximity and appearance | appearance alone |\n"
      "| --- | ---: | ---: | ---: | ---: |\n");
  for_each_mission(
      missions, setting, [&](const std::string& name, std::uint64_t seed, const Mission& mission) {
        ReplayOptions options = setting.config.replay;
        options.after_mission = true;
        options.odometry_noise_m_per_m = 0.2;
        options.odometry_noise_rad_per_m = 0.04;
        options.engine.seed = seed;
        if (options.max_registrations == 0) options.max_registrations = 600;
        std::printf("| %s |", name.c_str());
        for (const auto& [proximity, appearance] : {std::pair(false, false), std::pair(true, false),
                                                    std::pair(true, true), std::pair(false, true)}) {
          options.engine.use_proximity = proximity;
          options.appearance.enabled = appearance;
          const DriftRun run = drift_run(mission, options, setting.threads);
          if (proximity || appearance) {
            std::printf(" %.1f m, %zu of %zu verified |", run.rmse_m, run.verified, run.registrations);
          } else {
            std::printf(" %.1f |", run.rmse_m);
          }
          std::fflush(stdout);
        }
        std::printf("\n");
      });
}

void worlds(bool maps, const Missions& missions, const Setting& setting) {
  for_each_mission(missions, setting,
                   [&](const std::string& name, std::uint64_t seed, const Mission& mission) {
                     study(name, testing::scrambled(mission, seed), setting, maps ? &mission : nullptr);
                   });
}

constexpr const char* kUsage =
    "usage: FOLDER worlds|maps|drift SEEDS LENGTH ROBOTS [FIRST SEED] | disjoint SEEDS LENGTH ROBOTS "
    "FIRST_SEED "
    "STRETCH | apart PAIRS LENGTH | cut PIECES SESSION [SHARED KEY FRAMES] | sources SESSION... | exhaustive "
    "STRIDE "
    "SESSION SESSION  [threads=N] [world=NAME] [SECTION.FIELD=VALUE...]";

int run(const std::vector<std::string>& arguments) {
  if (arguments.size() < 2) throw OptionError("too few arguments");
  const std::string& what = arguments[1];
  ThreadPool threads(2);
  Config config;
  std::vector<WorldKind> worlds_to_simulate(std::begin(kWorlds), std::end(kWorlds));
  std::vector<std::string> rest;
  for (std::size_t i = 2; i < arguments.size(); ++i) {
    if (arguments[i].rfind("threads=", 0) == 0) {
      threads.resize(std::stoi(arguments[i].substr(8)));
    } else if (arguments[i].rfind("world=", 0) == 0) {
      worlds_to_simulate = {parse_enum<WorldKind>("world", arguments[i].substr(6))};
    } else if (arguments[i].find('=') == std::string::npos) {
      rest.push_back(arguments[i]);
    } else {
      set_config_option(arguments[i], config);
    }
  }
  const Setting setting{arguments[0], config, threads, worlds_to_simulate};
  const auto number = [&](std::size_t i) { return std::stod(rest.at(i)); };
  const auto integer = [&](std::size_t i) { return std::stoi(rest.at(i)); };
  const auto missions = [&] {
    return Missions{integer(0), number(1), integer(2), rest.size() > 3 ? integer(3) : 1};
  };
  if (what == "worlds" || what == "maps") {
    worlds(what == "maps", missions(), setting);
  } else if (what == "apart") {
    apart(static_cast<std::size_t>(integer(0)), number(1), setting);
  } else if (what == "disjoint") {
    disjoint(missions(), number(4), setting);
  } else if (what == "drift") {
    drift(missions(), setting);
  } else if (what == "cut") {
    const auto shared = static_cast<std::size_t>(rest.size() > 2 ? integer(2) : 0);
    const Mission mission =
        testing::cut(read_mission(rest.at(1)), static_cast<std::size_t>(integer(0)), shared);
    study("cut " + fs::path(rest[1]).filename().string(), testing::scrambled(mission, 7), setting);
  } else if (what == "sources") {
    const std::vector<fs::path> paths(rest.begin(), rest.end());
    study("sources", testing::scrambled(read_missions(paths, MissionOptions()), 7), setting);
  } else if (what == "exhaustive") {
    exhaustive(static_cast<std::size_t>(integer(0)), {rest.at(1), rest.at(2)}, setting);
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
    std::fprintf(stderr, "joining study: %s\n%s\n", error.what(), loopwise::kUsage);
    return 1;
  }
}
