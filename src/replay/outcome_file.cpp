// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/outcome_file.hpp>

#include <algorithm>
#include <new>
#include <sstream>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/code_version.hpp>

namespace loopwise {
namespace {

/// Describes how two fingerprints differ, for messages: "replay.method was "obs"", "another mission".
std::string difference(const std::string& before, const std::string& now) {
  const Json b = parse_json(now, "this run");
  const Json a = [&before] {
    try {
      return parse_json(before, "the run to resume");
    } catch (const InputError&) {
      return Json();
    }
  }();
  const auto same = [&](const char* name) { return a.contains(name) && a[name] == b[name]; };
  if (!a.is_object() || !a.contains("options") || !same("code")) return "another version of the program";
  if (!same("mission") || !same("graph") || !same("scans")) return "another mission";
  const Json was = a["options"].flatten(), is = b["options"].flatten();
  for (const auto& [pointer, value] : is.items()) {
    if (was.contains(pointer) && was[pointer] == value) continue;
    std::string name = pointer.substr(1);
    std::replace(name.begin(), name.end(), '/', '.');
    return "other options: " + name + " was " + (was.contains(pointer) ? was[pointer].dump() : "absent");
  }
  if (!same("content")) return "other content of graph_information.gnn_weights or of replay.decisions";
  return "other options";
}

ContentHash hash_of(const PoseGraph& graph) {
  ContentHasher hasher;
  const auto add_pose = [&hasher](const Eigen::Isometry3d& pose) {
    for (const double value : pose.matrix().reshaped()) hasher.number(value);
  };
  for (const Node& node : graph.nodes()) {
    hasher.integer(node.key).integer(static_cast<std::uint64_t>(node.stamp_ns));
    add_pose(node.pose);
  }
  for (const Edge& edge : graph.edges()) {
    hasher.integer(edge.from).integer(edge.to);
    add_pose(edge.T_from_to);
  }
  return hasher.finish();
}

/// Starts the file with the outcomes of the run to resume.
KeptOutcomes started(const std::filesystem::path& path, const std::string& fingerprint, bool resume) {
  KeptOutcomes kept;
  if (resume && std::filesystem::exists(path))
    kept = parse_outcomes(read_file(path), fingerprint, path.string());
  write_file(path, fingerprint + "\n" + kept.lines);
  kept.lines.clear();
  return kept;
}

}  // namespace

std::string run_fingerprint(const Mission& mission, const Config& config) {
  Json json = Json::object();
  json["mission"] = mission.name;
  json["graph"] = to_string(hash_of(mission.graph));
  json["scans"] = mission.scans->size();
  json["options"] = parse_json(config_json(config), "options");
  json["content"] = to_string(ContentHasher().text(config_key(config)).finish());
  json["code"] = replay_code_version();
  return json_text(json);
}

KeptOutcomes parse_outcomes(const std::string& contents, const std::string& fingerprint,
                            const std::string& name) {
  KeptOutcomes kept;
  std::istringstream lines(contents);
  std::string line;
  if (std::getline(lines, line) && line != fingerprint && !lines.eof())
    throw OptionError(name + ": the run to resume had " + difference(line, fingerprint));
  for (std::size_t number = 2; std::getline(lines, line); ++number) {
    if (lines.eof()) break;  // the process was killed while it wrote this line
    if (line.find('\0') != std::string::npos) {
      ++kept.lost;
      continue;
    }
    const RegistrationResult result = [&] {
      try {
        return parse_outcome_line(line);
      } catch (const InputError& error) {
        throw ParseError(name, number, error.what());
      }
    }();
    if (depends_on_circumstances(result)) continue;  // it is computed again and may succeed
    kept.known[{result.candidate.from, result.candidate.to}] = result;
    kept.lines += line + "\n";
  }
  if (lines.bad()) throw std::bad_alloc();  // streams hide bad_alloc
  return kept;
}

OutcomeFile::OutcomeFile(const std::filesystem::path& path, const std::string& fingerprint, bool resume)
    : kept_(started(path, fingerprint, resume)), log_(path, LineLog::Mode::kAppend) {}

void OutcomeFile::add(const RegistrationResult& result) {
  log_.add(outcome_line(result));
}

}  // namespace loopwise
