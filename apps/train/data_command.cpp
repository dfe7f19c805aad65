// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <mutex>
#include <set>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/training/training_data.hpp>
#ifdef LOOPWISE_HAS_SIMULATION
#include <loopwise/simulation/simulate.hpp>
#endif

#include "commands.hpp"

namespace loopwise::training {
namespace {

struct Options {
  CommonOptions common;
  std::vector<std::string> missions;
  std::vector<std::string> other_size;
  std::string output;
  std::string worlds = "tunnel,urban,finals,mine";
  std::vector<double> lengths{300.0, 500.0, 800.0};
  std::vector<double> other_lengths{1600.0};
  std::int64_t seeds = 12;
  std::int64_t other_seeds = 2;
  std::uint64_t first_seed = 1;
  bool resume = false;
};

/// The source of one mission.
struct Source {
  DataSetEntry entry;
  std::string made_with;
  std::function<MissionRecord(const StopToken&)> record;
};

/// Makes a valid file name from a name.
std::string file_name(std::string name) {
  for (char& c : name) {
    if (std::isalnum(static_cast<unsigned char>(c)) == 0 && c != '-' && c != '_' && c != '.') c = '_';
  }
  return name;
}

std::string world_of(const Mission& mission) {
  const Json provenance = parse_json(mission.provenance_json, mission.name + ": provenance");
  const auto options = provenance.find("options");
  if (options != provenance.end() && options->is_object() && options->contains("world") &&
      options->at("world").is_string()) {
    return options->at("world").get<std::string>();
  }
  return "recorded";
}

std::vector<Source> recorded(const Options& options) {
  std::vector<Source> out;
  const auto add = [&](const std::string& path, bool other_size) {
    Mission mission = read_mission(path);
    Source source;
    source.entry.name = mission.name;
    source.entry.group = world_of(mission);
    source.entry.other_size = other_size;
    const auto record = std::make_shared<MissionRecord>(record_of(mission, source.entry.group, other_size));
    source.made_with = "mission " + to_string(hash_of(MissionData{*record, {}}));
    source.record = [record](const StopToken&) { return *record; };
    out.push_back(std::move(source));
  };
  for (const std::string& path : options.missions) add(path, false);
  for (const std::string& path : options.other_size) add(path, true);
  return out;
}

std::vector<Source> simulated(const Options& options) {
  std::vector<Source> out;
#ifdef LOOPWISE_HAS_SIMULATION
  std::vector<std::string> worlds;
  std::stringstream words(options.worlds);
  for (std::string word; std::getline(words, word, ',');) worlds.push_back(word);
  if (worlds.empty()) throw OptionError("--worlds names no world");
  if (options.lengths.empty()) throw OptionError("--lengths holds no length");
  const auto add = [&](const std::string& world, std::uint64_t seed, double length, bool other_size) {
    SimulationOptions simulation;
    simulation.world = parse_enum<WorldKind>("world", world);
    simulation.length_m = length;
    simulation.robots = 2 + static_cast<int>(seed % 3);
    simulation.radio = simulation.communication_gaps = false;
    simulation.threads = 1;
    validate_simulation(simulation);
    Source source;
    source.entry.name = world + "-" + std::to_string(seed) + "-" + std::to_string(std::lround(length));
    source.entry.group = world;
    source.entry.other_size = other_size;
    source.made_with = "simulated " + to_json(simulation).dump() + " seed " + std::to_string(seed) +
                       " parameters " + std::string(simulation_parameters_hash());
    source.record = [simulation, seed, entry = source.entry](const StopToken& stop) {
      SimulatedMission made =
          simulate(simulation, seed, {}, stop, [](Key, const PointCloud&) { /* scans are not needed */ });
      made.mission.name = entry.name;
      return record_of(made.mission, entry.group, entry.other_size);
    };
    out.push_back(std::move(source));
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
#else
  static_cast<void>(options);
  throw OptionError("no missions given, and this build has no simulation to make some");
#endif
}

int run(const Options& options) {
  cli::Console console(options.common.quiet);
  const cli::InterruptGuard interrupt;
  DataOptions data;
  load_section(options.common, "data", data);
  const bool given = !options.missions.empty() || !options.other_size.empty();
  std::vector<Source> sources = given ? recorded(options) : simulated(options);
  std::vector<DataSetEntry> entries;
  std::set<std::string> files;
  for (Source& source : sources) {
    source.made_with += " data " + to_json(data).dump() + " code " + replay_code_version();
    source.entry.file = "missions/" + file_name(source.entry.name) + ".cbor";
    if (!files.insert(source.entry.file).second) {
      throw OptionError("two missions are named " + source.entry.name);
    }
    entries.push_back(source.entry);
  }
  static_cast<void>(split_by_mission(entries, 1));  // reports too few missions before any work
  const std::filesystem::path folder = options.output;
  prepare_output_folder(folder, options.resume, "; --resume continues interrupted data");
  std::filesystem::create_directories(folder / "missions");

  std::mutex mutex;
  std::size_t done = 0, kept = 0, graphs = 0, sets = 0;
  ThreadPool pool(cli::thread_count(options.common));
  try {
    pool.for_each(sources.size(), [&](std::size_t i) {
      if (interrupt.interrupted()) throw Error("interrupted");
      const Source& source = sources[i];
      const std::filesystem::path file = folder / source.entry.file;
      const bool there = has_mission_data(file, source.made_with);
      MissionData made;
      if (there) {
        made = read_mission_data(file);
      } else {
        made = make_mission_data(source.record(interrupt.token()), data, interrupt.token());
        {
          // dataset.json of an earlier set states that the set is complete and consistent; it no longer is.
          const std::lock_guard<std::mutex> lock(mutex);
          std::error_code failure;
          std::filesystem::remove(folder / "dataset.json", failure);
          if (failure) throw IoError((folder / "dataset.json").string(), failure.message());
        }
        write_mission_data(file, made, source.made_with);
      }
      const std::lock_guard<std::mutex> lock(mutex);
      ++done;
      if (there) ++kept;
      graphs += made.graphs.size();
      for (const TrainingGraph& graph : made.graphs) sets += graph.sets.size();
      console.progress({"missions", done, sources.size(), source.entry.name});
    });
  } catch (const std::exception&) {
    if (!interrupt.interrupted()) throw;
    console.warn("interrupted: finished missions are kept, --resume continues");
    return cli::kInterrupted;
  }
  write_data_set(folder, entries, data);
  const Json json = {{"folder", options.output},
                     {"missions", sources.size()},
                     {"kept", kept},
                     {"graphs", graphs},
                     {"sets", sets},
                     {"options", to_json(data)}};
  cli::print_results(options.common, json,
                     std::to_string(sources.size()) + " missions, " + std::to_string(graphs) + " graphs, " +
                         std::to_string(sets) + " sets solved exactly, in " + options.output + "\n");
  return cli::kDone;
}

}  // namespace

void add_data(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("data", "Make data: missions, graphs of them, sets solved exactly");
  command->footer(
      "Without missions, simulates some: each world with each seed, lengths in turn. Those of "
      "--other-lengths "
      "are\nfor the test alone.\n"
      "  loopwise-train data -o data\n"
      "  loopwise-train data mission1 mission2 mission3 -o data\n"
      "Options of --set and --config: section data, fields candidates, max_set, random_sets, annealing_runs, "
      "seed.");
  command->add_option("missions", options->missions, "Mission folders, session folders or g2o files")
      ->type_name("MISSION");
  command->add_option("--other-size", options->other_size, "A mission for the test alone; may be repeated")
      ->type_name("MISSION")
      ->expected(1)
      ->take_all();
  command->add_option("-o,--output", options->output, "Folder for the data: a new one, or empty")
      ->required()
      ->type_name("DIR")
      ->check(cli::not_standard_output());
  command->add_option("--worlds", options->worlds, "Worlds to simulate (default all)")->type_name("LIST");
  command->add_option("--seeds", options->seeds, "Missions of each world (default 12)")
      ->type_name("N")
      ->check(CLI::Range(0, 100000));
  command
      ->add_option("--first-seed", options->first_seed, "Seed of the first mission of each world (default 1)")
      ->type_name("S")
      ->check(cli::not_negative());
  command->add_option("--lengths", options->lengths, "Path length of the team, m (default 300,500,800)")
      ->type_name("M,...")
      ->delimiter(',');
  command
      ->add_option("--other-lengths", options->other_lengths,
                   "Lengths of missions that are for the test alone (default 1600)")
      ->type_name("M,...")
      ->delimiter(',');
  command->add_option("--other-seeds", options->other_seeds, "Missions of each such length (default 2)")
      ->type_name("N")
      ->check(CLI::Range(0, 100000));
  command->add_flag("--resume", options->resume, "Continue interrupted data");
  cli::add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::training
