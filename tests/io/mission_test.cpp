// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/mission.hpp>

#include <sys/stat.h>

#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::mission_test {
namespace {

namespace fs = std::filesystem;
using testing::random_cloud;
using testing::TemporaryFolder;

/// Two robots of five nodes, one closure, everything that a mission may hold.
Mission make_mission() {
  Rng rng(3);
  Mission mission;
  mission.name = "two robots";
  mission.frame = "tunnel";
  mission.provenance_json = "{\"seed\":3}";
  mission.robots = Robots({robot_of_character('a', "husky"), robot_of_character('b', "spot")});
  mission.start_ns = 1'600'000'000'000'000'000;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < 5; ++i) {
      Node node;
      node.key = make_key(robot, i);
      node.pose = testing::random_pose(rng, 50.0);
      node.stamp_ns = mission.start_ns + static_cast<std::int64_t>(i) * 2'000'000'001 + 17;
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = testing::random_pose(rng, 50.0);
      mission.reference[node.key] = testing::random_pose(rng, 50.0);
      if (i == 0) continue;
      Edge edge{node.key - 1, node.key, testing::random_pose(rng), 100.0 * Matrix6d::Identity()};
      edge.kind = EdgeKind::kOdometry;
      mission.graph.add_edge(edge);
    }
  }
  mission.graph.add_edge(
      {make_key('a', 4), make_key('b', 0), testing::random_pose(rng), Matrix6d::Identity()});
  Vector6d information;
  information << 1e4, 1e4, 4e4, 600.0, 600.0, 6e6;
  mission.graph.add_prior({make_key('a', 0), testing::random_pose(rng), Matrix6d(information.asDiagonal())});
  Matrix6d correlated = Matrix6d::Identity();
  correlated(0, 1) = correlated(1, 0) = 0.5;
  mission.graph.add_prior({make_key('b', 0), testing::random_pose(rng), correlated});
  mission.gaps = {{0, 1.5, 3.25}, {1, 0.0, 7.0}};
  mission.radio = {{make_key('a', 2), "beacon 1", 20.0, "0", -55.5},
                   {make_key('a', 2), "beacon 1", 20.0, "1", NAN}};
  mission.beacons = {{"beacon 1", 1, make_key('b', 3), mission.start_ns + 5}};
  return mission;
}

fs::path write_complete(const TemporaryFolder& folder) {
  const MissionWriter writer(folder / "m");
  const Mission mission = make_mission();
  for (const Key key : mission.graph.keys())
    writer.add_scan(key, random_cloud(20, false, true, unsigned(key % 97)));
  writer.finish(mission);
  return folder / "m";
}

void write_session(const fs::path& folder, std::size_t count) {
  fs::create_directories(folder / "Scans");
  std::string poses, times;
  for (std::size_t i = 0; i < count; ++i) {
    poses += "1 0 0 " + std::to_string(2 * i) + " 0 1 0 0 0 0 1 0\n";
    times += "100." + std::to_string(i) + "\n";
    std::string name = std::to_string(i);
    name.insert(0, 6 - name.size(), '0');
    write_pcd(folder / "Scans" / (name + ".pcd"), random_cloud(5 + i, false, true));
  }
  testing::write_text(folder / "optimized_poses.txt", poses);
  testing::write_text(folder / "times.txt", times);
}

TEST_CASE("mission: a written folder is read back unchanged", "[io][mission]") {
  const TemporaryFolder folder;
  const Mission a = make_mission();
  const Mission b = read_mission(write_complete(folder));
  CHECK(b.problems.empty());
  CHECK(b.kind == MissionKind::kMission);
  CHECK(b.name == a.name);
  CHECK(b.frame == a.frame);
  CHECK(b.provenance_json == a.provenance_json);
  CHECK(b.start_ns == a.start_ns);
  REQUIRE(b.robots.size() == 2);
  CHECK(b.robots[0].name == "husky");
  CHECK(b.robots[1].last == a.robots[1].last);
  REQUIRE(b.graph.keys() == a.graph.keys());
  for (std::size_t i = 0; i < a.graph.nodes().size(); ++i) {
    CHECK(testing::difference(a.graph.nodes()[i].pose, b.graph.nodes()[i].pose) < 1e-14);
    CHECK(a.graph.nodes()[i].stamp_ns == b.graph.nodes()[i].stamp_ns);
  }
  REQUIRE(b.graph.edges().size() == a.graph.edges().size());
  for (std::size_t e = 0; e < a.graph.edges().size(); ++e)
    CHECK(a.graph.edges()[e].kind == b.graph.edges()[e].kind);
  REQUIRE(b.graph.priors().size() == 2);
  for (const PriorFactor& prior : a.graph.priors()) {
    const auto same = [&](const PriorFactor& other) {
      // Through sigmas and back: measured relative difference 2e-16.
      return other.key == prior.key && testing::difference(other.pose, prior.pose) < 1e-14 &&
             other.information.isApprox(prior.information, 1e-13);
    };
    CHECK(std::any_of(b.graph.priors().begin(), b.graph.priors().end(), same));
  }
  REQUIRE(b.ground_truth.size() == a.ground_truth.size());
  for (const auto& [key, pose] : a.ground_truth)
    CHECK(testing::difference(pose, b.ground_truth.at(key)) < 1e-14);
  REQUIRE(b.reference.size() == a.reference.size());
  for (const auto& [key, pose] : a.reference) CHECK(testing::difference(pose, b.reference.at(key)) < 1e-14);
  REQUIRE(b.gaps.size() == 2);
  CHECK((b.gaps[0].robot == 0 && b.gaps[0].begin_s == 1.5 && b.gaps[0].end_s == 3.25));
  REQUIRE(b.radio.size() == 2);
  CHECK((b.radio[0].beacon == "beacon 1" && b.radio[0].receive_dbm == -55.5 && b.radio[1].receiver == "1"));
  CHECK(std::isnan(b.radio[1].receive_dbm));
  REQUIRE(b.beacons.size() == 1);
  CHECK((b.beacons[0].robot == 1 && b.beacons[0].drop_key == make_key('b', 3)));
  CHECK(b.scans->keys() == std::vector<Key>(a.graph.keys()));
  CHECK(b.scans->load(make_key('a', 1))->size() == 20);
  CHECK(b.time_s(b.start_ns + 1'500'000'000) == 1.5);

  write_mission(folder / "again", b);
  const Mission c = read_mission(folder / "again" / "mission.json");
  CHECK(c.problems.empty());
  for (const char* file :
       {"graph.g2o", "stamps.csv", "radio.csv", "beacons.csv", "ground_truth.g2o", "mission.json"}) {
    CHECK(c.path.filename() == "again");
    CHECK(fs::exists(folder / "again" / file));
  }
  CHECK(read_file(folder / "again" / "stamps.csv") == read_file(folder / "m" / "stamps.csv"));
  CHECK(read_file(folder / "again" / "mission.json") == read_file(folder / "m" / "mission.json"));
}

TEST_CASE("mission: its files lie in its folder, by name; links that its owner made are followed",
          "[io][mission]") {
  const TemporaryFolder folder;
  const fs::path mission = write_complete(folder);
  fs::create_directories(folder / "disk");
  fs::rename(mission / "scans", folder / "disk" / "scans");
  fs::create_directory_symlink(folder / "disk" / "scans", mission / "scans");
  CHECK(read_mission(mission).scans->load(make_key('a', 1))->size() == 20);

  // Names are taken apart as text: behind a link, .. is the mission's folder again, not the link's target's
  // parent.
  testing::write_text(folder / "disk" / "other.g2o", "not of this mission\n");
  const auto with_graph = [&](const std::string& name) {
    Json json = parse_json(testing::read_text(mission / "mission.json"), "mission.json");
    json["files"] = {{"graph", name}};
    testing::write_text(mission / "mission.json", json.dump());
  };
  with_graph("scans/../graph.g2o");
  CHECK(read_mission(mission).graph.nodes().size() == 10);
  with_graph("scans/../other.g2o");
  CHECK_THROWS_WITH(read_mission(mission), Contains((mission / "other.g2o").string()));
  for (const char* name :
       {"scans/../../disk/other.g2o", "..", "../m/graph.g2o", "/etc/passwd", "./../disk/other.g2o"}) {
    CAPTURE(name);
    with_graph(name);
    CHECK_THROWS_WITH(read_mission(mission), Contains("is outside of the mission's folder"));
  }
}

TEST_CASE("mission: pipes instead of files are counted or errors, never a wait", "[io][mission][error]") {
  const TemporaryFolder folder;
  const fs::path mission = write_complete(folder);
  REQUIRE(::mkfifo((mission / "scans" / "7.pcd").c_str(), 0600) == 0);
  CHECK(read_mission(mission).problems.count("foreign file in scans") == 1);
  for (const char* name : {"graph.g2o", "stamps.csv"}) {
    CAPTURE(name);
    fs::rename(mission / name, folder / "aside");
    REQUIRE(::mkfifo((mission / name).c_str(), 0600) == 0);
    CHECK_THROWS_WITH(read_mission(mission), Contains(std::string(name) + ": is not a file"));
    fs::rename(folder / "aside", mission / name);
  }
}

TEST_CASE("mission: landmarks, ranges and gravity are read back", "[io][mission]") {
  const TemporaryFolder folder;
  Mission a = make_mission();
  std::vector<Robot> robots = a.robots.all();
  robots.push_back(robot_of_character('A', "artifacts"));
  robots.back().landmarks = true;
  a.robots = Robots(std::move(robots));
  Node artifact;
  artifact.key = make_key('A', 7);
  artifact.stamp_ns = a.start_ns + 9;
  a.graph.add_node(artifact);
  Edge sighting{make_key('b', 2), artifact.key, Eigen::Isometry3d::Identity(), Matrix6d::Identity()};
  sighting.kind = EdgeKind::kLandmark;
  a.graph.add_edge(sighting);
  a.graph.add_range({make_key('a', 1), make_key('b', 3), 12.25, 0.1});
  GravityFactor gravity;
  gravity.key = make_key('a', 2);
  gravity.direction = Eigen::Vector3d(0.1, 0.0, -3.0);
  gravity.sigma_rad = 0.02;
  a.graph.add_gravity(gravity);
  MissionWriter(folder / "m").finish(a);

  const Mission b = read_mission(folder / "m");
  CHECK(b.robots.is_landmark(artifact.key));
  CHECK_FALSE(b.robots.is_landmark(make_key('a', 2)));
  CHECK(b.graph.edges().back().kind == EdgeKind::kLandmark);
  REQUIRE(b.graph.ranges().size() == 1);
  CHECK(b.graph.ranges()[0].to == make_key('b', 3));
  CHECK(b.graph.ranges()[0].range_m == 12.25);
  REQUIRE(b.graph.gravities().size() == 1);
  CHECK((b.graph.gravities()[0].direction - a.graph.gravities()[0].direction).norm() < 1e-15);
  CHECK(b.problems.count("node without ground truth") == 0);
  CHECK(b.problems.count("node without scan") == a.graph.nodes().size() - 1);
  CHECK(b.graph.priors().size() == 2);

  gravity.reference = Eigen::Vector3d::UnitX();
  a.graph.add_gravity(gravity);
  CHECK_THROWS_WITH(MissionWriter(folder / "other").finish(a), Contains("gravity at node a2"));
  CHECK_FALSE(fs::exists(folder / "other" / "mission.json"));
  const auto refused = [&](const char* file, const std::string& text, const std::string& why) {
    testing::write_text(folder / "m" / file, text);
    CHECK_THROWS_WITH(read_mission(folder / "m"), Contains(std::string(file) + ":3") && Contains(why));
  };
  refused("gravity.csv", "key,x,y,z,sigma_rad\na1,0,0,-1,0.1\na1,0,0,0,0.1\n", "no length");
  const Eigen::Vector3d up =
      b.graph.node(make_key('a', 2)).pose.linear().transpose() * Eigen::Vector3d(0.0, 0.1, 9.81);
  const auto row = [](const Eigen::Vector3d& v) {
    return "a2," + std::to_string(v.x()) + "," + std::to_string(v.y()) + "," + std::to_string(v.z()) +
           ",0.1\n";
  };
  testing::write_text(folder / "m" / "gravity.csv", "key,x,y,z,sigma_rad\n" + row(-up) + row(up));
  const Mission accelerometer = read_mission(folder / "m");
  CHECK(accelerometer.graph.gravities().size() == 1);
  CHECK(accelerometer.problems.count("gravity factor that points up left out") == 1);
  testing::write_text(folder / "m" / "gravity.csv", "key,x,y,z,sigma_rad\n");
  refused("ranges.csv", "from,to,range_m,sigma_m\na1,b1,1,1\na1,b9,1,1\n", "not in the graph");
  refused("ranges.csv", "from,to,range_m,sigma_m\na1,b1,1,1\na1,b1,-2,1\n", "not a valid distance");
  refused("ranges.csv", "from,to,range_m,sigma_m\na1,b1,1,1\na1,b1,2,0\n", "not positive");
}

TEST_CASE("mission: tables that no reader takes, and a clock without stamps", "[io][mission]") {
  const TemporaryFolder folder;
  MissionWriter(folder / "m").finish(make_mission());
  CHECK(read_mission(folder / "m").problems.count("file not read") == 0);
  fs::copy(folder / "m" / "graph.g2o", folder / "m" / "groundtruth.g2o");
  testing::write_text(folder / "m" / "notes.txt", "any");
  CHECK(read_mission(folder / "m").problems.count("file not read") == 1);
  fs::remove(folder / "m" / "stamps.csv");
  CHECK_THROWS_WITH(read_mission(folder / "m"),
                    Contains("clock.start_ns") && Contains("stamps.csv") && Contains("leave out clock"));
}

TEST_CASE("mission: a folder is no mission before it is finished", "[io][mission][error]") {
  const TemporaryFolder folder;
  const MissionWriter writer(folder / "m");
  writer.add_scan(make_key('a', 0), random_cloud(3, false, false));
  CHECK_THROWS_WITH(read_mission(folder / "m"), Contains("expected mission.json"));
  testing::write_text(folder / "m" / "graph.g2o",
                      "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");  // the part that comes first
  CHECK_THROWS_WITH(read_mission(folder / "m"), Contains("incomplete mission"));
  CHECK_THROWS_AS(MissionWriter(folder / "m"), IoError);
  CHECK_THROWS_WITH(MissionWriter(folder / "m"), Contains("is not empty"));
  testing::write_text(folder / "file", "");
  CHECK_THROWS_WITH(MissionWriter(folder / "file"), Contains("is not a folder"));
  CHECK_THROWS_AS(MissionWriter(folder / "file" / "m"), IoError);
  Mission mission = make_mission();
  mission.provenance_json = "[";
  CHECK_THROWS_WITH(writer.finish(mission), Contains("provenance"));
  CHECK_THROWS_AS(read_mission(folder / "m"), InputError);
  CHECK_THROWS_AS(read_mission(folder / "none"), IoError);
}

TEST_CASE("mission: missing data are supplied and counted", "[io][mission]") {
  const TemporaryFolder folder;
  const fs::path path = write_complete(folder);
  fs::remove(path / "stamps.csv");
  fs::remove(path / "priors.csv");
  std::string graph = read_file(path / "graph.g2o");
  graph.erase(graph.find("EDGE_SE3_PRIOR"),
              graph.find('\n', graph.find("EDGE_SE3_PRIOR")) - graph.find("EDGE_SE3_PRIOR"));
  write_file(path / "graph.g2o", graph);
  std::string json = read_file(path / "mission.json");
  json.replace(json.find("1600000000000000000"), 19, "-5");
  write_file(path / "mission.json", json);
  fs::remove(path / "scans" / (std::to_string(make_key('a', 2)) + ".pcd"));
  write_pcd(path / "scans" / "c7.pcd", random_cloud(2, false, false));
  testing::write_text(path / "scans" / "notes.txt", "");
  testing::write_text(path / "scans" / "map.pcd", "");
  write_ply(path / "scans" / "a1.ply", random_cloud(2, false, false));

  MissionOptions options;
  options.node_interval_s = 0.5;
  const Mission mission = read_mission(path, options);
  CHECK(mission.problems.count("no stamps given") == 1);
  CHECK(mission.problems.count("no prior given") == 2);
  CHECK(mission.problems.count("node without scan") == 1);
  CHECK(mission.problems.count("scan without node") == 1);
  CHECK(mission.problems.count("foreign file in scans") == 2);
  CHECK(mission.problems.count("repeated scan") == 1);
  CHECK(mission.problems.all().size() == 6);
  CHECK(mission.graph.node(make_key('b', 3)).stamp_ns == 1'500'000'000);
  CHECK(mission.start_ns == -5);
  REQUIRE(mission.graph.priors().size() == 2);
  CHECK(mission.graph.priors()[1].key == make_key('b', 0));
  CHECK(mission.graph.priors()[0].information(5, 5) == Approx(1.0 / (0.00041 * 0.00041)));
  CHECK(testing::difference(mission.graph.priors()[0].pose, mission.graph.node(make_key('a', 0)).pose) ==
        0.0);
  CHECK(mission.scans->load(make_key('a', 2)) == nullptr);
}

TEST_CASE("mission: contradictions name file and line or key", "[io][mission][error]") {
  const TemporaryFolder folder;
  const fs::path path = write_complete(folder);
  const std::string a0 = std::to_string(make_key('a', 0)), c0 = std::to_string(make_key('c', 0));
  struct Bad {
    std::string file;
    std::string find;  // in the file; empty: the whole
    std::string replace;
    std::string message;
  };
  const std::string prior_header = "key,x,y,z,qx,qy,qz,qw,sx,sy,sz,srx,sry,srz\n";
  const Bad bad = GENERATE_COPY(values<Bad>({
      {"mission.json", "\"version\": 1", "\"version\": 2",
       "mission.json: version: is 2, this program reads version 1"},
      {"mission.json", "\"version\": 1", "\"version\": 1, \"speed\": 3", "unknown key speed"},
      {"mission.json", "\"name\": \"husky\"", "\"nam\": \"husky\"",
       "unknown key robots[0].nam, did you mean robots[0].name?"},
      {"mission.json", "loopwise-mission", "other", "mission.json: format: must be \"loopwise-mission\""},
      {"mission.json", "\"robot\": \"spot\"", "\"robot\": \"x\"",
       "communication_gaps[1].robot: \"x\" is not a robot"},
      {"mission.json", "\"end_s\": 3.25", "\"end_s\": 1.25",
       "communication_gaps[0]: end_s must be after begin_s"},
      {"mission.json", "\"start_ns\": \"16", "\"start_ns\": \"26", "is after the first stamp"},
      {"mission.json", "\"version\": 1", "\"version\": 1, \"files\": {\"graph\": \"../g.g2o\"}",
       "is outside of"},
      {"mission.json", "\"version\": 1", "\"version\": 1, \"files\": {\"scans\": \"/tmp\"}", "is outside of"},
      {"mission.json", "\"version\": 1", "\"version\": 1, \"files\": {\"scans\": \"a/../../b\"}",
       "is outside of"},
      {"mission.json", "\"version\": 1", "\"version\": 1, \"version\": 1",
       "mission.json:3: key \"version\" is repeated"},
      {"mission.json", "\"version\": 1,", "\"version\": 1", "mission.json:4: "},
      {"mission.json", a0, std::to_string(make_key('a', 1)), "belongs to no robot"},
      {"mission.json", "", "", "mission.json:1: "},
      {"mission.json", "", "[]", "the file: must be an object"},
      {"graph.g2o", "", "", "graph.g2o: is empty, no VERTEX_SE3:QUAT or VERTEX_SE2 line"},
      {"stamps.csv", "", "key,stamp_ns\n", "stamps.csv: no stamp for node " + a0},
      {"stamps.csv", "", "key,stamp_ns\n" + a0 + ",1\n" + a0 + ",1\n",
       "stamps.csv:3: column \"key\": node a0 has two stamps"},
      {"stamps.csv", "", "key,stamp_ns\n" + a0 + ",1e9\n",
       "stamps.csv:2: column \"stamp_ns\": \"1e9\" is not a 64-bit whole number"},
      {"stamps.csv", "", "key,stamp_ns\n" + a0 + ",9223372036854775807\n", "stamp is out of range"},
      {"priors.csv", "", prior_header + c0 + ",0,0,0,0,0,0,1,1,1,1,1,1,1\n",
       "priors.csv:2: column \"key\": node " + c0},
      {"priors.csv", "", prior_header + a0 + ",0,0,0,0,0,0,0,1,1,1,1,1,1\n", "priors.csv:2: zero quaternion"},
      {"priors.csv", "", prior_header + a0 + ",0,nan,0,0,0,0,1,1,1,1,1,1,1\n",
       "column \"y\": \"nan\" is not finite"},
      {"priors.csv", "", prior_header + a0 + ",0,0,0,0,0,0,1,1,1,0,1,1,1\n",
       "column \"sz\": a sigma must be in"},
      {"radio.csv", "-55.5", "loud", "radio.csv:2: column \"receive_dbm\": \"loud\" is not a number"},
      {"beacons.csv", "spot", "x", "beacons.csv:2: column \"robot\": \"x\" is not a robot"},
      {"beacons.csv", std::to_string(make_key('b', 3)), c0, "beacons.csv:2: column \"drop_key\": node " + c0},
      {"ground_truth.g2o", "VERTEX_SE3:QUAT", "VERTEX_SE2", "ground_truth.g2o:1: VERTEX_SE2"},
  }));
  std::string text = read_file(path / bad.file);
  if (bad.find.empty()) {
    text = bad.replace;
  } else {
    REQUIRE(text.find(bad.find) != std::string::npos);
    text.replace(text.find(bad.find), bad.find.size(), bad.replace);
  }
  write_file(path / bad.file, text);
  CAPTURE(bad.file, bad.find, bad.replace);
  CHECK_THROWS_AS(read_mission(path), InputError);
  CHECK_THROWS_WITH(read_mission(path), Contains(bad.message));
}

TEST_CASE("mission: rows about unknown nodes are counted", "[io][mission]") {
  const TemporaryFolder folder;
  const fs::path path = write_complete(folder);
  const std::string c0 = std::to_string(make_key('c', 0));
  write_file(path / "stamps.csv", read_file(path / "stamps.csv") + c0 + ",5\n");
  write_file(path / "radio.csv", read_file(path / "radio.csv") + c0 + ",b,1,0,1\n");
  write_file(path / "ground_truth.g2o", "VERTEX_SE3:QUAT " + c0 + " 0 0 0 0 0 0 1\n");
  write_file(path / "reference.g2o", "VERTEX_SE3:QUAT " + c0 + " 0 0 0 0 0 0 1\n");
  const Mission mission = read_mission(path);
  CHECK(mission.problems.count("reference without node") == 1);
  CHECK(mission.reference.empty());
  CHECK(mission.problems.count("stamp without node") == 1);
  CHECK(mission.problems.count("radio reading without node") == 1);
  CHECK(mission.problems.count("ground truth without node") == 1);
  CHECK(mission.problems.count("node without ground truth") == 10);
  CHECK(mission.ground_truth.empty());
}

TEST_CASE("mission: the folder of a run is one, and reads with its closures", "[io][mission]") {
  const TemporaryFolder folder;
  const Mission mission = make_mission();
  write_g2o(folder / "graph.g2o", mission.graph);
  CHECK(mission_kind(folder.path()) == MissionKind::kG2oPcd);
  write_file(folder / "summary.json", "{}\n");
  write_file(folder / "closures.csv", "from,to\n");
  CHECK(mission_kind(folder.path()) == MissionKind::kRun);
  const Mission run = read_mission(folder.path());
  CHECK(run.kind == MissionKind::kRun);
  CHECK(enum_name(run.kind) == "run");
  CHECK(run.graph.edges().size() == mission.graph.edges().size());
  CHECK_THAT(run.provenance_json, Contains("run"));
}

TEST_CASE("mission: robots may be given from outside", "[io][mission]") {
  const TemporaryFolder folder;
  std::string text;
  for (int i = 0; i < 6; ++i) text += "VERTEX_SE3:QUAT " + std::to_string(i) + " 0 0 0 0 0 0 1\n";
  text += "EDGE_SE3:QUAT 2 3 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";
  testing::write_text(folder / "a.g2o", text);
  const Mission one = read_mission(folder / "a.g2o");
  CHECK(one.kind == MissionKind::kG2o);
  CHECK(one.name == "a");
  CHECK(one.robots.size() == 1);
  CHECK(one.graph.edges()[0].kind == EdgeKind::kOdometry);
  CHECK(one.scans->empty());
  CHECK(one.problems.count("no prior given") == 0);  // the frame of a robot that is alone is its own
  CHECK(one.problems.count("no stamps given") == 1);
  REQUIRE(one.graph.priors().size() == 1);
  CHECK(one.graph.priors()[0].key == 0);
  CHECK(one.graph.node(5).stamp_ns == 10'000'000'000);

  MissionOptions options;
  options.robots = "0-2,3-5";
  const Mission two = read_mission(folder / "a.g2o", options);
  CHECK(two.robots.size() == 2);
  CHECK(two.graph.edges()[0].kind == EdgeKind::kLoopClosure);
  CHECK(two.graph.node(5).stamp_ns == 4'000'000'000);
  CHECK(two.graph.priors().size() == 1);
  CHECK(two.problems.count("no prior given") == 1);

  options.robots = "0-2";
  CHECK_THROWS_WITH(read_mission(folder / "a.g2o", options), Contains("key 3"));
  options.robots = "x-y-z";
  CHECK_THROWS_AS(read_mission(folder / "a.g2o", options), OptionError);
  options.robots.clear();
  options.prior_sigmas = {1.0};
  CHECK_THROWS_WITH(read_mission(folder / "a.g2o", options),
                    Contains("prior_sigmas has 1 numbers, must have 6"));
}

TEST_CASE("session: poses give nodes, odometry and a reference, not the truth", "[io][session]") {
  const TemporaryFolder folder;
  write_session(folder / "s", 4);
  const Mission mission = read_mission((folder / "s").string() + "/");
  CHECK(mission.kind == MissionKind::kSession);
  CHECK(mission.name == "s");
  CHECK(mission.problems.count("odometry taken from the optimised poses") == 1);
  CHECK(mission.problems.all().size() == 1);
  REQUIRE(mission.graph.keys() == std::vector<Key>{0, 1, 2, 3});
  REQUIRE(mission.graph.edges().size() == 3);
  for (const Edge& edge : mission.graph.edges()) {
    CHECK(edge.kind == EdgeKind::kOdometry);
    CHECK(testing::difference(edge.T_from_to, Eigen::Isometry3d(Eigen::Translation3d(2, 0, 0))) < 1e-15);
    CHECK(edge.information(0, 0) == Approx(1.0 / (0.04 * 0.04)));  // 0.02 m/m over 2 m
    CHECK(edge.information(3, 3) == Approx(1.0 / (0.004 * 0.004)));
  }
  CHECK(mission.graph.node(3).stamp_ns == 100'300'000'000);
  CHECK(mission.start_ns == 100'000'000'000);
  CHECK(mission.reference.size() == 4);
  CHECK(mission.ground_truth.empty());
  CHECK(mission.scans->load(2)->size() == 7);
  CHECK(odometry_information(Eigen::Isometry3d::Identity())(0, 0) == Approx(1e4));
}

TEST_CASE("session: its own odometry is used, its closures are left out", "[io][session]") {
  const TemporaryFolder folder;
  write_session(folder / "s", 3);
  const std::string information = " 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 9 0 0 9 0 9\n";
  const std::string graph =
      "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 2 0 0 0 0 0 0 1\n"
      "EDGE_SE3:QUAT 0 1 2.5 0 0 0 0 0 1" +
      information + "EDGE_SE3:QUAT 2 0 -4 0 0 0 0 0 1" + information;
  testing::write_text(folder / "s" / "singlesession_posegraph.g2o", graph);
  SECTION("from its graph") {
    const Mission mission = read_mission(folder / "s");
    REQUIRE(mission.graph.edges().size() == 2);
    CHECK(mission.graph.edges()[0].information(0, 0) == 4.0);
    CHECK(mission.graph.node(1).pose.translation().x() == 2.5);
    CHECK(mission.graph.node(2).pose.translation().x() == 4.5);
    CHECK(mission.reference.at(2).translation().x() == 4.0);
    CHECK(mission.problems.count("closure of the session's own graph left out") == 1);
    CHECK(mission.problems.count("odometry missing in the session's graph") == 1);
  }
  SECTION("not from a graph of other keys") {
    testing::write_text(folder / "s" / "singlesession_posegraph.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");
    const Mission mission = read_mission(folder / "s");
    CHECK(mission.problems.count("session graph not used") == 1);
    CHECK(mission.graph.node(1).pose.translation().x() == 2.0);
  }
  SECTION("from odom_poses.txt, moved to the first optimised pose") {
    testing::write_text(folder / "s" / "odom_poses.txt",
                        "1 0 0 7 0 1 0 7 0 0 1 0\n1 0 0 10 0 1 0 7 0 0 1 0\n1 0 0 13 0 1 0 7 0 0 1 0\n");
    const Mission mission = read_mission(folder / "s");
    CHECK(mission.graph.node(2).pose.translation().isApprox(Eigen::Vector3d(6, 0, 0)));
    CHECK(mission.reference.at(2).translation().x() == 4.0);
    fs::remove(folder / "s" / "optimized_poses.txt");
    const Mission alone = read_mission(folder / "s");
    CHECK(alone.graph.node(2).pose.translation().isApprox(Eigen::Vector3d(13, 7, 0)));
    CHECK(alone.reference.empty());
  }
}

TEST_CASE("session: other names and forms of scans", "[io][session]") {
  const TemporaryFolder folder;
  write_session(folder / "s", 3);
  const fs::path scans = folder / "s" / "Scans";
  fs::remove(scans / "000000.pcd");
  fs::remove(scans / "000001.pcd");
  fs::remove(folder / "s" / "times.txt");
  write_ply(scans / "0.ply", random_cloud(11, false, false));
  write_pcd(scans / "0009.pcd", random_cloud(1, false, false));
  const Mission mission = read_mission(folder / "s");
  CHECK(mission.scans->load(0)->size() == 11);
  CHECK(mission.scans->load(1) == nullptr);
  CHECK(mission.problems.count("node without scan") == 1);
  CHECK(mission.problems.count("scan without node") == 1);
  CHECK(mission.problems.count("no stamps given") == 1);
  CHECK(mission.graph.node(2).stamp_ns == 4'000'000'000);
  fs::remove_all(scans);
  CHECK(read_mission(folder / "s").problems.count("node without scan") == 3);
}

TEST_CASE("session: bad files are refused with file and line", "[io][session][error]") {
  const TemporaryFolder folder;
  write_session(folder / "s", 3);
  struct Bad {
    std::string file;
    std::string text;
    std::string message;
  };
  const Bad bad = GENERATE(values<Bad>({
      {"optimized_poses.txt", "", "optimized_poses.txt: has no poses"},
      {"optimized_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 nan\n", "optimized_poses.txt:1: \"nan\" is not finite"},
      {"optimized_poses.txt", "1 0 0 0 0 1 0 0 0 0 1\n",
       "optimized_poses.txt:1: a KITTI pose needs 12 values, found 11"},
      {"odom_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "odom_poses.txt has 1 rows"},
      {"times.txt", "1\n", "times.txt has 1 rows"},
      {"times.txt", "1\n2\nx\n", "times.txt:3: \"x\" is not a stamp"},
      {"times.txt", "1\n2 5\n3\n", "times.txt:2: more than one value"},
      {"times.txt", "1\n2\n5e9\n", "times.txt:3: \"5e9\" is not a stamp"},
      {"singlesession_posegraph.g2o", "EDGE\n", "no VERTEX_SE3:QUAT or VERTEX_SE2 line"},
  }));
  write_file(folder / "s" / bad.file, bad.text);
  CAPTURE(bad.file, bad.text);
  CHECK_THROWS_AS(read_mission(folder / "s"), InputError);
  CHECK_THROWS_WITH(read_mission(folder / "s"), Contains(bad.message));
}

TEST_CASE("session: stamps that do not increase are counted", "[io][session]") {
  const TemporaryFolder folder;
  write_session(folder / "s", 3);
  write_file(folder / "s" / "times.txt", "5\n4\n4\n");
  const Mission mission = read_mission(folder / "s");
  CHECK(mission.problems.count("stamps not ascending") == 2);
  CHECK(mission.start_ns == 4'000'000'000);
}

TEST_CASE("session: the real one can be read", "[io][session][data]") {
  const auto folder = testing::test_data("kaist03");
  if (!folder) return;
  const Mission mission = read_mission(*folder);
  CHECK(mission.problems.count("node without scan") == 0);
  CHECK(mission.problems.count("stamps not ascending") == 0);
  CHECK(mission.graph.edges().size() + 1 == mission.graph.nodes().size());
  CHECK(mission.scans->size() == mission.graph.nodes().size());
  CHECK(mission.scans->load(mission.graph.nodes().back().key)->size() > 1000);
  CHECK(mission.ground_truth.empty());
  for (const auto& [key, pose] : mission.reference) {
    // Chained odometry against the file's rows of six digits: measured 2e-5 m over 24 m.
    CHECK(testing::difference(pose, mission.graph.node(key).pose) < 1e-3);
  }
}

}  // namespace
}  // namespace loopwise::mission_test
