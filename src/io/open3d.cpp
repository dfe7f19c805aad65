// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cctype>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>

#include "information.hpp"
#include "saved_maps.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

constexpr const char* kGraphClass = "PoseGraph";

std::vector<double> numbers_of(const Json& object, const char* key, std::size_t count,
                               const std::string& where) {
  const auto found = object.is_object() ? object.find(key) : object.end();
  if (!object.is_object() || found == object.end() || !found->is_array() || found->size() != count)
    throw InputError(where + ": " + key + " must be a list of " + std::to_string(count) + " numbers");
  std::vector<double> values;
  for (const Json& value : *found) {
    if (!value.is_number() || !std::isfinite(value.get<double>()))
      throw InputError(where + ": " + key + " holds " + text::quoted(json_text(value)) +
                       ", which is not a number");
    values.push_back(value.get<double>());
  }
  return values;
}

/// A 4×4 matrix in column-major order.
Eigen::Isometry3d pose_in(const Json& object, const char* key, const std::string& where, Problems& problems) {
  const std::vector<double> v = numbers_of(object, key, 16, where);
  double rows[12];
  for (std::size_t i = 0; i < 12; ++i) rows[i] = v[(i % 4) * 4 + i / 4];
  const text::Rigid rigid = text::rigid_of(rows, text::Place{where, 1});
  if (!rigid.was_rotation) problems.add_altered("rotation not orthonormal", where + ": " + key);
  return rigid.pose;
}

std::uint64_t id_of(const Json& edge, const char* key, std::size_t nodes, const std::string& where) {
  const auto found = edge.is_object() ? edge.find(key) : edge.end();
  const bool given = edge.is_object() && found != edge.end() && found->is_number_integer();
  if (!given || *found < 0 || found->get<std::uint64_t>() >= nodes) {
    throw InputError(where + ": " + key + " must be the number of a node, 0 to " + std::to_string(nodes - 1));
  }
  return found->get<std::uint64_t>();
}

/// Open3D puts the rotation first, and perturbs the source's points in the target's frame: on the left.
Matrix6d information_of(const Json& edge, const Eigen::Isometry3d& T_target_source, const std::string& where,
                        Problems& problems) {
  const std::vector<double> v = numbers_of(edge, "information", 36, where);
  Matrix6d information;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c)
      information((r + 3) % 6, (c + 3) % 6) = v[static_cast<std::size_t>(c * 6 + r)];
  }
  const SoundInformation sound = nearest_information(0.5 * (information + information.transpose()));
  if (sound.flaw != InformationFlaw::kSound) problems.add_altered("information matrix repaired", where);
  return moved_information(sound.matrix, T_target_source);
}

void add_edge(const Json& json, const std::string& where, PoseGraph& graph, Problems& problems) {
  const std::size_t nodes = graph.nodes().size();
  const Key source = id_of(json, "source_node_id", nodes, where);
  const Key target = id_of(json, "target_node_id", nodes, where);
  if (source == target) {
    problems.add_altered("edge from a vertex to itself left out", where);
    return;
  }
  const Eigen::Isometry3d T = pose_in(json, "transformation", where, problems);
  graph.add_edge({target, source, T, information_of(json, T, where, problems)});
}

/// The number at the end of a name.
std::optional<Key> last_number(const std::string& stem) {
  std::size_t begin = stem.size();
  while (begin > 0 && std::isdigit(static_cast<unsigned char>(stem[begin - 1])) != 0) --begin;
  Key number = 0;
  if (begin == stem.size() || text::parse_id(std::string_view(stem).substr(begin), number) != nullptr)
    return std::nullopt;
  return number;
}

/// The pose graph of a folder. \throws InputError if there are several
fs::path graph_of_folder(const fs::path& folder) {
  fs::path found;
  for (const fs::path& entry : entries(folder)) {
    if (entry.extension() != ".json" || !fs::is_regular_file(entry)) continue;
    if (!looks_like_open3d(std::string_view(read_file(entry)).substr(0, 4096))) continue;
    if (!found.empty()) {
      throw InputError(folder.string() + ": " + found.filename().string() + " and " +
                       entry.filename().string() + " are both pose graphs of Open3D: give one of the files");
    }
    found = entry;
  }
  return found;
}

}  // namespace

bool looks_like_open3d(std::string_view beginning) {
  const std::size_t first = beginning.find_first_not_of(" \t\r\n");
  return first != std::string_view::npos && beginning[first] == '{' &&
         beginning.find("\"PoseGraph") != std::string_view::npos;
}

PoseGraph parse_open3d(std::string_view contents, const std::string& name, Problems& problems) {
  const Json json = parse_json(contents, name);
  if (!json.is_object() || json.value("class_name", Json()) != kGraphClass)
    throw InputError(name + ": class_name must be \"PoseGraph\"");
  for (const char* key : {"nodes", "edges"}) {
    if (!json.contains(key) || !json[key].is_array()) throw InputError(name + ": " + key + " must be a list");
  }
  if (json["nodes"].empty()) throw InputError(name + ": has no nodes");
  PoseGraph graph;
  Node node;
  for (const Json& entry : json["nodes"]) {
    node.pose = pose_in(entry, "pose", name + ": node " + std::to_string(node.key), problems);
    graph.add_node(node);
    ++node.key;
  }
  std::size_t number = 0;
  for (const Json& entry : json["edges"])
    add_edge(entry, name + ": edge " + std::to_string(number++), graph, problems);
  return graph;
}

Mission read_open3d(const fs::path& path, const MissionOptions& options) {
  const bool is_folder = fs::is_directory(path);
  const fs::path file = is_folder ? graph_of_folder(path) : path;
  Mission mission;
  mission.kind = MissionKind::kOpen3d;
  mission.path = path;
  mission.name = name_of(path);
  const PoseGraph graph = parse_open3d(read_file(file), file.string(), mission.problems);
  mission.robots = robots_of(graph, options, Robots({{"0", 0, graph.nodes().size() - 1}}));
  mission.problems.add("no stamps given", file.string());
  std::vector<PriorFactor> priors;
  complete_priors(graph, mission.robots, options, file.string(), priors, mission.problems);
  mission.graph = assemble(graph, regular_stamps(graph, mission.robots, options), priors, mission.robots,
                           options, mission.problems);
  check_stamps(mission);
  std::map<Key, fs::path> clouds;
  if (is_folder) {
    clouds = find_scans(path, last_number, mission.problems);
  }
  set_scans(mission, std::move(clouds), options);
  mission.provenance_json = provenance_of(mission.kind, {file.filename().string()});
  return mission;
}

}  // namespace loopwise::parts
