// SPDX-License-Identifier: BSD-3-Clause
// Consistency of maps without ground truth.
#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/io/mission.hpp>

#include "evaluate_map.hpp"

namespace loopwise::cli {
namespace {

PosesByKey poses_of(const Mission& mission) {
  PosesByKey poses;
  for (const Node& node : mission.graph.nodes()) poses[node.key] = node.pose;
  return poses;
}

Revisits closures_of(const Mission& run) {
  Revisits closures;
  for (const Edge& edge : run.graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) closures.emplace_back(edge.from, edge.to);
  }
  return closures;
}

/// Formats a number; a rounded zero has no sign.
std::string signed_text(double value, int digits) {
  const std::string text = fixed(value, digits);
  const bool is_zero = text.find_first_not_of("-0.") == std::string::npos;
  return is_zero ? fixed(0.0, digits) : text;
}

std::string line_of(const char* what, const Displacement& d) {
  return std::string(what) + fixed(d.mean_m, 3) + " m in the mean, median " + fixed(d.median_m, 3) +
         ", worst tenth above " + fixed(d.worst_tenth_m, 3) + "\n";
}

/// Mean and, if it is known, the interval of a difference.
std::string difference_text(bool enough, const PairedComparison& difference) {
  std::string text = signed_text(difference.mean_difference, 3) + " m";
  if (enough) {
    text += ", 95 % interval " + signed_text(difference.difference.low, 3) + " to " +
            signed_text(difference.difference.high, 3);
  }
  return text;
}

std::string near_text(const MapQuality& q) {
  if (q.near.pairs == 0) return "";
  const auto near = [](const NearPairs& n) {
    return std::to_string(n.proven) + " of " + std::to_string(n.pairs) +
           (n.proven > 0 ? ", " + fixed(n.median_m, 3) + " m off in the median" : "");
  };
  return "near         pairs that the estimate alone puts within 3 m and that are proven: " + near(q.near) +
         (q.near_between_robots.pairs > 0 ? "; of two robots " + near(q.near_between_robots) : "") + "\n";
}

std::string text_of(const MapQuality& q) {
  if (q.revisits.empty()) return "not meaningful: " + q.not_meaningful() + "\n" + near_text(q);
  std::string text = "revisits     " + std::to_string(q.revisits.size()) + " of " + std::to_string(q.pairs) +
                     " pairs of nodes, proven by registration, at " + std::to_string(q.stretches) +
                     " pairs of stretches of path, on " + fixed(100.0 * q.coverage, 0) +
                     " % of the path\ndisplacement of the poses from the registrations:\n";
  text += line_of("  recording  ", q.before) + line_of("  estimate   ", q.after);
  text += "difference   " + difference_text(q.enough(), q.difference) + "\n";
  if (q.planes == 0) {
    text += "thickness    not known: no plane has enough points of both scans\n";
  } else {
    text += "thickness    of surfaces that both scans saw (" + std::to_string(q.planes) +
            " planes): " + fixed(q.thickness_before.mean_m, 3) + " m by the recording, " +
            fixed(q.thickness_after.mean_m, 3) + " m by the estimate, " +
            fixed(q.thickness_registered.mean_m, 3) + " m by the registrations; difference " +
            difference_text(q.enough_planes(), q.thickness_difference) + "\n";
  }
  text += "on surfaces  " + fixed(100.0 * q.share_before, 1) +
          " % of points within 0.12 m of the other scan by the recording's poses, " +
          fixed(100.0 * q.share_after, 1) + " % by the estimate's; " + fixed(100.0 * q.share_registered, 1) +
          " % by the registrations, an upper bound\n";
  return text + near_text(q);
}

/// Warns if the figures are unreliable or indicate a wrong map.
void warn_of_weakness(const MapQuality& q, Console& console) {
  if (!q.revisits.empty() && !q.enough()) console.warn("not meaningful: " + q.not_meaningful());
  // In a correct map most pairs are proven, with a median distance of centimetres.
  constexpr std::size_t kSome = 10;
  constexpr double kFewProven = 0.2, kFar_m = 1.0;
  const auto is_wrong = [](const NearPairs& near) {
    const bool few = static_cast<double>(near.proven) < kFewProven * static_cast<double>(near.pairs);
    return near.pairs >= kSome && (few || near.median_m > kFar_m);
  };
  if (is_wrong(q.near_between_robots)) {
    console.warn(
        "registrations contradict the estimate at places that several robots visit: the frames of the robots "
        "may be wrong");
  } else if (is_wrong(q.near)) {
    console.warn(
        "registrations contradict the estimate at places that are visited twice: its poses may be wrong");
  }
}

/// Warns if the run started from other odometry than that of the recording.
void warn_of_noise(const std::string& estimate, const std::string& recording, Console& console) {
  if (graph_of_run(estimate).empty()) return;
  const Json summary = read_json_file(std::filesystem::path(estimate) / "summary.json");
  for (const char* name : {"odometry_noise_m_per_m", "odometry_noise_rad_per_m"}) {
    const Json::json_pointer path(std::string("/options/replay/") + name);
    if (!summary.contains(path) || !summary.at(path).is_number() || summary.at(path) == 0.0) continue;
    console.warn("the run added noise to the odometry of " + recording +
                 ": the recording's figures are without it");
    return;
  }
}

/// Adds the quality to the summary of a run, where reports find it.
void keep(const std::string& estimate, const Mission& mission, const MapQuality& quality, Console& console) {
  if (graph_of_run(estimate).empty()) return;
  const std::filesystem::path file = std::filesystem::path(estimate) / "summary.json";
  try {
    const Json summary = read_json_file(file);
    const std::string name = summary.is_object() && summary.value("mission", Json()).is_string()
                                 ? summary["mission"].get<std::string>()
                                 : "";
    if (name != mission.name) {
      console.warn(file.string() + ": the quality is not added, because the run is of the mission \"" + name +
                   "\", not of \"" + mission.name + "\"");
      return;
    }
    keep_map_quality(estimate, quality);
    console.note("kept as map_quality in " + file.string() + ", for loopwise report");
  } catch (const Error& error) {
    console.warn(std::string("not kept for loopwise report: ") + error.what());
  }
}

}  // namespace

int evaluate_map(const CommonOptions& common, const std::string& estimate, const std::string& recording,
                 const std::string& robots) {
  Console console(common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(common);
  if (!robots.empty()) config.mission.robots = robots;
  const Mission mission =
      read_mission(recording, config.mission, console.progress_callback(), interrupt.token());
  const Mission run = read_mission(estimate, config.mission, console.progress_callback(), interrupt.token());
  console.warn(mission.problems);
  // Both maps are judged at the same revisits, i.e. those between common nodes.
  const PosesByKey after = poses_of(run);
  PosesByKey before;
  for (const auto& [key, pose] : poses_of(mission)) {
    if (after.count(key) != 0) before.emplace(key, pose);
  }
  if (before.empty()) throw InputError(estimate + ": has no node of " + recording);
  ThreadPool pool(thread_count(common));
  const MapQuality quality = map_quality(mission, before, after, closures_of(run), config.replay, pool,
                                         interrupt.token(), console.progress_callback());
  if (interrupt.interrupted()) return kInterrupted;
  console.warn(mission.scans->problems());
  print_results(common, parse_json(map_quality_json(quality), "map quality"), text_of(quality));
  warn_of_weakness(quality, console);
  warn_of_noise(estimate, recording, console);
  keep(estimate, mission, quality, console);
  return kDone;
}

}  // namespace loopwise::cli
