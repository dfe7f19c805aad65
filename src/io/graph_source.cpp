// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/graph_source.hpp>

#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/io/g2o.hpp>

#include "mission_parts.hpp"

namespace loopwise {

namespace fs = std::filesystem;

bool is_recording(const fs::path& path) {
  const fs::path ending = path.extension();
  return fs::is_directory(path) || ending == ".bag" || ending == ".db3" || ending == ".mcap" ||
         ending == ".zstd" || ending == ".zip" || ending == ".json";
}

fs::path graph_of_run(const fs::path& folder) {
  const fs::path graph = folder / "graph.g2o";
  return fs::exists(folder / "summary.json") && fs::exists(graph) ? graph : fs::path();
}

namespace {

/// \throws InputError if a key frame belongs to no robot: its odometry would count as closures
void require_robots(const PoseGraph& graph, const Robots& robots) {
  for (const Key key : graph.keys()) {
    if (!robots.find(key) && !parts::is_landmark_character(key_character(key)))
      throw InputError("robots: " + key_name(key) + " belongs to no robot; list the robots of all nodes");
  }
}

}  // namespace

SourceGraph read_graph(const fs::path& path, const MissionOptions& options, const ProgressCallback& progress,
                       const StopToken& stop) {
  const fs::path of_run = graph_of_run(path);
  if (of_run.empty() && is_recording(path)) {
    Mission mission = read_mission(path, options, progress, stop);
    return {std::move(mission.graph), std::move(mission.problems)};  // its edges have their kinds
  }
  MissionOptions classifying = options;
  // If the odometry of a run is not between neighbouring keys, a list of it is stored next to the graph.
  if (const fs::path list = of_run.parent_path() / "odometry.csv";
      !of_run.empty() && options.odometry.empty() && fs::exists(list))
    classifying.odometry = list.string();
  G2oFile file = read_g2o(of_run.empty() ? path : of_run);
  if (options.strict) require_unaltered(file.problems);
  const Robots robots =
      options.robots.empty() ? Robots::from_keys(file.graph.keys()) : parse_robots(options.robots);
  if (!options.robots.empty() && classifying.odometry.empty()) require_robots(file.graph, robots);
  const Problems of_kinds = classify_edges(file.graph, robots, classifying, file.without_information);
  SourceGraph out{std::move(file.graph), std::move(file.problems)};
  out.problems.add(of_kinds);
  return out;
}

}  // namespace loopwise
