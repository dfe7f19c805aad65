// SPDX-License-Identifier: BSD-3-Clause
// Behaviour that scripts may rely on: exit statuses, output streams, fields of the JSON, files.
#include <sys/stat.h>

#include <chrono>
#include <set>
#include <thread>

#include <nlohmann/json.hpp>

#include <loopwise/core/planar.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "program.hpp"
#include "registration/scene.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::command_line_test {
namespace {

using testing::json_of;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;

enum : int { kDone = 0, kBadUsage = 2, kBadInput = 3, kInterrupted = 130 };

void require_fields(const Json& json, const std::vector<std::string>& fields) {
  for (const std::string& field : fields) {
    CAPTURE(field);
    REQUIRE(json.contains(field));
  }
}

/// Requires that the command fails with this status, reports why on standard error, and prints no results.
void require_failure(const std::vector<std::string>& arguments, int status, const std::string& why) {
  const ProgramRun run = run_program(arguments);
  CAPTURE(arguments);
  REQUIRE(run.status == status);
  REQUIRE(run.out.empty());
  REQUIRE_THAT(run.err, Contains(why));
}

/// closures.csv without its last column, the wall time.
std::string without_seconds(const std::string& csv) {
  std::istringstream lines(csv);
  std::string out, line;
  while (std::getline(lines, line)) out += line.substr(0, line.rfind(',')) + "\n";
  return out;
}

const std::vector<std::string> kClosureColumns{
    "from", "to",      "source",  "outcome", "reason",         "x",      "y", "z", "qx", "qy", "qz",
    "qw",   "fitness", "overlap", "weight",  "mission_time_s", "seconds"};

/// A chain of five nodes with one true and one false closure, disturbed.
PoseGraph small_graph() {
  PoseGraph graph;
  Vector6d step;
  step << 1.0, 0.0, 0.0, 0.0, 0.0, 0.1;
  Node node;
  for (std::uint64_t i = 0; i < 5; ++i) {
    node.key = make_key('a', i);
    graph.add_node(node);
    if (i > 0) {
      graph.add_edge({make_key('a', i - 1), node.key, se3::exp(step), 100.0 * Matrix6d::Identity(),
                      EdgeKind::kOdometry});
    }
    node.pose = node.pose * se3::exp(1.1 * step);
  }
  graph.add_edge({make_key('a', 4), make_key('a', 0), se3::exp(-4.0 * step), 100.0 * Matrix6d::Identity()});
  graph.add_edge(
      {make_key('a', 4), make_key('a', 1), Eigen::Isometry3d::Identity(), 100.0 * Matrix6d::Identity()});
  return graph;
}

}  // namespace

TEST_CASE("command line: bad usage is 2, help is 0", "[apps]") {
  require_failure({}, kBadUsage, "subcommand");
  require_failure({"xyzzy"}, kBadUsage, "unknown command xyzzy; known: info");
  require_failure({"reply"}, kBadUsage, "did you mean replay?");
  require_failure({"info"}, kBadUsage, "path");
  require_failure({"optimize", "x.g2o", "--no-such-flag"}, kBadUsage, "--no-such-flag");
  require_failure({"replay", "m", "-o", "o", "--metod=obs"}, kBadUsage, "did you mean --method?");
  require_failure({"replay", "m", "-o", "o", "--after_mission"}, kBadUsage, "did you mean --after-mission?");
  require_failure({"optimize", "x.g2o", "--threads", "many"}, kBadUsage, "--threads");
  require_failure({"config", "--set", "generation.no_such_field=1"}, kBadUsage, "no_such_field");
  require_failure({"config", "--set", "replay.batch=-1"}, kBadUsage, "replay.batch = -1, must be >= 0");
  const TemporaryFolder folder;
  testing::write_text(folder / "odd.json", "{\"replay\": {\"bach\": 3}}");
  require_failure({"config", "--config", (folder / "odd.json").string()}, kBadUsage, "bach");
  testing::write_text(folder / "cut.json", "{\"replay\": {");
  require_failure({"config", "--config", (folder / "cut.json").string()}, kBadInput, "cut.json");

  for (const char* command : {"replay", "optimize", "register", "evaluate", "info", "config"}) {
    const ProgramRun run = run_program({command, "--help"});
    CAPTURE(command);
    REQUIRE(run.status == kDone);
    REQUIRE(run.err.empty());
    for (const char* option : {"--json", "--threads", "--quiet", "--config"})
      REQUIRE_THAT(run.out, Contains(option));
  }
  REQUIRE(run_program({"--help"}).status == kDone);
  REQUIRE(run_program({"help", "replay"}).out == run_program({"replay", "--help"}).out);
  REQUIRE(run_program({"help"}).out == run_program({"--help"}).out);
  REQUIRE_THAT(run_program({"--version"}).out, Contains("loopwise "));
}

TEST_CASE("command line: input that is absent or broken is 3, and named", "[apps]") {
  const TemporaryFolder folder;
  const std::string absent = (folder / "absent").string(), broken = (folder / "broken.g2o").string();
  testing::write_text(broken, "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0\n");
  testing::write_text(folder / "empty.pcd", "");
  for (const char* command : {"optimize", "info"}) {
    require_failure({command, absent}, kBadInput, absent);
    require_failure({command, broken}, kBadInput, broken + ":2:");
  }
  require_failure({"replay", absent, "-o", (folder / "out").string()}, kBadInput, absent);
  require_failure({"evaluate", absent, absent}, kBadInput, absent);
  require_failure({"register", absent + ".pcd", absent + ".pcd"}, kBadInput, absent);
  require_failure({"register", (folder / "empty.pcd").string(), (folder / "empty.pcd").string()}, kBadInput,
                  "empty.pcd");
  REQUIRE_FALSE(testing::fs::exists(folder / "out"));
}

TEST_CASE("command line: --strict refuses input that would be repaired", "[apps]") {
  const testing::TemporaryFolder folder;
  const std::string vertices = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n",
                    edge = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1",
                    rest = " 0 0 0 0 10 0 0 0 0 10 0 0 0 10 0 0 10 0 10\n";
  const std::string sound = (folder / "sound.g2o").string(),
                    indefinite = (folder / "indefinite.g2o").string(), bare = (folder / "bare.g2o").string();
  testing::write_text(sound, vertices + edge + " 10 0" + rest);
  testing::write_text(indefinite, vertices + edge + " 10 1e5" + rest);
  testing::write_text(bare, vertices + edge + "\n");
  for (const char* command : {"optimize", "info"}) {
    CAPTURE(command);
    REQUIRE(run_program({command, sound, "--strict"}).status == kDone);
    for (const std::string& file : {indefinite, bare}) {
      REQUIRE(run_program({command, file}).status == kDone);
      const ProgramRun strict = run_program({command, file, "--strict"});
      REQUIRE(strict.status == kBadInput);
      REQUIRE_THAT(strict.err, Contains(file + ":3") && Contains("strict"));
    }
  }
  REQUIRE(run_program({"evaluate", indefinite, sound, "--strict"}).status == kBadInput);
}

TEST_CASE("command line: files of other kinds are named by every command", "[apps]") {
  const testing::TemporaryFolder folder;
  const std::string file = (folder / "run_0.db3").string();
  testing::write_text(file, std::string("SQLite format 3\0\x10\0", 18));
  const std::string out = (folder / "out").string();
  const std::vector<std::vector<std::string>> commands = {{"info", file},
                                                          {"convert", file, "-o", out},
                                                          {"replay", file, "-o", out},
                                                          {"optimize", file},
                                                          {"rank", file},
                                                          {"evaluate", file, file},
                                                          {"register", file, file},
                                                          {"config", "--config", file}};
  for (const std::vector<std::string>& command : commands) {
    CAPTURE(command[0]);
    const ProgramRun run = run_program(command);
    REQUIRE(run.status == kBadInput);
    // Commands that read missions take a database for a recording of ROS 2.
    REQUIRE_THAT(run.err, (Contains("run_0.db3: is an SQLite database") && Contains("expected")) ||
                              Contains("run_0.db3: the database is cut short"));
  }
}

TEST_CASE("optimize: fields and files", "[apps]") {
  const TemporaryFolder folder;
  const std::string in = (folder / "in.g2o").string(), out = (folder / "out.g2o").string();
  write_g2o(in, small_graph());
  Json json = json_of({"optimize", in, "-o", out});
  require_fields(json, {"poses", "edges", "components", "cost_initial", "cost", "iterations",
                        "factorizations", "converged", "seconds"});
  REQUIRE(json.at("poses") == 5);
  REQUIRE(json.at("edges") == 6);
  REQUIRE(json.at("components") == 1);
  REQUIRE(json.at("converged") == true);
  REQUIRE(json.at("cost").get<double>() < json.at("cost_initial").get<double>());
  require_fields(json.at("seconds"), {"total"});
  REQUIRE(read_g2o(out).graph.nodes().size() == 5);

  const std::string weights = (folder / "w.csv").string(), marginals = (folder / "m.csv").string();
  json = json_of({"optimize",
                  in,
                  "-o",
                  out,
                  "--gnc",
                  "--weights",
                  weights,
                  "--marginals",
                  marginals,
                  "--prior",
                  std::to_string(make_key('a', 0)) + ":0.01:0.01",
                  "--inlier-probability",
                  "0.999",
                  "--initialization",
                  "odometry",
                  "--odometry",
                  "consecutive",
                  "--robots",
                  "a",
                  "--threads",
                  "2"});
  require_fields(json.at("gnc"), {"outer_iterations", "inliers", "outliers", "truncated_cost"});
  require_fields(json.at("marginals"), {"trace_translation", "trace_full"});
  REQUIRE(json.at("gnc").at("inliers") == 1);
  REQUIRE(json.at("gnc").at("outliers") == 1);
  const CsvTable table(weights, {"edge", "from", "to", "weight", "kind"});
  REQUIRE(table.size() == 6);
  for (std::size_t edge = 0; edge < 6; ++edge) {
    REQUIRE(table.integer(edge, 0) == static_cast<std::int64_t>(edge));
    REQUIRE(table.number(edge, 3) == (edge == 5 ? 0.0 : 1.0));
  }
  REQUIRE(table.key(5, 1) == make_key('a', 4));

  // Results on standard output, as text, and nothing on standard error.
  const ProgramRun plain = run_program({"optimize", in, "-o", out, "--quiet"});
  REQUIRE(plain.status == kDone);
  REQUIRE(plain.err.empty());
  REQUIRE_FALSE(plain.out.empty());
  require_failure({"optimize", in, "--prior", "99"}, kBadUsage, "99");
  require_failure({"optimize", in, "--initialization", "luck"}, kBadUsage, "luck");
  REQUIRE(run_program({"optimize", in, "--json", (folder / "r.json").string(), "--quiet"}).status == kDone);
  REQUIRE(parse_json(testing::read_text(folder / "r.json"), "r.json").at("poses") == 5);
}

TEST_CASE("optimize --certify: proves optima, and leaves local minima", "[apps]") {
  const TemporaryFolder folder;
  const std::string in = (folder / "in.g2o").string(), out = (folder / "out.g2o").string();
  PoseGraph graph = small_graph();
  write_g2o(in, graph);
  Json json = json_of({"optimize", in, "--gnc", "--certify"});
  require_fields(json.at("certificate"),
                 {"status", "message", "cost", "cost_at_estimate", "lower_bound", "relative_gap",
                  "min_eigenvalue", "eigenvalue_tolerance", "components", "certified_components",
                  "reduced_factors", "difference", "same_minimum", "cost_before", "seconds"});
  REQUIRE(json.at("certificate").at("status") == "certified");
  REQUIRE(json.at("certificate").at("same_minimum") == true);
  REQUIRE_THAT(
      run_program({"optimize", in, "--gnc", "--certify", "--quiet"}).out,
      Contains("certified: no poses have a lower chordal cost") && Contains("their choice is not certified"));
  require_fields(json.at("seconds"), {"certificate"});
  REQUIRE_FALSE(json_of({"optimize", in}).contains("certificate"));

  // Headings wound once around a ring.
  PoseGraph ring;
  constexpr int kCount = 20;
  for (int i = 0; i < kCount; ++i) {
    Node node;
    node.key = static_cast<Key>(i);
    node.pose.linear() =
        Eigen::AngleAxisd(6.283185307179586 * i / kCount, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    ring.add_node(node);
  }
  for (int i = 0; i < kCount; ++i) {
    Edge edge;
    edge.from = static_cast<Key>(i);
    edge.to = static_cast<Key>((i + 1) % kCount);
    ring.add_edge(edge);
  }
  write_g2o(in, ring);
  const std::vector<std::string> command{"optimize", in, "-o", out, "--certify", "--initialization", "file"};
  json = json_of(command);
  REQUIRE(json.at("certificate").at("status") == "certified");
  REQUIRE(json.at("certificate").at("cost_before").get<double>() > 0.5);
  REQUIRE(json.at("cost").get<double>() < 1e-9);
  REQUIRE(graph_cost(read_g2o(out).graph) < 1e-9);
  REQUIRE_THAT(run_program(command).out, Contains("found a lower minimum"));

  // The same in the plane, where the result is written as 2D again.
  PoseGraph flat;
  flat.set_planar();
  for (Node node : ring.nodes()) {
    node.pose = planar::flattened(node.pose);
    flat.add_node(node);
  }
  for (const Edge& edge : ring.edges()) flat.add_edge(edge);
  write_g2o(in, flat);
  json = json_of(command);
  REQUIRE(json.at("planar") == true);
  REQUIRE(json.at("certificate").at("status") == "certified");
  REQUIRE(json.at("certificate").at("lower_minimum") == true);
  REQUIRE(json.at("cost").get<double>() < 1e-9);
  REQUIRE(read_g2o(out).graph.planar());
  REQUIRE(graph_cost(read_g2o(out).graph) < 1e-9);
}

TEST_CASE("evaluate: robots of a recording keep their names and ranges", "[apps]") {
  const TemporaryFolder folder;
  const Mission yard = small_mission(4);
  // Plain integers: the keys do not show where the second robot begins.
  const auto plain = [](Key key) { return key_index(key) + (key_character(key) == 'a' ? 0 : 4); };
  Mission mission;
  mission.robots = parse_robots("husky=0-3,spot=4-7");
  for (Node node : yard.graph.nodes()) {
    node.key = plain(node.key);
    mission.graph.add_node(node);
  }
  for (Edge edge : yard.graph.edges()) {
    edge.from = plain(edge.from);
    edge.to = plain(edge.to);
    mission.graph.add_edge(edge);
  }
  for (const auto& [key, pose] : yard.ground_truth) mission.ground_truth[plain(key)] = pose;
  const std::string recording = (folder / "mission").string();
  write_mission(recording, mission);
  const std::string estimate = (folder / "estimate.g2o").string();
  write_g2o(estimate, mission.graph);

  const Json of_recording = json_of({"evaluate", recording, recording}).at("robots");
  require_fields(of_recording, {"husky", "spot"});
  REQUIRE(of_recording.at("husky").at("poses") == 4);
  REQUIRE(json_of({"evaluate", estimate, recording}).at("robots") == of_recording);
  REQUIRE(json_of({"evaluate", estimate, recording, "--robots", "x=0-7"}).at("robots").contains("x"));
}

TEST_CASE("evaluate: fields, alignments, and trajectories that do not meet", "[apps]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(4);
  const std::string estimate = (folder / "estimate.g2o").string(), truth = (folder / "truth.g2o").string();
  write_g2o(estimate, mission.graph);
  PoseGraph true_graph = mission.graph;
  for (const auto& [key, pose] : mission.ground_truth) true_graph.set_pose(key, pose);
  write_g2o(truth, true_graph);
  for (const char* alignment : {"none", "first", "se3"}) {
    const Json json = json_of({"evaluate", estimate, truth, "--alignment", alignment});
    require_fields(json, {"poses", "ate_m", "ate_rad", "rpe", "robots"});
    for (const char* name : {"ate_m", "ate_rad"})
      require_fields(json.at(name), {"rmse", "mean", "median", "max"});
    REQUIRE(json.at("poses") == 8);
    REQUIRE(json.at("robots").size() == 2);
    REQUIRE(json.at("ate_m").at("max").get<double>() > 0.0);
  }
  // Recordings and runs as they are, by key or, with a TUM file, by stamp.
  const std::string recording = (folder / "mission").string(), run = (folder / "run").string();
  write_mission(recording, mission);
  const Json of_files = json_of({"evaluate", estimate, truth});
  REQUIRE(json_of({"evaluate", recording, recording}).at("ate_m") == of_files.at("ate_m"));
  REQUIRE(run_program({"replay", recording, "-o", run, "--method", "odom"}).status == kDone);
  REQUIRE(json_of({"evaluate", run, recording}).at("ate_m").at("mean").get<double>() ==
          Approx(of_files.at("ate_m").at("mean").get<double>()));
  const Json by_stamp = json_of({"evaluate", run + "/trajectories/a.tum", recording});
  REQUIRE(by_stamp.at("poses") == 4);
  REQUIRE(by_stamp.at("robots").size() == 1);
  const Json of_one = json_of({"evaluate", recording, run + "/trajectories/a.tum"});
  REQUIRE(of_one.at("poses") == 4);
  require_fields(of_one.at("robots"), {"a"});
  REQUIRE(json_of({"optimize", recording}).at("poses") == 8);
  REQUIRE(json_of({"optimize", run}).at("poses") == 8);
  REQUIRE(json_of({"info", run}).at("run") == true);
  REQUIRE(json_of({"info", run}).at("kind") == "run");
  REQUIRE_THAT(run_program({"info", run}).out,
               Contains("results of a replay \"run\"") && !Contains("g2o_pcd"));
  REQUIRE(json_of({"info", recording}).at("run") == false);
  testing::fs::remove(folder / "mission" / "ground_truth.g2o");
  require_failure({"evaluate", run, recording}, kBadInput, "mission: no ground truth is recorded there");

  const Json zero = json_of({"evaluate", truth, truth});
  REQUIRE(zero.at("ate_m").at("max").get<double>() == 0.0);

  PoseGraph other;
  Node node;
  node.key = 12345;
  other.add_node(node);
  write_g2o(folder / "other.g2o", other);
  require_failure({"evaluate", (folder / "other.g2o").string(), truth}, kBadInput, "");
  require_failure({"evaluate", estimate, truth, "--alignment", "sim3"}, kBadUsage, "sim3");
}

TEST_CASE("register: a pair that aligns and one that cannot", "[apps]") {
#ifdef LOOPWISE_WITH_PCL
  const std::string registrar = GENERATE("fast", "pcl");
#else
  const std::string registrar = "fast";
#endif
  CAPTURE(registrar);
  const TemporaryFolder folder;
  const testing::Scene scene(4);
  Rng rng(1);
  const Eigen::Isometry3d T_w_source = testing::ground_pose(1.0, 0.5, 0.3),
                          T_w_target = testing::ground_pose(0, 0, 0);
  const std::string source = (folder / "source.pcd").string(), target = (folder / "target.ply").string();
  write_pcd(source, *scene.scan(T_w_source, 4000, rng));
  write_ply(target, *scene.scan(T_w_target, 4000, rng));

  const std::string moved = (folder / "moved.ply").string();
  const Json json =
      json_of({"register", source, target, "--seed", "3", "--out", moved, "--registrar", registrar});
  require_fields(json, {"status", "T_target_source", "covariance", "fitness", "overlap", "seconds"});
  REQUIRE(json.at("status") == "verified");
  REQUIRE(json.at("T_target_source").size() == 16);
  Eigen::Isometry3d T;
  for (Eigen::Index i = 0; i < 16; ++i)
    T.matrix()(i / 4, i % 4) = json.at("T_target_source").at(std::size_t(i));
  const Eigen::Isometry3d error = (T_w_target.inverse() * T_w_source).inverse() * T;
  REQUIRE(error.translation().norm() < 0.1);
  REQUIRE(se3::rotation_angle(error) < 0.02);
  REQUIRE(json.at("covariance").size() == 36);
  REQUIRE(read_cloud(moved).cloud.size() == 4000);

  // Seeded: the same again, from the truth as a guess too.
  REQUIRE(
      json_of({"register", source, target, "--seed", "3", "--registrar", registrar}).at("T_target_source") ==
      json.at("T_target_source"));
  std::ostringstream guess;
  guess.precision(12);
  guess << (T_w_target.inverse() * T_w_source).matrix() << "\n";
  testing::write_text(folder / "guess.txt", guess.str());
  REQUIRE(json_of({"register", source, target, "--guess", (folder / "guess.txt").string()}).at("status") ==
          "verified");

  PointCloud few;
  few.points.emplace_back(1.0F, 2.0F, 3.0F);
  write_pcd(folder / "few.pcd", few);
  const Json refused = json_of({"register", (folder / "few.pcd").string(), target});
  REQUIRE(refused.at("status") == "rejected");
  REQUIRE(refused.at("reason") == "too_few_points");
}

TEST_CASE("info: missions, graphs and clouds", "[apps]") {
  const TemporaryFolder folder;
  const Mission mission = small_mission(4);
  write_mission(folder / "mission", mission);
  const std::vector<std::string> fields{"kind",   "robots",   "nodes",      "edges",   "scans",
                                        "points", "length_m", "duration_s", "problems"};
  Json json = json_of({"info", (folder / "mission").string()});
  require_fields(json, fields);
  REQUIRE(json.at("kind") == "mission");
  REQUIRE(json.at("nodes") == 8);
  REQUIRE(json.at("scans") == 8);
  REQUIRE(json.at("duration_s") == 13.0);
  REQUIRE(json.at("problems").empty());
  REQUIRE(json.at("robots").at(1).at("first_key") ==
          std::to_string(make_key('b', 0)));  // text: it exceeds 2^53

  json = json_of(
      {"info", (folder / "mission").string(), "--radius", "5", "--picture", (folder / "m.svg").string()});
  REQUIRE(json.at("candidates").at("radius_m") == 5.0);
  REQUIRE(json.at("drift").size() == json.at("robots").size());  // the truth is known
  REQUIRE_THAT(testing::read_text(folder / "m.svg"), Contains("</svg>"));

  testing::fs::remove(folder / "mission" / "scans" / (std::to_string(make_key('a', 2)) + ".pcd"));
  json = json_of({"info", (folder / "mission").string()});
  REQUIRE(json.at("scans") == 7);
  REQUIRE(json.at("problems").size() == 1);
  const auto cut = folder / "mission" / "scans" / (std::to_string(make_key('b', 1)) + ".pcd");
  testing::fs::resize_file(cut, testing::fs::file_size(cut) / 2);
  json = json_of({"info", (folder / "mission").string()});  // continues without it, as replay does
  REQUIRE(json.at("problems").size() == 2);

  json = json_of({"info", (folder / "mission" / "graph.g2o").string()});
  require_fields(json, fields);
  REQUIRE(json.at("kind") == "g2o");
  json = json_of(
      {"info", (folder / "mission" / "scans" / (std::to_string(make_key('a', 0)) + ".pcd")).string()});
  require_fields(json, fields);
  REQUIRE(json.at("points").at("total") == 1200);
}

TEST_CASE("rank: every candidate with its scores, the ranked first", "[apps]") {
  const TemporaryFolder folder;
  const std::string path = (folder / "yard").string(), csv = (folder / "candidates.csv").string();
  write_mission(path, small_mission());
  const std::vector<std::string> common{
      "rank", path, "--set", "generation.skip_recent=2", "--set", "observability.min_sum=0"};
  const auto rank = [&](std::vector<std::string> more) {
    more.insert(more.begin(), common.begin(), common.end());
    return json_of(more);
  };
  for (const char* method : {"baseline", "random", "obs", "gi", "full"}) {
    CAPTURE(method);
    const Json json = rank({"--method", method, "--count", "12", "--batch", "5", "-o", csv});
    require_fields(json, {"mission", "method", "seed", "candidates", "ranked", "refused", "gains_exact",
                          "trace_m2", "order"});
    REQUIRE(json.at("ranked") == 12);
    REQUIRE(json.at("order").size() == 12);
    REQUIRE(json.at("trace_m2").at("with_ranked").get<double>() <
            json.at("trace_m2").at("now").get<double>());
    const CsvTable table(csv, {"rank", "from", "to", "source", "distance_m", "observability_from",
                               "observability_to", "gain_m2", "connecting", "refused"});
    REQUIRE(table.size() == json.at("candidates").get<std::size_t>());
    for (std::size_t row = 0; row < table.size(); ++row) {
      REQUIRE(table.text(row, 0) == (row < 12 ? std::to_string(row + 1) : ""));
      REQUIRE(table.number(row, 7) > 0.0);
      REQUIRE(table.number(row, 5) > 0.0);
    }
    REQUIRE(json.at("order")[0].at("from") == table.text(0, 1));
    REQUIRE(rank({"--method", method, "--count", "12", "--batch", "5", "--threads", "2"}) ==
            rank({"--method", method, "--count", "12", "--batch", "5", "--threads", "1"}));
  }
  // Greedy graph information begins with the best single gain.
  const Json gi = rank({"--method", "gi", "--count", "1", "--batch", "1", "--evaluations", "0", "--set",
                        "graph_information.shortlist=10000"});
  const double first = gi.at("order")[0].at("gain_m2").get<double>();
  rank({"--method", "baseline", "-o", csv});
  const CsvTable table(csv, {"rank", "from", "to", "source", "distance_m", "observability_from",
                             "observability_to", "gain_m2", "connecting", "refused"});
  for (std::size_t row = 0; row < table.size(); ++row) REQUIRE(table.number(row, 7) <= first * (1.0 + 1e-9));

  require_failure({"rank", path, "--set", "graph_information.acceptance=sure"}, kBadUsage, "it was removed");
  REQUIRE(rank({"--method", "odom"}).at("ranked") == 0);
  require_failure({"rank", path, "--method", "best"}, kBadUsage, "best");
  require_failure({"rank", path, "--batch", "-1"}, kBadUsage, "replay.batch = -1");
  require_failure({"rank", (folder / "absent").string()}, kBadInput, "absent");
}

TEST_CASE("config: docs/configuration.md is the output of --markdown", "[apps]") {
  const ProgramRun run = run_program({"config", "--markdown"});
  REQUIRE(run.status == kDone);
  INFO("build/release/apps/loopwise config --markdown > docs/configuration.md");
  REQUIRE(run.out == testing::read_text(std::string(LOOPWISE_SOURCE_DIR) + "/docs/configuration.md"));
  const Json options = json_of({"config"});
  for (const auto& [section, fields] : options.items()) {
    REQUIRE_THAT(run.out, Contains("\n## " + section + "\n"));
    for (const auto& field : fields.items()) REQUIRE_THAT(run.out, Contains("\n| `" + field.key() + "` | "));
  }
  require_failure({"config", "--markdown", "--describe"}, kBadUsage, "--describe");
}

TEST_CASE("config: --config reads the printed configuration", "[apps]") {
  const TemporaryFolder folder;
  const ProgramRun defaults = run_program({"config"});
  REQUIRE(defaults.status == kDone);
  testing::write_text(folder / "c.json", defaults.out);
  const std::string path = (folder / "c.json").string();
  REQUIRE(run_program({"config", "--config", path}).out == defaults.out);
  const Json changed = json_of({"config", "--config", path, "--set", "replay.batch=7"});
  REQUIRE(changed.at("replay").at("batch") == 7);
  REQUIRE_THAT(run_program({"config", "--describe"}).out, Contains("replay.batch = 0   (>= 0)"));
}

TEST_CASE("replay: files, fields, the same bytes for any number of threads, and again after a kill",
          "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission());
  const auto replay = [&](const std::string& out, const std::vector<std::string>& more) {
    std::vector<std::string> arguments{"replay",
                                       (folder / "mission").string(),
                                       "-o",
                                       (folder / out).string(),
                                       "--method",
                                       "random",
                                       "--batch",
                                       "5",
                                       "--max-registrations",
                                       "12",
                                       "--registration-time",
                                       "0.5",
                                       "--workers",
                                       "2",
                                       "--skip-recent",
                                       "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  };
  const Json json = json_of(replay("one", {"--threads", "1"}));
  require_fields(json, {"candidates", "closures", "reasons", "ate_m", "ate_se3_m", "ate_rmse_m", "rpe",
                        "robots", "seconds", "seed", "options"});
  const Json& candidates = json.at("candidates");
  require_fields(candidates, {"generated", "pruned", "expired", "pending", "computed", "queued"});
  const auto count = [&](const char* name) { return candidates.at(name).get<std::size_t>(); };
  REQUIRE(count("computed") == 12);
  REQUIRE(count("generated") == count("pruned") + count("expired") + count("pending") + count("computed"));
  REQUIRE(count("queued") == count("generated") - count("pruned"));
  require_fields(json.at("closures"), {"verified", "gnc_inliers", "true_inliers"});
  for (const char* name : {"ate_m", "ate_se3_m", "ate_rmse_m"})
    require_fields(json.at(name), {"odometry", "optimized"});
  REQUIRE(parse_json(testing::read_text(folder / "one" / "summary.json"), "summary.json") == json);

  const CsvTable rows(folder / "one" / "closures.csv", kClosureColumns);
  REQUIRE(rows.size() == 12);
  std::size_t verified = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    REQUIRE(rows.key(i, 0) != rows.key(i, 1));
    verified += rows.text(i, 3) == "verified" ? 1 : 0;
  }
  REQUIRE(json.at("closures").at("verified") == verified);
  REQUIRE(verified > 0);
  for (const char* file :
       {"graph.g2o", "journal.jsonl", "map.pcd", "picture.svg", "trajectories/a.tum", "trajectories/b.tum"}) {
    CAPTURE(file);
    REQUIRE(testing::fs::exists(folder / "one" / file));
  }

  const auto same_results = [&](const std::string& other) {
    REQUIRE(without_seconds(testing::read_text(folder / "one" / "closures.csv")) ==
            without_seconds(testing::read_text(folder / other / "closures.csv")));
    for (const char* file : {"graph.g2o", "journal.jsonl", "map.pcd"}) {
      CAPTURE(file);
      REQUIRE(testing::read_text(folder / "one" / file) == testing::read_text(folder / other / file));
    }
  };
  REQUIRE(run_program(replay("two", {"--threads", "2", "--quiet"})).status == kDone);
  same_results("two");

  // As a kill leaves it: half of the outcomes, the last one cut short, no results.
  const std::string outcomes = testing::read_text(folder / "two" / "outcomes.jsonl");
  const std::size_t first = outcomes.find('\n') + 1;  // after the header
  const std::size_t cut = first + (outcomes.size() - first) / 2;
  REQUIRE(outcomes.find('\n', first) < cut);
  testing::write_text(folder / "two" / "outcomes.jsonl", outcomes.substr(0, cut));
  for (const char* file : {"summary.json", "closures.csv", "graph.g2o"})
    testing::fs::remove(folder / "two" / file);
  const ProgramRun resumed = run_program(replay("two", {"--resume"}));
  REQUIRE(resumed.status == kDone);
  REQUIRE_THAT(resumed.err, Contains("already computed"));
  same_results("two");

  // Results that failed because of memory or a file are computed again.
  std::istringstream lines(outcomes);
  std::string line, with_failures;
  for (std::size_t number = 0; std::getline(lines, line); ++number) {
    if (number > 0 && number % 2 == 0) {
      Json outcome = parse_json(line, "outcome");
      outcome["outcome"] = "rejected";
      outcome["reason"] = number % 4 == 0 ? "failed" : "missing_scan";
      outcome.erase("closure");
      line = outcome.dump();
    }
    with_failures += line + "\n";
  }
  testing::write_text(folder / "two" / "outcomes.jsonl", with_failures);
  REQUIRE_THAT(run_program(replay("two", {"--resume"})).err,
               Contains("with 6 registrations already computed"));
  same_results("two");

  // After a loss of power, data that did not reach the disk read as zeros, also between other lines.
  std::string holes = outcomes;
  const std::size_t third = holes.find('\n', holes.find('\n', holes.find('\n') + 1) + 1);
  holes.replace(third - 10, 20, std::string(20, '\0'));
  testing::write_text(folder / "two" / "outcomes.jsonl", holes);
  REQUIRE_THAT(run_program(replay("two", {"--resume"})).err, Contains("are computed again: 1"));
  same_results("two");

  require_failure(replay("one", {}), kBadUsage, "not empty");
  require_failure(replay("two", {"--resume", "--seed", "9"}), kBadUsage, "other options: engine.seed was 1");
  require_failure(replay("two", {"--resume", "--overwrite"}), kBadUsage, "give one of them");
  for (const char* kept : {"summary.json", "map.pcd", "picture.svg", "journal.jsonl"}) {
    CAPTURE(kept);
    REQUIRE(std::filesystem::exists(folder / "two" / kept));  // a refused command has removed no file
  }
  std::string of_earlier_code = outcomes;
  const std::size_t code = of_earlier_code.find("\"code\":\"");
  REQUIRE(code < of_earlier_code.find('\n'));
  of_earlier_code.replace(code + 8, 1, "x");
  testing::write_text(folder / "two" / "outcomes.jsonl", of_earlier_code);
  require_failure(replay("two", {"--resume"}), kBadUsage, "another version");
  for (const char* odd : {"[1]\n", "{\"code\": 3, \"options\": {}}\n", "{\"code\n"}) {
    CAPTURE(odd);
    testing::write_text(folder / "two" / "outcomes.jsonl", odd);
    require_failure(replay("two", {"--resume"}), kBadUsage, "another version");
  }
  testing::write_text(folder / "two" / "outcomes.jsonl",
                      outcomes.substr(0, outcomes.find('\n') + 1) + "{\"from\": 1}\n");
  require_failure(replay("two", {"--resume"}), kBadInput, "outcomes.jsonl:2: ");
  // A mission of the same name and size whose contents have changed.
  testing::write_text(folder / "two" / "outcomes.jsonl", outcomes);
  const auto stamps = folder / "mission" / "stamps.csv";
  const std::string recorded = testing::read_text(stamps);
  testing::write_text(stamps, recorded.substr(0, recorded.size() - 2) +
                                  (recorded[recorded.size() - 2] == '9' ? "8\n" : "9\n"));
  require_failure(replay("two", {"--resume"}), kBadUsage, "another mission");
  testing::write_text(stamps, recorded);
  require_failure(
      {"replay", (folder / "mission").string(), "-o", (folder / "three").string(), "--method", ""}, kBadUsage,
      "a name is missing");
  require_failure(
      {"replay", (folder / "mission").string(), "-o", (folder / "three").string(), "--method", "best"},
      kBadUsage, "best");
  testing::write_text(folder / "file", "");
  require_failure(replay("file", {}), kBadUsage, "not a folder");
}

TEST_CASE("command line: failed writes are reported, and no former results remain next to new ones",
          "[apps][error]") {
  const TemporaryFolder folder;
  write_g2o(folder / "graph.g2o", small_graph());
  const std::vector<std::string> info{"info", (folder / "graph.g2o").string()};
  if (testing::fs::exists("/dev/full")) {
    for (const char* more : {"", "--json=-"}) {
      std::string command = std::string("'") + LOOPWISE_PROGRAM + "' info '" + info[1] + "' " + more;
      const int status =
          std::system((command + " > /dev/full 2> '" + (folder / "err").string() + "'").c_str());
      REQUIRE(WEXITSTATUS(status) == kBadInput);
      REQUIRE_THAT(testing::read_text(folder / "err"), Contains("standard output: cannot be written"));
    }
  }
  write_mission(folder / "mission", small_mission(3));
  // A folder in the place of a result cannot be removed as a file.
  testing::fs::create_directories(folder / "out" / "summary.json" / "kept");
  const ProgramRun run = run_program({"replay", (folder / "mission").string(), "-o",
                                      (folder / "out").string(), "--overwrite", "--method", "odom"});
  REQUIRE(run.status == kBadInput);
  REQUIRE_THAT(run.err, Contains("summary.json") && Contains("cannot be removed"));
}

TEST_CASE("replay: results of a real clock are written even if the journal fails", "[apps][error]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(3));
  const testing::fs::path out = folder / "out", pipe = out / "journal.jsonl";
  testing::fs::create_directories(out);
  REQUIRE(mkfifo(pipe.c_str(), 0600) == 0);
  // The reader leaves after the first line; from then on every line fails.
  const std::string command =
      "head -n 1 '" + pipe.string() + "' > /dev/null & trap '' PIPE; '" + LOOPWISE_PROGRAM + "' replay '" +
      (folder / "mission").string() + "' -o '" + out.string() +
      "' --overwrite --clock real --rate 20 --set generation.skip_recent=1 --after-mission 2> '" +
      (folder / "err").string() + "' > /dev/null";
  const int status = std::system(command.c_str());
  const std::string err = testing::read_text(folder / "err");
  INFO(err);
  REQUIRE(WEXITSTATUS(status) == kBadInput);
  REQUIRE_THAT(err, Contains("journal.jsonl: cannot be written"));
  const Json summary = parse_json(testing::read_text(out / "summary.json"), "summary.json");
  REQUIRE(summary.at("candidates").at("computed").get<std::size_t>() > 0);
  REQUIRE(CsvTable(out / "closures.csv", kClosureColumns).size() ==
          summary.at("candidates").at("computed").get<std::size_t>());
  REQUIRE(testing::fs::exists(out / "map.pcd"));
}

TEST_CASE("replay: trajectories of former robots are removed", "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(3));
  const auto replay = [&](const std::string& robots) {
    return run_program({"replay", (folder / "mission").string(), "-o", (folder / "out").string(),
                        "--overwrite", "--method", "odom", "--robots", robots});
  };
  const testing::fs::path trajectories = folder / "out" / "trajectories";
  REQUIRE(replay("first=a,second=b").status == kDone);
  REQUIRE(testing::fs::exists(trajectories / "second_odometry.tum"));
  testing::write_text(trajectories / "notes.txt", "of the user");
  REQUIRE(replay("one=a,two=b").status == kDone);
  std::set<std::string> names;
  for (const auto& entry : testing::fs::directory_iterator(trajectories))
    names.insert(entry.path().filename());
  REQUIRE(names ==
          std::set<std::string>{"notes.txt", "one.tum", "one_odometry.tum", "two.tum", "two_odometry.tum"});
}

TEST_CASE("replay: robots of any name have their files", "[apps]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(3);
  const std::string longest(300, 'x');
  mission.robots = Robots({robot_of_character('a', longest + "1"), robot_of_character('b', longest + "2")});
  write_mission(folder / "long", mission);
  const std::string recorded = (folder / "long").string();
  REQUIRE(run_program({"replay", recorded, "-o", (folder / "out").string(), "--method", "odom"}).status ==
          kDone);
  REQUIRE(testing::fs::exists(folder / "out" / "trajectories" / (longest.substr(0, 100) + "_1.tum")));
  REQUIRE(run_program({"convert", recorded, "-o", (folder / "tum").string(), "--to", "tum"}).status == kDone);

  // Folders of another encoding: each robot its own name, in files that are UTF-8.
  const testing::fs::path one = folder / "K\xf6ln.g2o", two = folder / "K\xe4ln.g2o";
  write_g2o(one, small_graph());
  write_g2o(two, small_graph());
  const testing::fs::path joined = folder / "joined";
  const Json json =
      json_of({"replay", one.string(), two.string(), "-o", joined.string(), "--method", "odom"});
  REQUIRE(json.at("mission") == "K%F6ln+K%E4ln");
  REQUIRE(json.at("robots").size() == 2);
  REQUIRE(json.at("robots").contains("K%E4ln"));
  REQUIRE(run_program(
              {"report", joined.string(), "--mission", joined.string(), "-o", (folder / "r.html").string()})
              .status != kDone);
  REQUIRE(run_program({"report", joined.string(), "-o", (folder / "r.html").string()}).status == kDone);
  const ProgramRun converted = run_program(
      {"convert", one.string(), two.string(), "-o", (folder / "made").string(), "--to", "mission"});
  INFO(converted.err);
  REQUIRE(converted.status == kDone);
  REQUIRE(read_mission(folder / "made").robots[1].name == "K%E4ln");
}

TEST_CASE("replay: recordings are never written over", "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(3));
  write_mission(folder / "other", small_mission(4));
  testing::fs::copy(folder / "mission" / "graph.g2o", folder / "alone.g2o");
  const std::string mission = (folder / "mission").string();
  const std::string recorded = testing::read_text(folder / "mission" / "graph.g2o");
  for (const char* option : {"--overwrite", "--resume"}) {
    require_failure({"replay", mission, "-o", mission, option}, kBadUsage, "mission lies there");
    require_failure({"replay", mission + "/", "-o", mission + "/../mission", option}, kBadUsage,
                    "lies there");
    require_failure({"replay", mission, "-o", (folder / "other").string(), option}, kBadUsage,
                    "there is a recording (mission.json)");
    require_failure({"replay", (folder / "alone.g2o").string(), "-o", folder.path().string(), option},
                    kBadUsage, "alone.g2o lies there");
  }
  REQUIRE(testing::read_text(folder / "mission" / "graph.g2o") == recorded);
}

TEST_CASE("replay: its text on runs that cannot be judged", "[apps]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(3);
  write_mission(folder / "mission", mission);
  const std::string recorded = (folder / "mission").string();
  ProgramRun run = run_program({"replay", recorded, "-o", (folder / "radio").string(), "--method", "rssi"});
  REQUIRE_THAT(run.err, Contains("no radio readings"));
  REQUIRE_THAT(run.out, Contains("not_radio"));
  run = run_program({"replay", recorded, "-o", (folder / "all").string(), "--after-mission", "--set",
                     "generation.skip_recent=1"});
  REQUIRE_THAT(run.out, Contains("the method hardly matters") && Contains("ATE mean"));
  run = run_program({"replay", recorded, "-o", (folder / "one").string(), "--max-registrations", "1", "--set",
                     "generation.skip_recent=1"});
  REQUIRE_THAT(run.out, Contains("beyond --max-registrations"));

  for (const Node& node : mission.graph.nodes()) mission.ground_truth[node.key] = node.pose;  // of odometry
  write_mission(folder / "own_truth", mission);
  const std::string own = (folder / "own_truth").string();
  run = run_program({"replay", own, "-o", (folder / "own").string()});
  REQUIRE_THAT(run.out, Contains("not judged: odometry and truth are the same poses") &&
                            !Contains("true inliers") && !Contains("ATE mean"));
  run = run_program({"evaluate", (folder / "own").string(), own});
  REQUIRE(run.status == 0);
  REQUIRE_THAT(run.err, Contains("own_truth: odometry and truth are the same poses"));
  run = run_program({"evaluate", (folder / "one").string(), recorded});
  REQUIRE_THAT(run.err, !Contains("the same poses"));
  run = run_program({"replay", own, "-o", (folder / "noisy").string(), "--odometry-noise", "0.05", "0.01"});
  REQUIRE_THAT(run.out, Contains("true inliers") && Contains("ATE mean"));
}

TEST_CASE("replay: an interrupt ends it with the results so far", "[apps]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(30));
  const testing::fs::path out = folder / "out", outcomes = out / "outcomes.jsonl";
  const auto lines = [&] {
    const std::string text = testing::fs::exists(outcomes) ? testing::read_text(outcomes) : "";
    return std::count(text.begin(), text.end(), '\n');
  };
  ProgramRun run;
  Json summary;
  std::size_t pending = 0;
  // On a busy machine it may compute its last candidate before the interrupt reaches it.
  for (int trial = 0; trial < 10 && pending == 0; ++trial) {
    testing::fs::remove_all(out);
    testing::Program program({"replay", (folder / "mission").string(), "-o", out.string(), "--method",
                              "baseline", "--after-mission", "--threads", "1"});
    // Once the first outcomes are on disk; hundreds are to come.
    while (lines() < 3 && program.running()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    program.interrupt();
    run = program.finish();
    if (run.status != kInterrupted) continue;
    summary = parse_json(testing::read_text(out / "summary.json"), "summary.json");
    pending = summary.at("candidates").at("pending").get<std::size_t>();
  }
  INFO(run.err);
  REQUIRE(pending > 0);
  REQUIRE(summary.at("interrupted") == true);
  REQUIRE(CsvTable(out / "closures.csv", kClosureColumns).size() ==
          summary.at("candidates").at("computed").get<std::size_t>());
}

}  // namespace loopwise::command_line_test
