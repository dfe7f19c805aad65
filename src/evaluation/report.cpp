// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/report.hpp>

#include <algorithm>
#include <cmath>
#include <iomanip>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <tuple>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/version.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/config.hpp>

#include "../core/constants.hpp"
#include "judged_run.hpp"
#include "report_arrays.hpp"
#include "report_parts.hpp"
#include "report_paths.hpp"
#include "report_review.hpp"
#include "run_closures.hpp"
#include "run_journal.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHistoryRows = 2000;

// One run.

/// Data that a mission adds to its runs, computed once.
struct MissionView {
  const Mission* mission = nullptr;
  bool used = false;
  std::map<Key, double> observability;  ///< λ_min divided by the largest, for nodes with a scan.
};

std::map<Key, double> observability_of(const Mission& mission, const FeatureOptions& options,
                                       ThreadPool& threads, const ProgressCallback& progress) {
  const std::vector<Key> keys = mission.scans->keys();
  std::vector<double> values(keys.size(), kNan);
  FeatureCache features(mission.scans->loader(), options);
  constexpr std::size_t kChunk = 64;
  for (std::size_t begin = 0; begin < keys.size(); begin += kChunk) {
    const std::size_t count = std::min(kChunk, keys.size() - begin);
    threads.for_each(count, [&](std::size_t i) {
      try {
        if (const auto scan = features.get(keys[begin + i]))
          values[begin + i] = scan->observability.min_eigenvalue;
      } catch (const Error&) {
        // A broken scan has no observability; the mission's reader names it.
      }
    });
    if (progress) progress({"reading scans", begin + count, keys.size(), ""});
  }
  double largest = 0.0;
  for (const double value : values) {
    if (value > largest) largest = value;
  }
  std::map<Key, double> scores;
  for (std::size_t i = 0; i < keys.size() && largest > 0.0; ++i) {
    if (std::isfinite(values[i])) scores[keys[i]] = values[i] / largest;
  }
  return scores;
}

/// a - b; the integers may be too small for the difference.
double difference_ns(std::int64_t a, std::int64_t b) {
  const auto x = static_cast<std::uint64_t>(a), y = static_cast<std::uint64_t>(b);
  return a >= b ? static_cast<double>(x - y) : -static_cast<double>(y - x);
}

/// A column of the table of nodes; NaN stands for an unknown value.
struct NodeColumn {
  std::vector<float> values;
  bool any = false;  ///< Whether a value is known.

  void add(std::optional<float> value) {
    values.push_back(value.value_or(std::numeric_limits<float>::quiet_NaN()));
    any = any || value.has_value();
  }
  /// Three values.
  void add(const std::optional<Eigen::Vector3d>& position) {
    for (int axis = 0; axis < 3; ++axis)
      add(position ? std::optional(static_cast<float>((*position)[axis])) : std::nullopt);
  }
  [[nodiscard]] Json json() const { return any ? Json(base64(values)) : Json(nullptr); }
};

struct NodeColumns {
  Eigen::Vector3d
      origin;  ///< Of all positions, because a float resolves no centimetres in world coordinates.
  std::int64_t start_ns = 0;
  NodeColumn optimized, odometry, truth, reference, time_s, observability;

  void add(const PoseGraph& graph, const RobotPath& robot, std::size_t i, const MissionView* view) {
    const Key key = robot.keys[i];
    optimized.add(relative(graph.node(key).pose));
    odometry.add(robot.odometry.empty() ? std::nullopt : relative(robot.odometry[i]));
    time_s.add(robot.stamps_ns.empty()
                   ? std::nullopt
                   : std::optional(static_cast<float>(difference_ns(robot.stamps_ns[i], start_ns) * 1e-9)));
    if (view == nullptr) return;
    const auto known = [&](const PosesByKey& poses) {
      const auto found = poses.find(key);
      return found != poses.end() ? relative(found->second) : std::nullopt;
    };
    truth.add(known(view->mission->ground_truth));
    reference.add(known(view->mission->reference));
    const auto score = view->observability.find(key);
    observability.add(score != view->observability.end() ? std::optional(static_cast<float>(score->second))
                                                         : std::nullopt);
  }

 private:
  [[nodiscard]] std::optional<Eigen::Vector3d> relative(const Eigen::Isometry3d& pose) const {
    return Eigen::Vector3d(pose.translation() - origin);
  }
};

/// The mission's start if it is known, otherwise the first stamp.
std::int64_t start_of(const std::vector<RobotPath>& robots, const MissionView* view) {
  if (view != nullptr) return view->mission->start_ns;
  std::int64_t start_ns = std::numeric_limits<std::int64_t>::max();
  for (const RobotPath& robot : robots) {
    for (const std::int64_t stamp : robot.stamps_ns) start_ns = std::min(start_ns, stamp);
  }
  return start_ns;
}

std::string name_of(const RobotPath& robot, const MissionView* view) {
  if (view == nullptr || robot.keys.empty()) return robot.name;
  const auto known = view->mission->robots.find(robot.keys.front());
  return known ? view->mission->robots[*known].name : robot.name;
}

class RunReader {
 public:
  RunReader(fs::path folder, const ReportOptions& options)
      : folder_(std::move(folder)), options_(options), summary_(read_json_file(folder_ / "summary.json")) {
    if (!summary_.is_object()) throw InputError((folder_ / "summary.json").string() + ": not an object");
    if (summary_.contains("mission") && summary_["mission"].is_string())
      mission_name_ = summary_["mission"].get<std::string>();
    has_closures_ = fs::exists(folder_ / "closures.csv");
    if (has_closures_) rows_ = read_run_closures(folder_ / "closures.csv");
  }

  [[nodiscard]] const std::string& mission_name() const { return mission_name_; }
  [[nodiscard]] const Json& summary() const { return summary_; }

  /// Evaluates the run with the mission if this has data that the run did not have.
  void judge(const Mission* mission) { is_judged_anew_ = judge_run(folder_, mission, summary_, notes_); }

  void note(const std::string& text) { notes_.push_back(text); }
  [[nodiscard]] const std::vector<std::string>& notes() const { return notes_; }

  /// A section of the run's options; defaults if this version does not know them.
  template <class Options>
  [[nodiscard]] Options section(const char* name) const {
    Options options;
    if (!summary_.contains("options") || !summary_["options"].is_object()) return options;
    const Json& all = summary_["options"];
    if (!all.contains(name)) return options;
    try {
      apply_json(all[name], name, options);
    } catch (const OptionError&) {
      return Options();
    }
    return options;
  }

  [[nodiscard]] Json history() {
    const fs::path path = folder_ / "history.csv";
    Json columns = Json::object();
    if (fs::exists(path)) {
      const std::vector<std::string> names = csv_header(path);
      const CsvTable table(path, names);
      const std::size_t stride = std::max<std::size_t>(1, (table.size() + kHistoryRows - 1) / kHistoryRows);
      for (std::size_t c = 0; c < names.size(); ++c) {
        if (is_judged_anew_ && is_judgement(names[c])) continue;
        Json values = Json::array();
        for (std::size_t r = 0; r < table.size(); ++r) {
          if (r % stride == 0 || r + 1 == table.size()) values.push_back(csv_cell(table.text(r, c)));
        }
        columns[names[c]] = values;
      }
      return {{"source", "history.csv"}, {"columns", columns}};
    }
    if (!has_journal()) {
      note("no history.csv and no journal.jsonl: nothing over time");
      return nullptr;
    }
    note("no history.csv: closures over time are from journal.jsonl, errors over time are not known");
    return history_of_journal();
  }

  [[nodiscard]] Json scene(const MissionView* view) {
    if (!fs::exists(folder_ / "graph.g2o")) {
      note("no graph.g2o: no map");
      return nullptr;
    }
    const PoseGraph graph = read_g2o(folder_ / "graph.g2o").graph;
    const std::vector<RobotPath> robots = robot_paths(folder_, graph);
    std::map<Key, std::uint32_t> place;
    Json scene = Json::object();
    put_nodes(scene, graph, robots, view, place);
    put_points(scene, graph, robots, view);
    put_candidates(scene, place);
    put_radio(scene, view, place);
    scene["review"] = review(graph, robots, view, place);
    return scene;
  }

 private:
  [[nodiscard]] bool has_journal() const { return fs::exists(folder_ / "journal.jsonl"); }

  /// Read on the first call.
  [[nodiscard]] const RunJournal& journal() {
    if (!journal_) journal_ = read_run_journal(folder_ / "journal.jsonl");
    return *journal_;
  }

  [[nodiscard]] Json history_of_journal() {
    std::vector<double> verified;
    for (const RunClosure& row : rows_) {
      if (row.verified) verified.push_back(row.time_s);
    }
    std::sort(verified.begin(), verified.end());
    const auto& moments = journal().moments;
    const std::size_t stride = std::max<std::size_t>(1, (moments.size() + kHistoryRows - 1) / kHistoryRows);
    Json columns = {{"mission_time_s", Json::array()}, {"generated", Json::array()},
                    {"queued", Json::array()},         {"computed", Json::array()},
                    {"verified", Json::array()},       {"gnc_inliers", Json::array()}};
    for (std::size_t i = 0; i < moments.size(); ++i) {
      if (i % stride != 0 && i + 1 != moments.size()) continue;
      const auto seen = static_cast<std::uint64_t>(
          std::upper_bound(verified.begin(), verified.end(), moments[i].time_s) - verified.begin());
      columns["mission_time_s"].push_back(moments[i].time_s);
      columns["generated"].push_back(moments[i].generated);
      columns["queued"].push_back(moments[i].queued);
      columns["computed"].push_back(moments[i].computed);
      columns["verified"].push_back(seen);
      columns["gnc_inliers"].push_back(std::min(moments[i].inliers, seen));
    }
    return {{"source", "journal.jsonl"}, {"columns", columns}};
  }

  void put_nodes(Json& scene, const PoseGraph& graph, const std::vector<RobotPath>& robots,
                 const MissionView* view, std::map<Key, std::uint32_t>& place) {
    NodeColumns columns;
    columns.origin = map_origin(graph);
    columns.start_ns = start_of(robots, view);
    note_origin(columns.origin);
    Json names = Json::array(), begins = Json::array(), keys = Json::array();
    for (const RobotPath& robot : robots) {
      begins.push_back(place.size());
      names.push_back(name_of(robot, view));
      for (std::size_t i = 0; i < robot.keys.size(); ++i) {
        place.emplace(robot.keys[i], static_cast<std::uint32_t>(place.size()));
        keys.push_back(key_name(robot.keys[i]));
        columns.add(graph, robot, i, view);
      }
    }
    scene["robots"] = names;
    scene["nodes"] = {{"total", place.size()},
                      {"stride", std::max<std::size_t>(
                                     1, (place.size() + static_cast<std::size_t>(options_.layer_items) - 1) /
                                            static_cast<std::size_t>(options_.layer_items))},
                      {"begin", begins},
                      {"key", keys},
                      {"optimized", base64(columns.optimized.values)},
                      {"odometry", columns.odometry.json()},
                      {"truth", columns.truth.json()},
                      {"reference", columns.reference.json()},
                      {"time_s", columns.time_s.json()},
                      {"observability", columns.observability.json()}};
    if (!columns.odometry.any) note("no trajectories: robots are distinguished by their keys, no odometry");
    if (view == nullptr) {
      note("no mission given: no true paths, beacons, radio or observability (--mission MISSION)");
    } else {
      if (!columns.truth.any) note("the mission has no ground truth: no true paths (--truth FILE)");
      if (!columns.observability.any) note("the mission has no scans: no observability");
    }
  }

  void note_origin(const Eigen::Vector3d& origin) {
    if (origin.isZero(0.0)) return;
    std::ostringstream where;
    where << std::fixed << std::setprecision(0) << origin.transpose();
    note("positions in the map are relative to " + where.str() + " m");
  }

  /// Points coloured by the robot and the observability of the nearest node.
  void put_points(Json& scene, const PoseGraph& graph, const std::vector<RobotPath>& robots,
                  const MissionView* view) {
    scene["points"] = nullptr;
    if (!fs::exists(folder_ / "map.pcd")) {
      note("no map.pcd: no points");
      return;
    }
    PointCloud map = read_cloud(folder_ / "map.pcd").cloud;
    const Eigen::Vector3d origin = map_origin(graph);
    const Eigen::Vector3f shift = (map.origin - origin).cast<float>();
    for (Eigen::Vector3f& p : map.points) p += shift;
    std::vector<std::size_t> chosen = drawn(map.size(), options_.map_points, combine_seeds(options_.seed, 1));
    // A few far points would reduce the resolution of all others.
    Eigen::Vector3d low = Eigen::Vector3d::Zero(), high = Eigen::Vector3d::Zero();
    for (int axis = 0; axis < 3 && !chosen.empty(); ++axis) {
      std::vector<double> values;
      values.reserve(chosen.size());
      for (const std::size_t i : chosen) values.push_back(static_cast<double>(map.points[i][axis]));
      std::sort(values.begin(), values.end());
      const auto at = [&](double share) {
        return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
      };
      const double margin = 0.5 * (at(0.995) - at(0.005)) + 1.0;
      low[axis] = std::max(values.front(), at(0.005) - margin);
      high[axis] = std::min(values.back(), at(0.995) + margin);
    }
    const auto outside = [&](std::size_t i) {
      const Eigen::Array3d p = map.points[i].cast<double>();
      return (p < low.array()).any() || (p > high.array()).any();
    };
    chosen.erase(std::remove_if(chosen.begin(), chosen.end(), outside), chosen.end());
    const Eigen::Vector3d step = (high - low).cwiseMax(1e-3) / 65535.0;

    std::vector<Eigen::Vector3f> nodes;
    std::vector<std::uint8_t> owner;
    std::vector<double> scores;
    for (std::size_t robot = 0; robot < robots.size(); ++robot) {
      for (const Key key : robots[robot].keys) {
        nodes.emplace_back((graph.node(key).pose.translation() - origin).cast<float>());
        owner.push_back(static_cast<std::uint8_t>(std::min<std::size_t>(robot, 255)));
        const auto score =
            view != nullptr ? view->observability.find(key) : std::map<Key, double>::const_iterator();
        scores.push_back(view != nullptr && score != view->observability.end() ? score->second : kNan);
      }
    }
    const KdTree tree(nodes);
    std::vector<std::uint16_t> position;
    std::vector<std::uint8_t> robot, observability;
    for (const std::size_t i : chosen) {
      const Eigen::Vector3f& p = map.points[i];
      for (int axis = 0; axis < 3; ++axis) {
        const double q = std::round((static_cast<double>(p[axis]) - low[axis]) / step[axis]);
        position.push_back(static_cast<std::uint16_t>(std::clamp(q, 0.0, 65535.0)));
      }
      const auto nearest = tree.nearest(p);
      robot.push_back(nearest ? owner[nearest->index] : std::uint8_t{0});
      const double score = nearest ? scores[nearest->index] : kNan;
      observability.push_back(  // 255: unknown
          std::isfinite(score) ? static_cast<std::uint8_t>(std::lround(254.0 * std::clamp(score, 0.0, 1.0)))
                               : std::uint8_t{255});
    }
    scene["points"] = {{"total", map.size()},
                       {"drawn", chosen.size()},
                       {"low", {low[0], low[1], low[2]}},
                       {"step", {step[0], step[1], step[2]}},
                       {"position", base64(position)},
                       {"robot", base64(robot)},
                       {"observability", base64(observability)}};
  }

  using Pairs = std::vector<std::pair<Key, Key>>;

  /// Pairs with a node that is not in the graph are not drawn.
  [[nodiscard]] Json pair_layer(const Pairs& pairs, const std::map<Key, std::uint32_t>& place,
                                std::uint64_t stream) const {
    Pairs known;
    for (const auto& [from, to] : pairs) {
      if (place.count(from) != 0 && place.count(to) != 0) known.emplace_back(from, to);
    }
    std::vector<std::uint32_t> ends;
    const auto chosen = drawn(known.size(), options_.layer_items, combine_seeds(options_.seed, stream));
    for (const std::size_t i : chosen) {
      ends.push_back(place.at(known[i].first));
      ends.push_back(place.at(known[i].second));
    }
    return {{"total", pairs.size()}, {"drawn", chosen.size()}, {"ends", base64(ends)}};
  }

  [[nodiscard]] Json review(const PoseGraph& graph, const std::vector<RobotPath>& robots,
                            const MissionView* view, const std::map<Key, std::uint32_t>& place) const {
    if (view == nullptr) return nullptr;  // no scans; already noted
    std::map<Key, Eigen::Isometry3d> odometry;
    for (const RobotPath& robot : robots) {
      for (std::size_t i = 0; i < robot.odometry.size(); ++i) odometry[robot.keys[i]] = robot.odometry[i];
    }
    std::vector<ReviewedClosure> closures;
    for (const RunClosure& row : rows_) {
      if (row.verified)
        closures.push_back({row.from, row.to, row.T_from_to, row.weight, row.overlap, row.time_s});
    }
    return review_json(std::move(closures), {graph, odometry, place, *view->mission}, options_);
  }

  void put_candidates(Json& scene, const std::map<Key, std::uint32_t>& place) {
    Json layers = Json::object();
    if (has_closures_) {
      Pairs rejected, kept, outliers;
      for (const RunClosure& row : rows_) {
        Pairs& to = !row.verified                                          ? rejected
                    : row.weight > ClosureClassOptions().gnc_inlier_weight ? kept
                                                                           : outliers;
        to.emplace_back(row.from, row.to);
      }
      layers["kept"] = pair_layer(kept, place, 2);
      layers["outlier"] = pair_layer(outliers, place, 3);
      layers["rejected"] = pair_layer(rejected, place, 4);
    } else {
      note("no closures.csv: no outcomes of candidates");
    }
    if (has_journal()) {
      layers["selected"] = pair_layer(journal().candidates, place, 5);
    } else {
      note("no journal.jsonl: which candidates were selected is not known");
    }
    scene["candidates"] = layers;
  }

  /// Beacons at the nodes where they were dropped, links from each node in reach, and the passes: runs of
  /// such nodes of one robot.
  void put_radio(Json& scene, const MissionView* view, const std::map<Key, std::uint32_t>& place) {
    scene["beacons"] = nullptr;
    if (view == nullptr) return;
    const Mission& mission = *view->mission;
    if (mission.beacons.empty()) {
      note("the mission has no radio beacons");
      return;
    }
    const auto options = section<RadioOptions>("radio");
    Json beacons = Json::array();
    std::map<std::string, std::uint32_t> at;
    for (const BeaconDrop& beacon : mission.beacons) {
      const auto found = place.find(beacon.drop_key);
      if (found == place.end()) continue;
      at.emplace(beacon.beacon, found->second);
      beacons.push_back({{"name", beacon.beacon}, {"node", found->second}});
    }
    std::map<std::pair<std::string, Key>, std::vector<RadioReading>> readings;
    for (const RadioReading& reading : mission.radio)
      readings[{reading.beacon, reading.key}].push_back(reading);
    std::vector<std::pair<std::uint32_t, std::uint32_t>> links;  // node, node of the beacon
    std::size_t passes = 0;
    std::tuple<std::string, std::size_t> last_place{"", 0};
    std::uint64_t last_index = 0;
    bool is_first = true;
    for (const auto& [name, own] : readings) {  // by beacon, then key: a robot's nodes in order
      const auto beacon = at.find(name.first);
      const auto node = place.find(name.second);
      const auto robot = mission.robots.find(name.second);
      const double loss = mean_path_loss_db(own);
      if (beacon == at.end() || node == place.end() || !robot || !(loss > 0.0 && loss < options.max_loss_db))
        continue;
      links.emplace_back(node->second, beacon->second);
      const std::uint64_t index = mission.robots.node_index(name.second);
      const std::tuple<std::string, std::size_t> now{name.first, *robot};
      const auto gap = static_cast<std::uint64_t>(options.max_gap_nodes);
      if (is_first || now != last_place || index > last_index + gap) ++passes;
      is_first = false;
      last_place = now;
      last_index = index;
    }
    std::vector<std::uint32_t> ends;
    const auto chosen = drawn(links.size(), options_.layer_items, combine_seeds(options_.seed, 6));
    for (const std::size_t i : chosen) {
      ends.push_back(links[i].first);
      ends.push_back(links[i].second);
    }
    scene["beacons"] = beacons;
    scene["radio"] = {{"total", links.size()},
                      {"drawn", chosen.size()},
                      {"passes", passes},
                      {"max_loss_db", options.max_loss_db},
                      {"ends", base64(ends)}};
  }

  fs::path folder_;
  const ReportOptions& options_;
  Json summary_;
  bool is_judged_anew_ = false;
  std::string mission_name_;
  std::vector<RunClosure> rows_;
  bool has_closures_ = false;
  std::optional<RunJournal> journal_;
  std::vector<std::string> notes_;
};

Json mission_json(const Mission& mission) {
  Json robots = Json::array(), gaps = Json::array();
  for (const Robot& robot : mission.robots.all()) robots.push_back(robot.name);
  for (const CommunicationGap& gap : mission.gaps) {
    gaps.push_back(
        {{"robot", mission.robots[gap.robot].name}, {"begin_s", gap.begin_s}, {"end_s", gap.end_s}});
  }
  return {{"name", mission.name},
          {"kind", enum_name(mission.kind)},
          {"robots", robots},
          {"key_frames", mission.graph.nodes().size()},
          {"scans", mission.scans->size()},
          {"ground_truth", mission.ground_truth.size()},
          {"truth_file", mission.truth_file.empty() ? Json(nullptr) : Json(mission.truth_file)},
          {"reference", mission.reference.size()},
          {"radio_readings", mission.radio.size()},
          {"beacons", mission.beacons.size()},
          {"communication_gaps", gaps},
          {"provenance", parse_json(mission.provenance_json, "provenance")}};
}

}  // namespace

Report make_report(const std::vector<fs::path>& folders, const std::vector<Mission>& missions,
                   const ReportOptions& options, ThreadPool& threads, const ProgressCallback& progress) {
  validate(options);
  if (folders.empty()) throw OptionError("a report needs at least one run");
  std::vector<MissionView> views(missions.size());
  for (std::size_t i = 0; i < missions.size(); ++i) views[i].mission = &missions[i];

  Report report;
  Json runs = Json::array(), studies = Json::array();
  const std::vector<std::string> labels = labels_of(folders);
  for (std::size_t i = 0; i < folders.size(); ++i) {
    const fs::path& folder = folders[i];
    if (progress) progress({"reading runs", i, folders.size(), labels[i]});
    Json of_folder = studies_json(folder, labels[i]);
    if (!of_folder.empty()) {
      report.studies += of_folder.size();
      for (Json& study : of_folder) studies.push_back(std::move(study));
      continue;
    }
    if (!fs::exists(folder / "summary.json")) {
      if (!fs::exists(folder)) throw IoError(folder.string(), "no such folder");
      throw InputError(folder.string() +
                       ": neither a run (summary.json, written last: an unfinished one lacks it) nor a study "
                       "(runs.csv, curves.csv or robots.csv)");
    }
    RunReader run(folder, options);
    MissionView* view = nullptr;
    for (MissionView& candidate : views) {
      if (candidate.mission->name == run.mission_name()) view = &candidate;
    }
    run.judge(view != nullptr ? view->mission : nullptr);
    Json json = {{"label", labels[i]}, {"summary", run.summary()}, {"history", run.history()}};
    if (static_cast<std::int64_t>(report.maps) < options.maps) {
      if (view != nullptr && view->observability.empty()) {
        view->observability =
            observability_of(*view->mission, run.section<FeatureOptions>("features"), threads, progress);
      }
      json["scene"] = run.scene(view);
      if (!json["scene"].is_null()) ++report.maps;
    } else {
      json["scene"] = nullptr;
      run.note("only the first " + std::to_string(options.maps) + " runs have a map");
    }
    if (view != nullptr) view->used = true;
    json["notes"] = run.notes();
    for (const std::string& note : run.notes()) report.notes.push_back(labels[i] + ": " + note);
    runs.push_back(std::move(json));
    ++report.runs;
  }
  Json mission_list = Json::array();
  for (const MissionView& view : views) {
    if (!view.used) {
      throw InputError(view.mission->path.string() + ": none of the runs is of the mission \"" +
                       view.mission->name + "\"");
    }
    mission_list.push_back(mission_json(*view.mission));
  }
  const Json data = {{"format", "loopwise-report"},
                     {"version", 1},
                     {"generator", "loopwise " + std::string(version())},
                     {"runs", std::move(runs)},
                     {"studies", std::move(studies)},
                     {"missions", std::move(mission_list)}};
  report.data = data.dump(-1, ' ', true, Json::error_handler_t::replace);
  return report;
}

}  // namespace loopwise
