// SPDX-License-Identifier: BSD-3-Clause
#include "data_sources.hpp"

#include <cmath>
#include <sstream>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#ifdef LOOPWISE_HAS_SIMULATION
#include <loopwise/simulation/simulate.hpp>
#endif

namespace loopwise::training {
namespace {

std::vector<DataSource> recorded(const SourceArguments& arguments) {
  std::vector<DataSource> out;
  for (const std::string& path : arguments.missions) out.push_back(data_source(read_mission(path), false));
  for (const std::string& path : arguments.other_size) out.push_back(data_source(read_mission(path), true));
  return out;
}

#ifdef LOOPWISE_HAS_SIMULATION

DataSource simulated(const std::string& world, std::uint64_t seed, double length_m, bool other_size) {
  SimulationOptions simulation;
  simulation.world = parse_enum<WorldKind>("world", world);
  simulation.length_m = length_m;
  simulation.robots = 2 + static_cast<int>(seed % 3);
  simulation.radio = simulation.communication_gaps = false;
  simulation.threads = 1;
  validate_simulation(simulation);
  DataSource source;
  source.name = world + "-" + std::to_string(seed) + "-" + std::to_string(std::lround(length_m));
  source.group = world;
  source.other_size = other_size;
  source.made_with = "simulated " + to_json(simulation).dump() + " seed " + std::to_string(seed) +
                     " parameters " + std::string(simulation_parameters_hash());
  source.record = [simulation, seed, name = source.name, world, other_size](const StopToken& stop) {
    SimulatedMission made =
        simulate(simulation, seed, {}, stop, [](Key, const PointCloud&) { /* scans are not needed */ });
    made.mission.name = name;
    return record_of(made.mission, world, other_size);
  };
  return source;
}

std::vector<DataSource> simulated(const SourceArguments& options) {
  std::vector<DataSource> out;
  std::vector<std::string> worlds;
  std::stringstream words(options.worlds);
  for (std::string word; std::getline(words, word, ',');) worlds.push_back(word);
  if (worlds.empty()) throw OptionError("--worlds names no world");
  if (options.lengths.empty()) throw OptionError("--lengths holds no length");
  const auto add = [&](const std::string& world, std::uint64_t seed, double length, bool other_size) {
    out.push_back(simulated(world, seed, length, other_size));
  };
  for (const std::string& world : worlds) {
    for (std::int64_t k = 0; k < options.seeds; ++k) {
      add(world, options.first_seed + static_cast<std::uint64_t>(k),
          options.lengths[static_cast<std::size_t>(k) % options.lengths.size()], false);
    }
    for (const double length : options.other_lengths) {
      for (std::int64_t k = 0; k < options.other_seeds; ++k) {
        add(world, options.first_seed + 1000 + static_cast<std::uint64_t>(k), length, true);
      }
    }
  }
  return out;
}

#else

std::vector<DataSource> simulated(const SourceArguments&) {
  throw OptionError("no missions given, and this build has no simulation to make some");
}

#endif

}  // namespace

std::vector<DataSource> sources_of(const SourceArguments& arguments) {
  const bool given = !arguments.missions.empty() || !arguments.other_size.empty();
  return given ? recorded(arguments) : simulated(arguments);
}

}  // namespace loopwise::training
