// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/training/data_set.hpp>

#include <cctype>
#include <memory>
#include <mutex>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/replay/code_version.hpp>

namespace loopwise::training {
namespace {

namespace fs = std::filesystem;

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

}  // namespace

DataSource data_source(const Mission& mission, bool other_size) {
  DataSource source;
  source.name = mission.name;
  source.group = world_of(mission);
  source.other_size = other_size;
  const auto record = std::make_shared<MissionRecord>(record_of(mission, source.group, other_size));
  source.made_with = "mission " + to_string(hash_of(MissionData{*record, {}}));
  source.record = [record](const StopToken&) { return *record; };
  return source;
}

std::vector<DataSetEntry> data_set_entries(const std::vector<DataSource>& sources) {
  std::vector<DataSetEntry> entries;
  std::set<std::string> files;
  for (const DataSource& source : sources) {
    const std::string file = "missions/" + file_name(source.name) + ".cbor";
    if (!files.insert(file).second) throw OptionError("two missions are named " + source.name);
    entries.push_back({source.name, source.group, file, source.other_size});
  }
  static_cast<void>(split_by_mission(entries, 1));  // reports too few missions before any work
  return entries;
}

DataSetCounts make_data_set(const fs::path& folder, const std::vector<DataSource>& sources,
                            const DataOptions& options, ThreadPool& threads, const StopToken& stop,
                            const ProgressCallback& progress) {
  const std::vector<DataSetEntry> entries = data_set_entries(sources);
  const std::string made_with = " data " + to_json(options).dump() + " code " + replay_code_version();
  fs::create_directories(folder / "missions");
  std::mutex mutex;
  DataSetCounts counts;
  threads.for_each(sources.size(), [&](std::size_t i) {
    if (stop.stop_requested()) throw StoppedError("interrupted");
    const DataSource& source = sources[i];
    const fs::path file = folder / entries[i].file;
    const bool there = has_mission_data(file, source.made_with + made_with);
    MissionData made;
    if (there) {
      made = read_mission_data(file);
    } else {
      made = make_mission_data(source.record(stop), options, stop);
      {
        // dataset.json of an earlier set states that the set is complete and consistent; it no longer is.
        const std::lock_guard<std::mutex> lock(mutex);
        remove_former(folder / "dataset.json");
      }
      write_mission_data(file, made, source.made_with + made_with);
    }
    const std::lock_guard<std::mutex> lock(mutex);
    ++counts.missions;
    if (there) ++counts.kept;
    counts.graphs += made.graphs.size();
    for (const TrainingGraph& graph : made.graphs) counts.sets += graph.sets.size();
    if (progress) progress({"missions", counts.missions, sources.size(), source.name});
  });
  write_data_set(folder, entries, options);
  return counts;
}

}  // namespace loopwise::training
