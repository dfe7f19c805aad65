// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cctype>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/trajectory.hpp>

#include "g2o_text.hpp"
#include "information.hpp"
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

/// The text without a last line that has no line end: the program was stopped while it wrote that line,
/// perhaps within the last number. A single line is kept, because users may write a file of one pose by hand.
std::string complete_lines(std::string contents, const std::string& name, Problems& problems) {
  const std::size_t last = contents.rfind('\n') + 1;
  std::string_view line = std::string_view(contents).substr(last);
  if (last == 0 || text::next_word(line).empty()) return contents;
  const auto number = 1 + std::count(contents.begin(), contents.end(), '\n');
  problems.add_altered("unfinished last line left out", name + ":" + std::to_string(number));
  contents.resize(last);
  return contents;
}

bool is_blank_file(const std::string& contents) {
  return std::all_of(contents.begin(), contents.end(), [](char c) { return c == '\n' || text::is_blank(c); });
}

/// Empty if the file is missing or blank. A program that is stopped while it replaces the file leaves a blank
/// one.
std::optional<Poses> read_poses(const fs::path& file, Problems& problems) {
  if (!fs::is_regular_file(file)) return std::nullopt;
  const std::string contents = complete_lines(read_file(file), file.string(), problems);
  if (is_blank_file(contents)) {
    problems.add_altered("empty file not used", file.string());
    return std::nullopt;
  }
  Trajectory trajectory = parse_trajectory(contents, file.string(), TrajectoryFormat::kKitti);
  problems.add(trajectory.problems);
  return std::move(trajectory.poses);
}

Step step_between(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, const MissionOptions& options) {
  const Eigen::Isometry3d T = se3::normalized(a.inverse() * b);
  return {T, odometry_information(T, options)};
}

/// Stamps by row; empty if the file is missing or empty.
std::vector<std::int64_t> read_time_rows(const fs::path& file, Problems& problems) {
  std::vector<std::int64_t> stamps;
  if (!fs::is_regular_file(file)) return stamps;
  const std::string name = file.string(), contents = complete_lines(read_file(file), name, problems);
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view word = text::next_word(line);
    if (word.empty()) continue;
    const text::Place place{name, lines.number()};
    if (!text::next_word(line).empty()) place.fail("more than one value, expected the stamp in seconds");
    const auto stamp = text::parse_seconds_ns(word);
    if (!stamp || !stamp_in_range(*stamp)) place.fail(text::quoted(word) + " is not a stamp in seconds");
    stamps.push_back(*stamp);
  }
  return stamps;
}

/// Whether files with these numbers of rows may belong to one session that was stopped during saving.
bool may_belong_together(std::size_t a, std::size_t b) {
  return 2 * std::min(a, b) >= std::max(a, b);
}

/// The session's own graph, if its vertices are the rows of the poses.
std::optional<PoseGraph> read_session_graph(const fs::path& file, std::size_t rows,
                                            const MissionOptions& options, Problems& problems) {
  if (!fs::is_regular_file(file)) return std::nullopt;
  const std::string contents = read_file(file);
  if (is_blank_file(contents)) {
    problems.add_altered("empty file not used", file.string());
    return std::nullopt;
  }
  G2oFile session = parse_unfinished_g2o(contents, file.string());
  problems.add(session.problems);
  const std::vector<Key> keys = session.graph.keys();
  if (keys.empty()) {
    problems.add_altered("session graph not used", file.string() + ": it has no vertices yet");
    return std::nullopt;
  }
  if (!may_belong_together(keys.size(), rows) ||
      *std::max_element(keys.begin(), keys.end()) != keys.size() - 1) {
    problems.add_altered("session graph not used",
                         file.string() + ": its keys are not the row numbers of the poses file");
    return std::nullopt;
  }
  if (session.graph.planar()) {
    problems.add_altered("session graph not used", file.string() + ": it is 2D, but the session is 3D");
    return std::nullopt;
  }
  MissionOptions by_neighbours = options;
  by_neighbours.odometry.clear();  // the option is for the mission, which has other edges
  // Problems are counted where the steps of the graph are used.
  static_cast<void>(classify_edges(session.graph, Robots({{"0", 0, keys.size() - 1}}), by_neighbours,
                                   session.without_information));
  return std::move(session.graph);
}

/// Odometry steps (i, i+1) of the graph, in either direction. Of repeated steps, the first is used.
std::vector<std::optional<Step>> steps_of_graph(const PoseGraph& graph, std::size_t rows,
                                                const std::string& file, Problems& problems) {
  std::vector<std::optional<Step>> steps(rows - 1);
  for (const Edge& written : graph.edges()) {
    const Edge edge = written.from < written.to ? written : reversed(written);
    const std::string where =
        file + ": " + std::to_string(written.from) + " to " + std::to_string(written.to);
    if (edge.to != edge.from + 1) {
      problems.add("closure of the session's own graph left out", where);
    } else if (edge.to >= rows) {
      continue;  // the row is left out
    } else if (edge.kind != EdgeKind::kOdometry) {
      problems.add_altered("edge that contradicts the session's odometry left out", where);
    } else if (steps[edge.from]) {
      problems.add_altered("repeated odometry of the session's graph left out", where);
    } else {
      // Reversing the edge may have made its information indefinite by rounding.
      steps[edge.from] = Step{edge.T_from_to, nearest_information(edge.information).matrix};
    }
  }
  return steps;
}

/// Contents of the files of a session, which may have different lengths.
struct SessionFiles {
  std::optional<Poses> optimized;
  std::optional<Poses> odometry;
  std::vector<std::int64_t> stamps;  ///< Empty if not known.
  std::optional<PoseGraph> graph;    ///< Only where the odometry is missing.
};

constexpr const char* kOptimized = "optimized_poses.txt";
constexpr const char* kOdometryPoses = "odom_poses.txt";
constexpr const char* kTimes = "times.txt";
constexpr const char* kSessionGraph = "singlesession_posegraph.g2o";

SessionFiles read_files(const fs::path& folder, const MissionOptions& options, Problems& problems) {
  SessionFiles session;
  session.optimized = read_poses(folder / kOptimized, problems);
  session.odometry = read_poses(folder / kOdometryPoses, problems);
  if (!session.optimized && !session.odometry) {
    const fs::path file = folder / (fs::is_regular_file(folder / kOptimized) ? kOptimized : kOdometryPoses);
    throw InputError(file.string() + ": has no poses: the session was stopped before its poses were saved");
  }
  session.stamps = read_time_rows(folder / kTimes, problems);
  if (!session.odometry)
    session.graph = read_session_graph(folder / kSessionGraph, session.optimized->size(), options, problems);
  return session;
}

/// Numbers of rows in the files of a session. They differ by a few rows if the program was stopped.
struct Rows {
  std::size_t common;  ///< Rows that all files have.
  std::size_t most;    ///< Rows of the longest file.
};
Rows count_rows(const SessionFiles& session, const fs::path& folder, Problems& problems) {
  std::vector<std::pair<std::string, std::size_t>> files;
  const auto add = [&](const char* name, std::size_t rows) {
    if (rows > 0) files.emplace_back((folder / name).string(), rows);
  };
  add(kOptimized, session.optimized ? session.optimized->size() : 0);
  add(kOdometryPoses, session.odometry ? session.odometry->size() : 0);
  add(kTimes, session.stamps.size());
  add(kSessionGraph, session.graph ? session.graph->nodes().size() : 0);
  const auto [least, most] = std::minmax_element(
      files.begin(), files.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  if (!may_belong_together(least->second, most->second)) {
    throw InputError(least->first + " has " + std::to_string(least->second) + " rows, " + most->first +
                     " has " + std::to_string(most->second) + ": they do not belong to the same session");
  }
  const std::size_t rows = least->second;
  for (const auto& [file, count] : files) {
    problems.add_altered(
        "row beyond the common part left out",
        file + " has " + std::to_string(count) + " rows, the common part " + std::to_string(rows),
        count - rows);
  }
  return {rows, most->second};
}

std::vector<Step> odometry_steps(const SessionFiles& session, std::size_t rows, const fs::path& folder,
                                 const MissionOptions& options, Problems& problems) {
  const Poses& poses = session.odometry ? *session.odometry : *session.optimized;
  const std::string own_graph = (folder / kSessionGraph).string();
  std::vector<std::optional<Step>> given(rows - 1);
  if (session.graph) given = steps_of_graph(*session.graph, rows, own_graph, problems);
  const bool any_given =
      std::any_of(given.begin(), given.end(), [](const auto& step) { return step.has_value(); });
  if (!session.odometry && !any_given) {
    problems.add("odometry taken from the optimised poses",
                 (folder / kOptimized).string() + ": it has no drift; --odometry-noise adds some");
  }
  std::vector<Step> steps;
  for (std::size_t i = 0; i + 1 < rows; ++i) {
    if (given[i]) {
      steps.push_back(*given[i]);
      continue;
    }
    if (any_given) {
      problems.add_altered("odometry missing in the session's graph",
                           own_graph + ": " + std::to_string(i) + " to " + std::to_string(i + 1));
    }
    steps.push_back(step_between(poses[i], poses[i + 1], options));
  }
  return steps;
}

/// A graph of nodes with poses that follow odometry from `first`, which is the first optimised pose if there
/// is one.
PoseGraph chained(const Eigen::Isometry3d& first, const std::vector<Step>& steps, const std::string& name) {
  PoseGraph graph;
  Node node;
  node.pose = first;
  try {
    graph.add_node(node);
    for (std::size_t i = 0; i < steps.size(); ++i) {
      node.key = i + 1;
      node.pose = se3::normalized(node.pose * steps[i].T_from_to);
      graph.add_node(node);
      graph.add_edge({i, i + 1, steps[i].T_from_to, steps[i].information});
    }
  } catch (const InputError& error) {
    throw InputError(name + ": " + error.what());
  }
  return graph;
}

/// The row in a name: 12 for "000012".
std::optional<Key> row_of(const std::string& stem) {
  Key row = 0;
  const bool digits =
      !stem.empty() && std::all_of(stem.begin(), stem.end(), [](unsigned char c) { return std::isdigit(c); });
  if (!digits || text::parse_id(stem, row) != nullptr) return std::nullopt;
  return row;
}

/// Scans by row. If a program counts from 1, the last number equals the number of saved rows.
std::map<Key, fs::path> scans_by_row(std::map<Key, fs::path> scans, std::size_t saved_rows,
                                     Problems& problems) {
  if (scans.empty() || scans.begin()->first != 1) return scans;
  const std::string first = scans.begin()->second.string();
  if (scans.rbegin()->first != saved_rows) {
    problems.add("scans may be counted from 1", first + ": the first scan, used for row 1");
    return scans;
  }
  problems.add_altered("scans are counted from 1", first + ": the first scan, used for row 0");
  std::map<Key, fs::path> shifted;
  for (auto& [number, file] : scans) shifted.emplace(number - 1, std::move(file));
  return shifted;
}

}  // namespace

Mission read_session(const fs::path& folder, const MissionOptions& options) {
  Mission mission;
  mission.kind = MissionKind::kSession;
  mission.path = folder;
  mission.name = name_of(folder);

  const SessionFiles session = read_files(folder, options, mission.problems);
  const auto [rows, saved_rows] = count_rows(session, folder, mission.problems);

  const std::vector<Step> steps = odometry_steps(session, rows, folder, options, mission.problems);
  const PoseGraph graph = chained(session.optimized ? session.optimized->front() : session.odometry->front(),
                                  steps, folder.string());

  mission.robots = robots_of(graph, options, Robots({{"0", 0, rows - 1}}));
  Stamps stamps;
  for (std::size_t i = 0; i < std::min(rows, session.stamps.size()); ++i)
    stamps.emplace(i, session.stamps[i]);
  if (stamps.empty()) {
    mission.problems.add("no stamps given", (folder / kTimes).string());
    stamps = regular_stamps(graph, mission.robots, options);
  }
  mission.graph =
      assemble(graph, stamps, {default_prior(graph, 0, options)}, mission.robots, options, mission.problems);
  check_stamps(mission);

  if (session.optimized) {
    for (std::size_t i = 0; i < rows; ++i) mission.reference.emplace(i, (*session.optimized)[i]);
  }
  fs::path folder_of_scans = folder / "Scans";
  if (!fs::is_directory(folder_of_scans)) folder_of_scans = folder / "scans";
  auto scans =
      scans_by_row(find_scans(folder_of_scans, row_of, mission.problems), saved_rows, mission.problems);
  set_scans(mission, std::move(scans), options);
  return mission;
}

}  // namespace loopwise::parts
