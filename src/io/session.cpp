// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cctype>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/trajectory.hpp>

#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

using Poses = std::vector<Eigen::Isometry3d>;

struct Step {
  Eigen::Isometry3d T_from_to;
  Matrix6d information;
};

Poses read_poses(const fs::path& file, Problems& problems) {
  Trajectory trajectory = read_trajectory(file, TrajectoryFormat::kKitti);
  problems.add(trajectory.problems);
  return std::move(trajectory.poses);
}

Step step_between(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, const MissionOptions& options) {
  const Eigen::Isometry3d T = se3::normalized(a.inverse() * b);
  return {T, odometry_information(T, options)};
}

/// The steps (i, i+1) that the graph holds, the first of each; nothing where its keys are not the rows.
std::vector<std::optional<Step>> steps_of_graph(const fs::path& file, std::size_t rows, Problems& problems) {
  const G2oFile session = read_g2o(file);
  problems.add(session.problems);
  std::vector<std::optional<Step>> steps(rows - 1);
  const std::vector<Key> keys = session.graph.keys();
  if (keys.size() != rows || *std::max_element(keys.begin(), keys.end()) != rows - 1) {
    problems.add("session graph not used", file.string() + ": its keys are not the rows of the poses file");
    return steps;
  }
  for (const Edge& edge : session.graph.edges()) {
    if (edge.to == edge.from + 1 && !steps[edge.from]) {
      steps[edge.from] = Step{edge.T_from_to, edge.information};
    } else {
      problems.add("closure of the session's own graph left out",
                   file.string() + ": " + std::to_string(edge.from) + " to " + std::to_string(edge.to));
    }
  }
  return steps;
}

std::vector<Step> odometry_steps(const fs::path& folder, const std::optional<Poses>& optimized,
                                 const std::optional<Poses>& odometry, const MissionOptions& options,
                                 Problems& problems) {
  const Poses& poses = odometry ? *odometry : *optimized;
  std::vector<std::optional<Step>> given(poses.size() - 1);
  const fs::path own_graph = folder / "singlesession_posegraph.g2o";
  const bool use_graph = !odometry && fs::is_regular_file(own_graph);
  if (use_graph) given = steps_of_graph(own_graph, poses.size(), problems);
  const bool any_given =
      std::any_of(given.begin(), given.end(), [](const auto& step) { return step.has_value(); });
  if (!odometry && !any_given) {
    problems.add(
        "odometry and truth are the same poses",
        (folder / "optimized_poses.txt").string() + ": without drift of its own, see --odometry-noise");
  }
  std::vector<Step> steps;
  for (std::size_t i = 0; i + 1 < poses.size(); ++i) {
    if (given[i]) {
      steps.push_back(*given[i]);
      continue;
    }
    if (any_given) {
      problems.add("odometry missing in the session's graph",
                   own_graph.string() + ": " + std::to_string(i) + " to " + std::to_string(i + 1));
    }
    steps.push_back(step_between(poses[i], poses[i + 1], options));
  }
  return steps;
}

Stamps read_times(const fs::path& file, std::size_t rows) {
  const std::string name = file.string(), contents = read_file(file);
  Stamps stamps;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view word = text::next_word(line);
    if (word.empty()) continue;
    const text::Place place{name, lines.number()};
    if (!text::next_word(line).empty()) place.fail("more than one value, expected the stamp in seconds");
    const auto stamp = text::parse_seconds_ns(word);
    if (!stamp || !stamp_in_range(*stamp)) place.fail(text::quoted(word) + " is no stamp in seconds");
    stamps.emplace(stamps.size(), *stamp);
  }
  if (stamps.size() != rows) {
    throw InputError(name + ": " + std::to_string(stamps.size()) + " stamps for " + std::to_string(rows) +
                     " poses");
  }
  return stamps;
}

/// "000012" is row 12.
std::optional<Key> row_of(const std::string& stem) {
  Key row = 0;
  const bool digits =
      !stem.empty() && std::all_of(stem.begin(), stem.end(), [](unsigned char c) { return std::isdigit(c); });
  if (!digits || text::parse_id(stem, row) != nullptr) return std::nullopt;
  return row;
}

}  // namespace

Mission read_session(const fs::path& folder, const MissionOptions& options) {
  Mission mission;
  mission.kind = MissionKind::kSession;
  mission.path = folder;
  mission.name = name_of(folder);

  const fs::path optimized_file = folder / "optimized_poses.txt", odometry_file = folder / "odom_poses.txt";
  std::optional<Poses> optimized, odometry;
  if (fs::is_regular_file(optimized_file)) optimized = read_poses(optimized_file, mission.problems);
  if (fs::is_regular_file(odometry_file)) odometry = read_poses(odometry_file, mission.problems);
  if (optimized && odometry && optimized->size() != odometry->size()) {
    throw InputError(optimized_file.string() + " has " + std::to_string(optimized->size()) + " poses, " +
                     odometry_file.string() + " has " + std::to_string(odometry->size()) + " poses");
  }

  // Nodes stand where odometry takes them from the first pose, which the truth knows better if there is one.
  const std::vector<Step> steps = odometry_steps(folder, optimized, odometry, options, mission.problems);
  PoseGraph graph;
  Node node;
  node.pose = optimized ? optimized->front() : odometry->front();
  graph.add_node(node);
  for (std::size_t i = 0; i < steps.size(); ++i) {
    node.key = i + 1;
    node.pose = se3::normalized(node.pose * steps[i].T_from_to);
    graph.add_node(node);
    graph.add_edge({i, i + 1, steps[i].T_from_to, steps[i].information});
  }

  const Key last = graph.nodes().size() - 1;
  mission.robots = robots_of(graph, options, Robots({{"0", 0, last}}));
  const fs::path times = folder / "times.txt";
  Stamps stamps;
  if (fs::is_regular_file(times)) {
    stamps = read_times(times, graph.nodes().size());
  } else {
    mission.problems.add("no stamps given", times.string());
    stamps = regular_stamps(graph, mission.robots, options);
  }
  mission.graph = assemble(graph, stamps, {default_prior(graph, 0, options)}, mission.robots);
  mission.problems.add("no prior given", folder.string() + ": the first node gets one");
  check_stamps(mission);

  if (optimized) {
    std::map<Key, Eigen::Isometry3d> truth;
    for (std::size_t i = 0; i < optimized->size(); ++i) truth.emplace(i, (*optimized)[i]);
    set_ground_truth(mission, std::move(truth));
  }
  fs::path scans = folder / "Scans";
  if (!fs::is_directory(scans)) scans = folder / "scans";
  set_scans(mission, find_scans(scans, row_of, mission.problems), options);
  return mission;
}

}  // namespace loopwise::parts
