// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/mission_picture.hpp>
#include <loopwise/evaluation/report.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::report_test {
namespace {

/// A run of the two circles as its folder.
class Run {
 public:
  explicit Run(const Mission& mission, const std::string& method = "random") {
    ReplayOptions config;
    config.prioritization.method = parse_method(method);
    config.max_registrations = 60;
    const auto features =
        std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
    const auto registrar = std::make_shared<testing::OracleRegistrar>(testing::two_circles().ground_truth);
    ThreadPool pool(1);
    RunHistory history(mission);
    ReplayHooks hooks;
    std::string journal;
    hooks.journal = [&](const std::string& line) { journal += line + "\n"; };
    hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
    result = MissionReplay(mission, config, {features, registrar}).run(pool, hooks);
    testing::write_text(folder / "journal.jsonl", journal);
    map = stitch_map(result.graph, *mission.scans, 0.2).cloud;
    write_run_folder(folder.path(), mission, config, result, evaluate_run(mission, result), history.rows(),
                     map);
  }

  testing::TemporaryFolder folder;
  ReplayResult result;
  PointCloud map;
};

template <class T>
std::vector<T> decoded(const Json& json) {
  const auto text = json.get<std::string>();
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string bytes;
  unsigned word = 0;
  int bits = 0;
  for (const char c : text) {
    if (c == '=') break;
    word = (word << 6) | static_cast<unsigned>(digits.find(c));
    bits += 6;
    if (bits >= 8) bytes += static_cast<char>((word >> (bits -= 8)) & 0xff);
  }
  REQUIRE(bytes.size() % sizeof(T) == 0);
  std::vector<T> values(bytes.size() / sizeof(T));
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

Json made(const std::vector<testing::fs::path>& folders, const std::vector<Mission>& missions,
          const ReportOptions& options = {}, int num_threads = 1) {
  ThreadPool threads(num_threads);
  return parse_json(make_report(folders, missions, options, threads).data, "data");
}

std::size_t count(const Json& json, const char* name) {
  return json.at(name).get<std::size_t>();
}

std::string notes(const Json& run) {
  return run.at("notes").dump();
}

}  // namespace

TEST_CASE("report: contains positions and outcomes of all items", "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const Run run(mission);
  const Json data = made({run.folder.path()}, {mission});
  REQUIRE(data.at("format") == "loopwise-report");
  const Json& shown = data.at("runs").at(0);
  REQUIRE(shown.at("summary") == parse_json(testing::read_text(run.folder / "summary.json"), "summary.json"));

  const Json& nodes = shown.at("scene").at("nodes");
  REQUIRE(shown.at("scene").at("robots") == Json({"a", "b"}));
  REQUIRE(nodes.at("begin") == Json({0, 40}));
  const auto optimized = decoded<float>(nodes.at("optimized")),
             odometry = decoded<float>(nodes.at("odometry")), truth = decoded<float>(nodes.at("truth")),
             time_s = decoded<float>(nodes.at("time_s")),
             observability = decoded<float>(nodes.at("observability"));
  REQUIRE(optimized.size() == 240);
  REQUIRE(observability.size() == 80);
  float largest = 0.0F;
  for (const float value : observability) largest = std::max(largest, value);
  REQUIRE(largest == 1.0F);
  for (std::size_t i = 0; i < 80; ++i) {
    const Key key = parse_key(nodes.at("key").at(i).get<std::string>());
    REQUIRE(key == make_key(i < 40 ? 'a' : 'b', i % 40));
    const std::size_t place = run.result.graph.index_of(key);
    const Eigen::Vector3d p = run.result.graph.nodes()[place].pose.translation();
    for (int axis = 0; axis < 3; ++axis) {
      const std::size_t at = 3 * i + static_cast<std::size_t>(axis);
      REQUIRE(optimized[at] == Approx(p[axis]).margin(1e-5));
      REQUIRE(odometry[at] == Approx(run.result.odometry[place].translation()[axis]).margin(1e-5));
      REQUIRE(truth[at] == Approx(mission.ground_truth.at(key).translation()[axis]).margin(1e-5));
    }
    REQUIRE(time_s[i] == Approx(2.0 * static_cast<double>(i % 40) + (i < 40 ? 0.0 : 0.5)));
  }

  // Points come back within half a step of where they were.
  const Json& points = shown.at("scene").at("points");
  const auto position = decoded<std::uint16_t>(points.at("position"));
  const auto owner = decoded<std::uint8_t>(points.at("robot"));
  REQUIRE(count(points, "total") == run.map.size());
  REQUIRE(count(points, "drawn") == run.map.size());  // fewer than the bound, none far off
  REQUIRE(position.size() == 3 * run.map.size());
  for (std::size_t i = 0; i < run.map.size(); ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double step = points.at("step").at(axis).get<double>();
      const double at = points.at("low").at(axis).get<double>() + step * position[3 * i + axis];
      REQUIRE(std::abs(at - static_cast<double>(run.map.points[i][static_cast<int>(axis)])) <= 0.51 * step);
    }
    REQUIRE(owner[i] < 2);
  }

  // Layers hold the pairs of each outcome.
  const Json& layers = shown.at("scene").at("candidates");
  std::map<std::string, std::vector<std::pair<Key, Key>>> expected;
  for (const ComputedCandidate& computed : run.result.computed) {
    const LoopCandidate& pair = computed.result.candidate;
    expected[!computed.result.verified() ? "rejected"
             : computed.weight > 0.5     ? "kept"
                                         : "outlier"]
        .emplace_back(pair.from, pair.to);
  }
  for (const char* name : {"kept", "outlier", "rejected"}) {
    const auto ends = decoded<std::uint32_t>(layers.at(name).at("ends"));
    REQUIRE(count(layers.at(name), "total") == expected[name].size());
    REQUIRE(ends.size() == 2 * expected[name].size());
    for (std::size_t i = 0; i < expected[name].size(); ++i) {
      const auto key = [&](std::size_t end) {
        return parse_key(nodes.at("key").at(ends[end]).get<std::string>());
      };
      REQUIRE(std::pair(key(2 * i), key(2 * i + 1)) == expected[name][i]);
    }
  }
  REQUIRE(count(layers.at("kept"), "total") > 10);
  REQUIRE(count(layers.at("rejected"), "total") > 5);
  REQUIRE(count(layers.at("selected"), "total") >= 60);

  const Json& history = shown.at("history");
  REQUIRE(history.at("source") == "history.csv");
  REQUIRE(history.at("columns").at("computed").back() == 60);
  REQUIRE(history.at("columns").at("ate_m").back().get<double>() ==
          Approx(shown.at("summary").at("ate_m").at("optimized").get<double>()).epsilon(1e-9));
}

TEST_CASE("report: a layer beyond its bound is drawn at random, its total stays", "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const Run run(mission);
  ReportOptions options;
  options.map_points = 500;
  options.layer_items = 7;
  const Json some = made({run.folder.path()}, {mission}, options);
  const Json& scene = some.at("runs").at(0).at("scene");
  REQUIRE(count(scene.at("points"), "total") == run.map.size());
  REQUIRE(count(scene.at("points"), "drawn") <= 500);
  REQUIRE(count(scene.at("points"), "drawn") > 450);  // those far off are left out: none or few
  for (const auto& [name, layer] : scene.at("candidates").items()) {
    CAPTURE(name);
    REQUIRE(count(layer, "drawn") == std::min<std::size_t>(7, count(layer, "total")));
    REQUIRE(decoded<std::uint32_t>(layer.at("ends")).size() == 2 * count(layer, "drawn"));
  }
  REQUIRE(count(scene.at("nodes"), "stride") == 12);  // 80 nodes in at most 7 steps

  // Another seed draws others; each candidate as likely: over 200 seeds, each of n within 5 sigmas of 7/n.
  const std::size_t total = count(scene.at("candidates").at("rejected"), "total");
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> seen;
  for (options.seed = 1; options.seed <= 200; ++options.seed) {
    options.map_points = 0;
    const Json data = made({run.folder.path()}, {}, options);
    const auto ends =
        decoded<std::uint32_t>(data.at("runs").at(0).at("scene").at("candidates").at("rejected").at("ends"));
    for (std::size_t i = 0; i < ends.size(); i += 2) ++seen[{ends[i], ends[i + 1]}];
  }
  REQUIRE(seen.size() == total);
  const double share = 7.0 / static_cast<double>(total), sigma = std::sqrt(200.0 * share * (1.0 - share));
  for (const auto& [pair, times] : seen) REQUIRE(std::abs(times - 200.0 * share) < 5.0 * sigma);
}

TEST_CASE("report: neither threads nor a second time change a byte", "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const Run run(mission);
  REQUIRE(made({run.folder.path()}, {mission}, {}, 1).dump() ==
          made({run.folder.path()}, {mission}, {}, 3).dump());
}

TEST_CASE("report: missing data of a run are left out and listed", "[evaluation][report]") {
  Mission mission = testing::two_circles();
  const Run run(mission);

  const Json alone = made({run.folder.path()}, {});
  REQUIRE(alone.at("runs").at(0).at("scene").at("nodes").at("truth").is_null());
  REQUIRE_FALSE(alone.at("runs").at(0).at("scene").at("nodes").at("odometry").is_null());
  REQUIRE(Contains("no mission given").match(notes(alone.at("runs").at(0))));

  mission.ground_truth.clear();
  mission.scans = std::make_shared<ScanStore>();
  testing::fs::remove(run.folder / "history.csv");
  testing::fs::remove(run.folder / "map.pcd");
  testing::fs::remove_all(run.folder / "trajectories");
  const Json bare = made({run.folder.path()}, {mission});
  const Json& shown = bare.at("runs").at(0);
  REQUIRE(shown.at("scene").at("robots") == Json({"a", "b"}));
  REQUIRE(shown.at("scene").at("nodes").at("truth").is_null());
  REQUIRE(shown.at("scene").at("nodes").at("observability").is_null());
  REQUIRE(shown.at("scene").at("points").is_null());
  REQUIRE(shown.at("scene").at("beacons").is_null());
  REQUIRE(shown.at("history").at("source") == "journal.jsonl");
  REQUIRE(shown.at("history").at("columns").at("computed").back() == 60);
  for (const char* part :
       {"no ground truth", "no scans", "no map.pcd", "no trajectories", "no history.csv"}) {
    CAPTURE(part, notes(shown));
    REQUIRE(Contains(part).match(notes(shown)));
  }

  // A journal that was tampered with.
  const std::string journal = testing::read_text(run.folder / "journal.jsonl");
  testing::write_text(
      run.folder / "journal.jsonl",
      journal + R"({"event":"batch","time_s":"late","account":{}})" + "\n" +
          R"({"event":"batch","time_s":90,"account":[1]})" + "\n" +
          R"({"event":"end","time_s":99,"account":{"generated":1,"pruned":"x","computed":-1}})");
  const Json odd = made({run.folder.path()}, {mission}).at("runs").at(0).at("history").at("columns");
  REQUIRE(odd.at("mission_time_s").size() ==
          shown.at("history").at("columns").at("mission_time_s").size() + 1);
  REQUIRE(odd.at("queued").back() == 1);
  REQUIRE(odd.at("computed").back() == 0);
  const auto line = static_cast<std::size_t>(std::count(journal.begin(), journal.end(), '\n')) + 1;
  testing::write_text(run.folder / "journal.jsonl",
                      journal + R"({"event":"batch","time_s":90,"pairs":[["1","a-1"]]})" + "\n");
  REQUIRE_THROWS_WITH(made({run.folder.path()}, {mission}),
                      Contains("journal.jsonl:" + std::to_string(line)));

  for (const char* name : {"closures.csv", "journal.jsonl", "graph.g2o"})
    testing::fs::remove(run.folder / name);
  const Json least = made({run.folder.path()}, {});
  REQUIRE(least.at("runs").at(0).at("scene").is_null());
  REQUIRE(least.at("runs").at(0).at("history").is_null());
  REQUIRE(count(least.at("runs").at(0).at("summary").at("candidates"), "computed") == 60);
}

namespace {

/// summary.json as it was before there were references.
void make_old(const Run& run, const std::string& problem) {
  Json summary = parse_json(testing::read_text(run.folder / "summary.json"), "summary.json");
  for (const char* name : {"truth", "reference", "residuals"}) summary.erase(name);
  summary["problems"] = {problem};
  testing::write_text(run.folder / "summary.json", summary.dump());
}

}  // namespace

TEST_CASE("report: a truth given later evaluates the run", "[evaluation][report]") {
  const Mission right = testing::two_circles();
  Mission mission_without_truth = right;
  mission_without_truth.ground_truth.clear();
  const Run with_truth(right), without_truth(mission_without_truth);
  const Json before = made({without_truth.folder.path()}, {mission_without_truth}).at("runs").at(0);
  REQUIRE(before.at("summary").at("truth").is_null());
  REQUIRE(before.at("summary").at("residuals").at("closures").get<int>() > 10);
  const Json after = made({without_truth.folder.path()}, {right}).at("runs").at(0);
  const Json expected = made({with_truth.folder.path()}, {right}).at("runs").at(0).at("summary");
  const Json& summary = after.at("summary");
  REQUIRE(summary.at("closures") == expected.at("closures"));
  for (const char* name : {"ate_m", "ate_rad", "ate_se3_m", "ate_rmse_m"}) {
    for (const char* which : {"odometry", "optimized"}) {
      CAPTURE(name, which);
      REQUIRE(summary.at(name).at(which).get<double>() ==
              Approx(expected.at(name).at(which).get<double>()).epsilon(1e-9));
    }
  }
  REQUIRE(summary.at("truth") == expected.at("truth"));
  REQUIRE(Contains("errors over time are not known").match(notes(after)));
  REQUIRE_FALSE(after.at("history").at("columns").contains("ate_m"));
  REQUIRE(after.at("history").at("columns").contains("gnc_inliers"));

  // The same truth, given by a file, changes nothing.
  Mission again = right;
  again.truth_file = "again.tum";
  const Json same = made({with_truth.folder.path()}, {again}).at("runs").at(0);
  REQUIRE(same.at("summary") == expected);
  REQUIRE(same.at("history").at("columns").contains("ate_m"));
  REQUIRE_FALSE(Contains("errors over time are not known").match(notes(same)));

  // A given truth takes precedence over that of the run; without the files of the run it cannot be used.
  Mission given = right;
  given.truth_file = "better.tum";
  for (auto& [key, pose] : given.ground_truth) pose.translation().z() += 7.0;
  const Json moved = made({with_truth.folder.path()}, {given}).at("runs").at(0).at("summary");
  // The estimate itself is off by as much as it was before.
  const double own_m = expected.at("ate_m").at("optimized").get<double>();
  REQUIRE(own_m < 2.0);
  REQUIRE(std::abs(moved.at("ate_m").at("optimized").get<double>() - 7.0) <= own_m + 1e-6);
  testing::fs::remove_all(without_truth.folder / "trajectories");
  const Json bare = made({without_truth.folder.path()}, {right}).at("runs").at(0);
  REQUIRE(bare.at("summary").at("truth").is_null());
  REQUIRE(Contains("not judged by the mission's truth").match(notes(bare)));
}

TEST_CASE("report: errors in old runs of sessions are differences", "[evaluation][report]") {
  const Mission right = testing::two_circles();
  Mission session = right;
  session.reference = session.ground_truth;
  session.ground_truth.clear();
  {
    const Run run(right);
    make_old(run, "no prior given (data/session: the first node gets one)");
    const Json old = parse_json(testing::read_text(run.folder / "summary.json"), "summary.json");
    Json shown = made({run.folder.path()}, {}).at("runs").at(0);
    Json summary = shown.at("summary");
    REQUIRE(summary.at("truth").is_null());
    REQUIRE(summary.at("ate_m").is_null());
    REQUIRE(summary.at("closures").at("true_inliers").is_null());
    REQUIRE(summary.at("reference").at("difference_m") == old.at("ate_m"));
    REQUIRE_FALSE(shown.at("history").at("columns").contains("true_inliers"));
    // With the mission, the reference of the session is known.
    shown = made({run.folder.path()}, {session}).at("runs").at(0);
    summary = shown.at("summary");
    REQUIRE(summary.at("truth").is_null());
    REQUIRE(summary.at("reference").at("poses") == 80);
    REQUIRE(summary.at("residuals").at("closures").get<int>() > 10);
    REQUIRE(shown.at("scene").at("nodes").at("truth").is_null());
    REQUIRE_FALSE(shown.at("scene").at("nodes").at("reference").is_null());
  }
  // Others had a truth.
  const Run run(right);
  make_old(run, "no prior given (data/m: node 0 gets one)");
  const Json old = parse_json(testing::read_text(run.folder / "summary.json"), "summary.json");
  const Json summary = made({run.folder.path()}, {}).at("runs").at(0).at("summary");
  REQUIRE(summary.at("ate_m") == old.at("ate_m"));
  REQUIRE(summary.at("closures") == old.at("closures"));
  REQUIRE(summary.at("truth").at("alignment") == "none");
}

TEST_CASE("report: trajectories distinguish robots of plain keys", "[evaluation][report]") {
  // The same run with keys 0 … 79: without the mission only the files show the first node of the second
  // robot.
  const Mission mission = testing::two_circles();
  const Run run(mission);
  const PoseGraph graph = read_g2o(run.folder / "graph.g2o").graph;
  PoseGraph renumbered;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 40; ++i) {
      Node node = graph.node(make_key(robot, i));
      node.key = i + (robot == 'a' ? 0 : 40);
      renumbered.add_node(node);
    }
  }
  write_g2o(run.folder / "graph.g2o", renumbered);
  const Json data = made({run.folder.path()}, {});
  const Json& scene = data.at("runs").at(0).at("scene");
  REQUIRE(scene.at("robots") == Json({"a", "b"}));
  REQUIRE(scene.at("nodes").at("begin") == Json({0, 40}));
  // The pairs of closures.csv have no nodes now: counted, not drawn.
  REQUIRE(count(scene.at("candidates").at("kept"), "drawn") == 0);
  REQUIRE(count(scene.at("candidates").at("kept"), "total") > 0);
}

TEST_CASE("report: beacons and passes within reach", "[evaluation][report]") {
  Mission mission = testing::two_circles();
  mission.beacons = {{"b1", 0, make_key('a', 5), 0}};
  for (const std::uint64_t i : {4U, 5U, 6U, 38U, 39U})
    mission.radio.push_back({make_key('a', i), "b1", 20.0, "0", -20.0});  // 40 dB
  mission.radio.push_back({make_key('b', 5), "b1", 20.0, "0", -30.0});    // 50 dB
  mission.radio.push_back({make_key('b', 9), "b1", 20.0, "0", -60.0});    // 80 dB: out of reach
  const Run run(mission);
  const Json data = made({run.folder.path()}, {mission});
  const Json& scene = data.at("runs").at(0).at("scene");
  REQUIRE(scene.at("beacons") == Json::array({{{"name", "b1"}, {"node", 5}}}));
  REQUIRE(count(scene.at("radio"), "total") == 6);
  REQUIRE(count(scene.at("radio"), "passes") == 3);
  const auto ends = decoded<std::uint32_t>(scene.at("radio").at("ends"));
  REQUIRE(ends == std::vector<std::uint32_t>{4, 5, 5, 5, 6, 5, 38, 5, 39, 5, 45, 5});
}

TEST_CASE("report: several runs keep their names apart, maps are bounded", "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const Run one(mission), two(mission, "baseline");
  const testing::TemporaryFolder folder;
  for (const auto& [name, run] : {std::pair("x", &one), std::pair("y", &two)}) {
    testing::fs::create_directories(folder / name);
    testing::fs::copy(run->folder.path(), folder.path() / name / "run", testing::fs::copy_options::recursive);
  }
  ReportOptions options;
  options.maps = 1;
  ThreadPool threads(1);
  const Report report =
      make_report({folder.path() / "x" / "run", folder.path() / "y" / "run"}, {mission}, options, threads);
  REQUIRE(report.runs == 2);
  REQUIRE(report.maps == 1);
  const Json data = parse_json(report.data, "data");
  REQUIRE(data.at("runs").at(0).at("label") == "x/run");
  REQUIRE(data.at("runs").at(1).at("label") == "y/run");
  REQUIRE_FALSE(data.at("runs").at(0).at("scene").is_null());
  REQUIRE(data.at("runs").at(1).at("scene").is_null());
}

TEST_CASE("report: studies become medians over mission time", "[evaluation][report]") {
  const std::string about =
      "world,mission,mission_seed,parameters_sha256,method,seed,registration_time_s,workers,thin,after_"
      "mission,"
      "mission_end_s,mission_time_s";
  const auto run = [](int mission, const std::string& end) {
    return "w,m" + std::to_string(mission) + ",1,ab,obs,1,1.3,10,1,0," + end + "," + end;
  };
  const testing::TemporaryFolder folder;
  testing::write_text(
      folder / "curves.csv",
      about + ",time_s,computed,queued,verified,gnc_inliers,true_inliers,ate_m,odometry_ate_m\n" +
          run(1, "100") + ",0,0,0,0,0,0,0,0\n" + run(1, "100") + ",50,10,100,8,5,4,1,3\n" + run(1, "100") +
          ",100,20,200,9,6,5,2,3\n" + run(2, "200") + ",0,0,0,0,0,0,0,0\n" + run(2, "200") +
          ",100,10,100,6,3,2,3,3\n" + run(2, "200") + ",200,20,100,7,4,3,,\n");
  const Json only_curves = made({folder.path()}, {}).at("studies").at(0);
  REQUIRE(only_curves.at("rows").size() == 2);
  REQUIRE(only_curves.at("rows").at(0).at("ate_m") == 2.0);
  const Json& series = only_curves.at("curves").at(0);
  REQUIRE(only_curves.at("curves").size() == 1);
  REQUIRE(count(series, "runs") == 2);
  REQUIRE(series.at("method") == "obs");
  const auto at = [&](const char* name, double share, const char* which = "median") {
    const Json& shares = series.at("share");
    std::size_t i = 0;
    while (i + 1 < shares.size() && shares.at(i).get<double>() < share - 1e-9) ++i;
    return series.at(name).at(which).at(i);
  };
  REQUIRE(at("gnc_share", 0.2).is_null());  // nothing is queued
  REQUIRE(at("ate_m", 0.49) == 0.0);
  REQUIRE(at("ate_m", 0.5) == 2.0);  // of 1 and 3
  REQUIRE(at("ate_m", 0.5, "lower") == 1.5);
  REQUIRE(at("gnc_share", 0.5) == 4.0);
  REQUIRE(at("true_share", 1.0).get<double>() == Approx(2.75));
  REQUIRE(at("verified", 1.0) == 8.0);
  REQUIRE(at("ate_m", 1.0) == 2.0);  // the other is not known

  // Without curves.csv, the data of runs that the study keeps; other files are ignored.
  testing::fs::remove(folder / "curves.csv");
  testing::write_text(folder / "runs.csv", about + ",ate_m\n" + run(1, "100") + ",2\n");
  testing::fs::create_directories(folder / "units");
  const std::string unit =
      R"({"mission": {"world": "w"}, "summary": {"mission": "m1", "method": "obs", "seed": 1, "mission_end_s": 100,
          "ate_m": {"optimized": 2.0},
          "options": {"replay": {"after_mission": false}, "engine": {"thin": 1},
                      "cost": {"registration_time_s": 1.3, "workers": 10}}},
          "history": [[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0], [50, 9, 9, 100, 10, 8, 5, 4, 4, 1, 3]]})";
  testing::write_text(folder / "units" / "a.json", unit);
  std::string other = unit;
  other.replace(other.find("\"m1\""), 4, "\"m9\"");
  testing::write_text(folder / "units" / "b.json", other);
  std::string before = unit;  // of other options, or of earlier code
  before.replace(before.find("2.0"), 3, "2.5");
  testing::write_text(folder / "units" / "0.json", before);
  testing::write_text(folder / "units" / "c.json", "{\"format\": ");
  testing::write_text(folder / "units" / "d.json", "[]");
  const Json with_units = made({folder.path()}, {}).at("studies").at(0);
  REQUIRE(with_units.at("rows").size() == 1);
  REQUIRE(with_units.at("rows").at(0).at("parameters_sha256") == "ab");
  REQUIRE(with_units.at("curves").size() == 1);
  REQUIRE(count(with_units.at("curves").at(0), "runs") == 1);
  REQUIRE(with_units.at("curves").at(0).at("gnc_share").at("median").back() == 5.0);

  testing::fs::remove_all(folder / "units");
  REQUIRE(made({folder.path()}, {}).at("studies").at(0).at("curves").empty());
  testing::write_text(folder / "curves.csv", "world\nw\n");
  REQUIRE_THROWS_AS(made({folder.path()}, {}), ParseError);
  testing::fs::remove(folder / "curves.csv");
  testing::write_text(folder / "runs.csv", about + ",ate_m,\xff\x80,\xfe\x80\n" + run(1, "100") + ",2,1,1\n");
  REQUIRE_THROWS_WITH(made({folder.path()}, {}),
                      (folder / "runs.csv").string() + ":1: the name of a column is not UTF-8");
}

TEST_CASE("report: runs of other costs or truths are no repetitions", "[evaluation][report]") {
  const testing::TemporaryFolder folder;
  std::string text =
      "world,mission,mission_seed,parameters_sha256,method,seed,registration_time_s,refused_time_share,"
      "workers,"
      "thin,after_mission,mission_end_s,mission_time_s,truth_alignment,time_s,computed,queued,verified,"
      "gnc_inliers,true_inliers,ate_m,odometry_ate_m\n";
  for (const char* share : {"1", "0"}) {
    for (const char* alignment : {"none", "se3"}) {
      for (const char* moment : {"0,0,0,0,0,0,0,0", "100,20,200,9,6,5,2,3"})
        text +=
            std::string("w,m,1,ab,obs,1,1.3,") + share + ",10,1,0,100,100," + alignment + "," + moment + "\n";
    }
  }
  testing::write_text(folder / "curves.csv", text);
  const Json study = made({folder.path()}, {}).at("studies").at(0);
  REQUIRE(study.at("curves").size() == 4);
  for (const Json& series : study.at("curves")) REQUIRE(count(series, "runs") == 1);
  REQUIRE(study.at("curves").at(1).at("truth_alignment") == "se3");
  REQUIRE(study.at("curves").at(2).at("refused_time_share") == 0.0);
}

TEST_CASE("report: studies that share a folder, missions that share a name", "[evaluation][report]") {
  const std::string about =
      "world,mission,mission_seed,parameters_sha256,method,seed,registration_time_s,workers,thin,after_"
      "mission,mission_end_s,mission_time_s";
  const std::string run = "w,m,1,ab,obs,1,1.3,10,1,0,100,100";
  const testing::TemporaryFolder folder;
  testing::write_text(folder / "curves.csv",
                      about +
                          ",time_s,computed,queued,verified,gnc_inliers,true_inliers,ate_m,odometry_ate_m\n" +
                          run + ",0,0,0,0,0,0,0,0\n" + run + ",100,20,200,9,6,5,2,3\n" + run +
                          ",0,0,0,0,0,0,0,0\n" + run + ",100,20,200,9,6,5,4,3\n");
  testing::write_text(folder / "budget.json", R"({"of": "budget"})");
  Json studies = made({folder.path()}, {}).at("studies");
  REQUIRE(studies.size() == 1);
  REQUIRE(studies.at(0).at("kind") == "budget");
  REQUIRE(studies.at(0).at("label") == folder.path().filename().string());
  REQUIRE(studies.at(0).at("rows").size() == 2);
  REQUIRE(count(studies.at(0).at("curves").at(0), "runs") == 2);
  REQUIRE(studies.at(0).at("curves").at(0).at("ate_m").at("median").back() == 3.0);

  testing::write_text(folder / "runs.csv", about + ",ate_m\n" + run + ",7\n");
  testing::write_text(folder / "ablation.json", R"({"of": "ablation"})");
  testing::write_text(folder / "robots.csv",
                      about + ",robot,path_length_m,translation_percent,max_m,rotation_deg_per_m,max_deg\n" +
                          run + ",husky,80,0.5,2,0.01,3\n");
  studies = made({folder.path()}, {}).at("studies");
  REQUIRE(studies.size() == 3);
  for (const Json& study : studies) {
    const std::string kind = study.at("kind").get<std::string>();
    REQUIRE(study.at("label") == folder.path().filename().string() + ", " + kind);
    if (kind != "rssi") REQUIRE(study.at("result") == Json({{"of", kind}}));
  }
  REQUIRE(studies.at(0).at("rows").at(0).at("ate_m") == 7.0);
  REQUIRE(studies.at(0).at("curves").empty());  // those of the other study are not its own
  REQUIRE(studies.at(2).at("rows").at(0).at("robot") == "husky");
  REQUIRE(studies.at(2).at("rows").at(0).at("max_m") == 2.0);
  REQUIRE(studies.at(2).at("result").is_null());
}

TEST_CASE("report: names cannot end the data block of the page", "[evaluation][report]") {
  Mission mission = testing::two_circles();
  mission.name = "</script><!--<script> \"x\" & \\";
  const Run run(mission);
  ThreadPool threads(1);
  const Report report = make_report({run.folder.path()}, {}, {}, threads);
  REQUIRE(Contains("</script>").match(report.data));  // the data are JSON, not yet HTML
  if (!report_pages_built()) {
    REQUIRE_THROWS_WITH(report_page(report.data), Contains("LOOPWISE_WITH_REPORT"));
    return;
  }
  const std::string page = report_page(report.data);
  const std::string empty = report_page("{}");
  const auto occurrences = [](const std::string& text, const std::string& part) {
    std::size_t times = 0;
    for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++times;
    return times;
  };
  for (const char* part : {"</script", "<script", "<!--", "<"})
    REQUIRE(occurrences(page, part) == occurrences(empty, part));
  REQUIRE(Contains("\\u003c/script>\\u003c!--").match(page));

  // The page reads the given data.
  const std::string begin = "<script type=\"application/json\" id=\"data\">";
  const std::size_t from = page.find(begin) + begin.size();
  const std::string inside = page.substr(from, page.find("</script>", from) - from);
  REQUIRE(parse_json(inside, "page") == parse_json(report.data, "data"));
  REQUIRE(occurrences(page, "http://") + occurrences(page, "https://") ==
          occurrences(empty, "http://") + occurrences(empty, "https://"));
}

TEST_CASE("report: robots and folders that are named after markup stay text in the written page",
          "[evaluation][report]") {
  if (!report_pages_built()) {
    SUCCEED("no pages in this build");
    return;
  }
  Mission mission = testing::two_circles();
  const std::vector<Robot> plain = mission.robots.all();
  const std::string evil = "<script>alert(\"1\")</script>",
                    quoted = "' onmouseover='alert(2)' \"&amp;<img src=x>";
  mission.robots = Robots({{evil, plain[0].first, plain[0].last}, {quoted, plain[1].first, plain[1].last}});
  mission.beacons.push_back({"</title><svg onload=alert(3)>", 0, make_key('a', 2), 0});
  const Run run(mission);
  const testing::TemporaryFolder folder;
  const testing::fs::path runs = folder / "<script>'\"&<b>";
  testing::fs::copy(run.folder.path(), runs, testing::fs::copy_options::recursive);
  ThreadPool threads(1);
  const Report report = write_report(folder / "r.html", {runs}, {mission}, {}, threads);
  const std::string page = testing::read_text(folder / "r.html"), empty = report_page("{}");
  const auto brackets = [](const std::string& text) { return std::count(text.begin(), text.end(), '<'); };
  REQUIRE(brackets(page) == brackets(empty));  // no element that the page itself does not have
  const std::string begin = "<script type=\"application/json\" id=\"data\">";
  const std::size_t from = page.find(begin) + begin.size();
  const Json data = parse_json(page.substr(from, page.find("</script>", from) - from), "page");
  REQUIRE(data.at("runs").at(0).at("scene").at("robots") == Json({evil, quoted}));
  // The pictures of the same run, as browsers show them too.
  for (const std::string& picture :
       {testing::read_text(runs / "picture.svg"), mission_picture_svg(mission)}) {
    REQUIRE_FALSE(Contains("<script").match(picture));
    REQUIRE_FALSE(Contains("<img").match(picture));
    REQUIRE_FALSE(Contains("<svg onload").match(picture));
  }
}

TEST_CASE("report: one file that is replaced as a whole", "[evaluation][report]") {
  const Mission mission = testing::two_circles();
  const Run run(mission);
  const testing::TemporaryFolder folder;
  ThreadPool threads(1);
  if (!report_pages_built()) {
    REQUIRE_THROWS_AS(write_report(folder / "r.html", {run.folder.path()}, {}, {}, threads), Error);
    REQUIRE_FALSE(testing::fs::exists(folder / "r.html"));
    return;
  }
  const Report report = write_report(folder / "r.html", {run.folder.path()}, {mission}, {}, threads);
  REQUIRE(testing::read_text(folder / "r.html") == report_page(report.data));
}

TEST_CASE("report: bad input is named", "[evaluation][report][error]") {
  const Mission mission = testing::two_circles();
  const Run run(mission);
  const testing::TemporaryFolder folder;
  ThreadPool threads(1);
  const auto make = [&](const testing::fs::path& path, const std::vector<Mission>& missions = {}) {
    return make_report({path}, missions, {}, threads);
  };
  REQUIRE_THROWS_WITH(make(folder / "absent"), Contains("absent") && Contains("no such folder"));
  REQUIRE_THROWS_WITH(make(folder.path()), Contains("neither a run"));
  REQUIRE_THROWS_AS(make_report({}, {}, {}, threads), OptionError);
  ReportOptions options;
  options.layer_items = 0;
  REQUIRE_THROWS_AS(make_report({run.folder.path()}, {}, options, threads), OptionError);

  Mission other = mission;
  other.name = "elsewhere";
  REQUIRE_THROWS_WITH(make(run.folder.path(), {other}),
                      Contains("none of the runs") && Contains("elsewhere"));

  const std::string closures = testing::read_text(run.folder / "closures.csv");
  testing::write_text(run.folder / "closures.csv", "from,to\n1,2\n");
  REQUIRE_THROWS_WITH(make(run.folder.path()), Contains("closures.csv:1") && Contains("outcome"));
  testing::write_text(run.folder / "closures.csv", closures + "a1,a2,x\n");
  REQUIRE_THROWS_AS(make(run.folder.path()), ParseError);
  testing::write_text(run.folder / "closures.csv", closures);
  testing::write_text(run.folder / "summary.json", "{\"mission\": ");
  REQUIRE_THROWS_WITH(make(run.folder.path()), Contains("summary.json"));
  testing::write_text(run.folder / "summary.json", "[]");
  REQUIRE_THROWS_WITH(make(run.folder.path()), Contains("not an object"));
  testing::write_text(run.folder / "summary.json", "{}");  // nothing is known, nothing is wrong
  REQUIRE(make(run.folder.path()).runs == 1);
}

}  // namespace loopwise::report_test
