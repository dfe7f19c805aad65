// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "bag.hpp"
#include "cloud_files.hpp"
#include "hdl_graph_slam.hpp"
#include "renamed_graph.hpp"
#include "zip_archive.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

/// Usual names of folders of clouds, the most likely first.
constexpr const char* kCloudFolders[] = {"pcd",    "pcds",        "scans",      "Scans",
                                         "clouds", "keyed_scans", "pose_graph", "point_clouds"};

/// Folders and archives that may contain clouds, in the order of the search.
struct Places {
  std::vector<fs::path> folders;
  std::vector<fs::path> archives;
};

Places places_of(const fs::path& folder) {
  Places places;
  places.folders.push_back(folder);
  for (const char* name : kCloudFolders) {
    if (fs::is_directory(folder / name)) places.folders.push_back(folder / name);
  }
  for (const fs::path& entry : entries(folder)) {
    const auto& known = places.folders;
    if (fs::is_directory(entry) && !is_truth(entry) &&
        std::find(known.begin(), known.end(), entry) == known.end()) {
      places.folders.push_back(entry);
    }
    if (fs::is_regular_file(entry) && entry.extension() == ".zip") places.archives.push_back(entry);
  }
  return places;
}

KeyTable key_table_of(const FileSource& files) {
  const auto table = files.find("keys.csv");
  return table ? parse_key_table(files.path(*table), files.read(*table)) : KeyTable();
}

struct Found {
  FileSource files;
  KeyTable table;
  NamedClouds clouds;
};

Found clouds_of_key_frames(const KeyFrameFolders& key_frames) {
  Found found{key_frames.files, {}, {}};
  found.table.stamps = key_frames.stamps;
  for (const auto& [id, file] : key_frames.clouds) {
    const auto full = key_frames.full.find(id);
    found.clouds.by_key.emplace(full == key_frames.full.end() ? id : full->second, file);
  }
  return found;
}

/// Keys of the nodes according to the key frames of a team. \throws InputError naming a node without a key
/// frame
const std::map<Key, Key>& keys_of_team(const KeyFrameFolders& key_frames, const PoseGraph& graph,
                                       const std::string& file) {
  for (const Node& node : graph.nodes()) {
    if (key_frames.full.count(node.key) == 0) {
      throw InputError(file + ": node " + std::to_string(node.key) +
                       " has no key frame in keyframes/, so its robot is unknown");
    }
  }
  return key_frames.full;
}

/// Clouds in the first place that has clouds of nodes. A key table may be in that place or in the folder.
Found find_clouds(const fs::path& folder, Problems& problems) {
  const Places places = places_of(folder);
  const KeyTable own = key_table_of(files_of_folder(folder));
  Problems of_folder;
  const auto look = [&](FileSource files) {
    Found found{std::move(files), {}, {}};
    found.table = key_table_of(found.files);
    if (found.table.stamps.empty()) found.table = own;
    Problems met;
    found.clouds = name_clouds(found.files, found.table, met);
    if (!found.clouds.empty()) problems.add(met);
    return found;
  };
  for (const fs::path& place : places.folders) {
    Found found = look(files_of_folder(place));
    if (!found.clouds.empty()) return found;
  }
  for (const fs::path& archive : places.archives) {
    if (!ZipArchive::available()) {
      // Throws an error with the reason and the remedy.
      static_cast<void>(ZipArchive(archive));
    }
    Found found = look(files_of_archive(archive));
    if (!found.clouds.empty()) return found;
  }
  Found none;
  none.table = own;
  return none;
}

/// Full keys for the small ids of a graph. \throws InputError if the assignment is uncertain
std::map<Key, Key> full_keys(const PoseGraph& graph, const NamedClouds& clouds, const std::string& file,
                             const MissionOptions& options) {
  std::map<Key, Key> full;
  const bool small = std::all_of(graph.nodes().begin(), graph.nodes().end(),
                                 [](const Node& node) { return key_character(node.key) == '\0'; });
  if (!options.robot_character.empty()) {
    const Key first = options.robot_character.size() == 1 ? make_key(options.robot_character[0], 0) : 0;
    if (options.robot_character.size() != 1 || key_name(first) != options.robot_character + "0") {
      throw OptionError("robot_character = \"" + options.robot_character + "\", must be one letter");
    }
    if (!small)
      throw InputError(file +
                       ": its ids already contain robot characters, so robot_character cannot be used");
    for (const Node& node : graph.nodes()) full[node.key] = make_key(options.robot_character[0], node.key);
    return full;
  }
  std::map<Key, std::set<Key>> of_index;
  std::set<char> characters;
  for (const auto& [key, cloud] : clouds.by_key) {
    of_index[key_index(key)].insert(key);
    characters.insert(key_character(key));
  }
  if (!small || characters.empty() || characters == std::set<char>{'\0'}) return full;
  for (const Node& node : graph.nodes()) {
    const auto found = of_index.find(node.key);
    const bool one = found != of_index.end() && found->second.size() == 1;
    if (characters.size() == 1) {
      full[node.key] = make_key(*characters.begin(), node.key);
    } else if (one) {
      full[node.key] = *found->second.begin();
    } else {
      std::string choices;
      for (const char c : characters)
        choices += (choices.empty() ? "" : " or ") + key_name(make_key(c, node.key));
      throw InputError(
          file + ": id " + std::to_string(node.key) + " may be " + choices +
          ": the ids lack the robots' characters, and the clouds are of several robots. Write the "
          "graph with full 64-bit keys, or give each robot a folder of its own");
    }
  }
  return full;
}

/// Characters of landmarks. A character belongs to a robot if clouds or odometry have it.
std::set<char> landmark_characters(const PoseGraph& graph, const NamedClouds& clouds) {
  std::set<char> characters;
  for (const Node& node : graph.nodes()) {
    if (is_landmark_character(key_character(node.key))) characters.insert(key_character(node.key));
  }
  for (const auto& [key, cloud] : clouds.by_key) characters.erase(key_character(key));
  for (const Edge& edge : graph.edges()) {
    if (key_character(edge.from) == key_character(edge.to)) characters.erase(key_character(edge.from));
  }
  return characters;
}

}  // namespace

fs::path g2o_of_folder(const fs::path& folder) {
  if (fs::is_regular_file(folder / "result.g2o")) return folder / "result.g2o";
  std::vector<fs::path> graphs;
  for (const fs::path& entry : entries(folder)) {
    if (entry.extension() == ".g2o" && !is_truth(entry) && fs::is_regular_file(entry))
      graphs.push_back(entry);
  }
  if (graphs.size() > 1) {
    throw InputError(folder.string() + ": " + graphs[0].filename().string() + " and " +
                     graphs[1].filename().string() + ": name the graph to read result.g2o");
  }
  return graphs.empty() ? fs::path() : graphs.front();
}

Mission read_g2o_pcd(const fs::path& folder, const MissionOptions& options, const Work& work) {
  if (work.progress) work.progress({"reading " + folder.string(), 0, 0, ""});
  Mission mission;
  mission.kind = MissionKind::kG2oPcd;
  mission.path = folder;
  mission.name = recording_name(folder);
  const bool of_team = is_mrg_slam(folder);
  const fs::path file = of_team ? folder / "g2o" / "graph.g2o" : g2o_of_folder(folder);
  if (file.empty()) throw InputError(folder.string() + ": no g2o file");
  G2oFile g2o = read_g2o(file);
  Problems of_key_frames;
  const auto folders =
      of_team ? find_team_key_frames(folder, of_key_frames) : find_key_frame_folders(folder, of_key_frames);
  if (folders) g2o = without_anchors(std::move(g2o), *folders, file.string());
  mission.problems = g2o.problems;
  mission.problems.add(of_key_frames);
  if (fs::is_regular_file(folder / kRanges)) read_ranges(folder / kRanges, g2o.graph);
  if (fs::is_regular_file(folder / kGravity)) read_gravity(folder / kGravity, g2o.graph, mission.problems);
  const Found found = folders ? clouds_of_key_frames(*folders) : find_clouds(folder, mission.problems);
  const std::map<Key, Key> full = of_team ? keys_of_team(*folders, g2o.graph, file.string())
                                          : full_keys(g2o.graph, found.clouds, file.string(), options);
  const PoseGraph graph =
      full.empty() ? g2o.graph : parts::renamed(g2o.graph, [&](Key key) { return full.at(key); });
  const Robots robots = of_team ? Robots(folders->robots) : Robots::from_keys(graph.keys());
  mission.robots =
      robots_of(graph, options, with_landmarks(robots, landmark_characters(graph, found.clouds)));

  Stamps stamps;
  for (const auto& [written, stamp] : found.table.stamps) {
    const auto known = full.find(written);
    const Key key = known == full.end() ? written : known->second;
    if (graph.contains(key)) {
      stamps.emplace(key, stamp);
    } else {
      mission.problems.add("stamp without node", folder.string() + ": " + key_name(key));
    }
  }
  if (stamps.empty()) {
    mission.problems.add("no stamps given", file.string());
    stamps = regular_stamps(graph, mission.robots, options);
  } else {
    complete_stamps(graph, mission.robots, options, folder.string(), stamps, mission.problems);
  }
  std::vector<PriorFactor> priors = graph.priors();
  complete_priors(graph, mission.robots, options, file.string(), priors, mission.problems);
  MissionOptions own = options;
  if (own.odometry.empty() && fs::is_regular_file(folder / kOdometry))
    own.odometry = (folder / kOdometry).string();
  mission.graph =
      assemble(graph, stamps, priors, mission.robots, own, mission.problems, g2o.without_information);
  check_stamps(mission);

  const TruthFiles truth = find_truth(folder);
  if (!truth.g2o.empty()) {
    std::map<Key, Eigen::Isometry3d> poses;
    for (const auto& [key, pose] : read_truth(truth.g2o, mission.problems)) {
      const auto known = full.find(key);
      poses.emplace(known == full.end() ? key : known->second, pose);
    }
    set_ground_truth(mission, std::move(poses));
  } else if (!truth.bags.empty()) {
    read_bag_truth(mission, truth.bags, options, work);
  }
  set_scans(mission, found.files,
            clouds_of_nodes(found.clouds, key_frames(graph, mission.robots), found.files), options);
  mission.provenance_json = provenance_of(mission.kind, {file.filename().string()});
  return mission;
}

}  // namespace loopwise::parts
