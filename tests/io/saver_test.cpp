// SPDX-License-Identifier: BSD-3-Clause
// Output of programs that the documentation names, complete and interrupted.
#include <cmath>
#include <sstream>

#include <loopwise/core/error.hpp>
#include <loopwise/io/mission.hpp>

#include "saver_data.hpp"

namespace loopwise::saver_test {
namespace {

namespace fs = std::filesystem;
using testing::drive;
using testing::Drive;
using testing::TemporaryFolder;

std::size_t odometry_edges(const Mission& mission) {
  std::size_t count = 0;
  for (const Edge& edge : mission.graph.edges()) count += edge.kind == EdgeKind::kOdometry ? 1 : 0;
  return count;
}

void append_text(const fs::path& file, const std::string& text) {
  testing::write_text(file, testing::read_text(file) + text);
}

void drop_last_line(const fs::path& file) {
  std::string text = testing::read_text(file);
  text.resize(text.rfind('\n', text.size() - 2) + 1);
  testing::write_text(file, text);
}

/// Every step is that of the odometry, to six decimals, with the sigmas of sessions.
void check_steps(const Mission& mission, const Drive& drive, const MissionOptions& options = {}) {
  for (const Edge& edge : mission.graph.edges()) {
    const Eigen::Isometry3d expected = drive.odometry[edge.from].inverse() * drive.odometry[edge.to];
    CHECK(edge.to == edge.from + 1);
    CHECK(edge.kind == EdgeKind::kOdometry);
    // Measured: 6e-5, of rows of six digits up to 10 m.
    CHECK(testing::difference(edge.T_from_to, expected) < 3e-4);
    CHECK(edge.information.isApprox(odometry_information(edge.T_from_to, options), 1e-12));
  }
}

TEST_CASE("savers: SC-LIO-SAM, whose edges have no information", "[io][session][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  testing::write_sc_lio_sam(folder / "s", made);
  MissionOptions options;
  options.odometry_sigma_m_per_m = 0.05;
  for (const MissionOptions& given : {MissionOptions(), options}) {
    const Mission mission = read_mission(folder / "s", given);
    CHECK(mission.kind == MissionKind::kSession);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.graph.edges().size() == 11);
    check_steps(mission, made, given);
    CHECK(mission.reference.size() == 12);
    CHECK(mission.scans->size() == 12);
    CHECK(mission.scans->load(3)->size() == 23);
    CHECK(mission.graph.node(1).stamp_ns == 1567410201950000000);
    CHECK(mission.problems.count("edge without information") == 12);
    CHECK(mission.problems.count("closure of the session's own graph left out") == 1);
    CHECK(mission.problems.all().size() == 2);
  }
  options.strict = true;
  CHECK_THROWS_WITH(read_mission(folder / "s", options), Contains("edge without information (12 times") &&
                                                             Contains("singlesession_posegraph.g2o:13") &&
                                                             Contains("strict"));
}

TEST_CASE("savers: a graph without information is read alone", "[io][g2o][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  testing::write_sc_lio_sam(folder / "s", made);
  MissionOptions options;
  options.odometry_min_sigma_rad = 0.5;
  const Mission mission = read_mission(folder / "s" / "singlesession_posegraph.g2o", options);
  CHECK(mission.kind == MissionKind::kG2o);
  REQUIRE(mission.graph.edges().size() == 12);
  CHECK(odometry_edges(mission) == 11);
  CHECK(mission.graph.edges()[0].information(5, 5) == Approx(4.0));
  CHECK(mission.graph.edges()[11].information(0, 0) == Approx(100.0));
  CHECK(mission.graph.edges()[11].information(5, 5) == Approx(2500.0));
  CHECK(mission.problems.count("edge without information") == 12);
}

TEST_CASE("savers: SC-A-LOAM and FAST_LIO_SLAM", "[io][session][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  testing::write_sc_a_loam(folder / "a", made);
  testing::write_fast_lio_slam(folder / "f", made);
  for (const char* name : {"a", "f"}) {
    CAPTURE(name);
    MissionOptions options;
    options.strict = true;
    const Mission mission = read_mission(folder / name, options);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.graph.edges().size() == 11);
    check_steps(mission, made);
    CHECK(mission.reference.size() == 12);
    CHECK(mission.scans->size() == 12);
    CHECK(mission.problems.empty());
  }
}

TEST_CASE("savers: of a session that was stopped, the rows that all files have are read",
          "[io][session][saver]") {
  const TemporaryFolder folder;
  const std::string form = GENERATE("a", "f", "l");
  const std::string file = GENERATE("times.txt", "odom_poses.txt", "optimized_poses.txt");
  const bool more = GENERATE(false, true);
  CAPTURE(form, file, more);
  const Drive made = drive(12);
  const fs::path session = folder / "s";
  if (form == "a") testing::write_sc_a_loam(session, made);
  if (form == "f") testing::write_fast_lio_slam(session, made);
  if (form == "l") testing::write_sc_lio_sam(session, made);
  const bool is_written = form != "l" || file != "odom_poses.txt";
  REQUIRE(fs::exists(session / file) == is_written);
  if (!is_written) return;
  if (more) {
    append_text(session / file, file == "times.txt" ? "1567410300.5\n" : "1 0 0 0 0 1 0 0 0 0 1 0\n");
  } else {
    drop_last_line(session / file);
  }
  const Mission mission = read_mission(session);
  const std::size_t rows = more ? 12 : 11;
  CHECK(mission.graph.nodes().size() == rows);
  CHECK(mission.graph.edges().size() == rows - 1);
  check_steps(mission, made);
  CHECK(mission.reference.size() == rows);
  CHECK(mission.problems.count("scan without node") == 12 - rows);
  CHECK(mission.problems.count("node without scan") == 0);
  // Where one file is short, all others have a row too many.
  CHECK(mission.problems.count("row beyond the common part left out") == (more ? 1 : 2));
  MissionOptions strict;
  strict.strict = true;
  if (form == "l") return;  // refused for its edges already
  CHECK_THROWS_WITH(read_mission(session, strict), Contains("row beyond the common part"));
}

TEST_CASE("savers: incomplete last lines", "[io][session][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  const fs::path session = folder / "s";
  testing::write_sc_lio_sam(session, made);
  SECTION("a pose") {
    append_text(session / "optimized_poses.txt", "0.7 0.7 0 1");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
  }
  SECTION("a stamp") {
    append_text(session / "times.txt", "15674");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
    CHECK(mission.problems.count("stamps not ascending") == 0);
  }
  SECTION("a pose, within its last number") {
    append_text(session / "optimized_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 -1.");
    const Mission mission = read_mission(session);
    CHECK(mission.reference.size() == 12);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
    CHECK(mission.problems.count("row beyond the common part left out") == 0);
  }
  SECTION("a pose and a stamp, behind the exponent's sign") {
    append_text(session / "optimized_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 -1.2e-");
    append_text(session / "times.txt", "1.5674e+");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.problems.count("unfinished last line left out") == 2);
  }
  SECTION("a step of the graph, within its last number") {
    std::string text = testing::read_text(session / "singlesession_posegraph.g2o");
    text.resize(text.find("EDGE_SE3:QUAT 11 0"));
    text.resize(text.size() - 6);  // 0.99…
    testing::write_text(session / "singlesession_posegraph.g2o", text);
    const Mission mission = read_mission(session);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
    CHECK(mission.problems.count("odometry missing in the session's graph") == 1);
  }
  SECTION("the graph within its first vertex") {
    testing::write_text(session / "singlesession_posegraph.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
    CHECK(mission.problems.count("session graph not used") == 1);
    CHECK(mission.problems.count("odometry taken from the optimised poses") == 1);
  }
  SECTION("an edge, before the vertex that it leads to") {
    append_text(session / "singlesession_posegraph.g2o",
                "EDGE_SE3:QUAT 11 12 1 0 0 0 0 0 1\nEDGE_SE3:QUAT 10 1");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.edges().size() == 11);
    CHECK(mission.problems.count("unfinished last line left out") == 1);
    CHECK(mission.problems.count("edge to a missing vertex left out") == 1);
  }
  SECTION("odometry that was to be replaced") {
    testing::write_text(session / "odom_poses.txt", "");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.edges().size() == 11);
    CHECK(mission.problems.count("empty file not used") == 1);
  }
  SECTION("a graph that was to be saved at the end") {
    testing::write_text(session / "singlesession_posegraph.g2o", "");
    const Mission mission = read_mission(session);
    CHECK(mission.graph.edges().size() == 11);
    CHECK(mission.problems.count("empty file not used") == 1);
    CHECK(mission.problems.count("odometry taken from the optimised poses") == 1);
  }
  SECTION("no poses at all") {
    testing::write_text(session / "singlesession_posegraph.g2o", "");
    fs::remove(session / "optimized_poses.txt");
    CHECK_THROWS_WITH(read_mission(session),
                      Contains("session without poses") && Contains("optimized_poses.txt"));
  }
}

TEST_CASE("savers: scans that are counted from 1", "[io][session][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  testing::write_fast_lio_slam(folder / "s", made);
  fs::remove_all(folder / "s" / "Scans");
  testing::write_scans(folder / "s" / "Scans", 12, 1);
  const Mission mission = read_mission(folder / "s");
  CHECK(mission.problems.count("scans are counted from 1") == 1);
  CHECK(mission.problems.count("node without scan") == 0);
  CHECK(mission.scans->load(0)->size() == 20);
  CHECK(mission.scans->load(11)->size() == 31);
  fs::remove(folder / "s" / "Scans" / "000012.pcd");  // or is it the scan of row 0 that is missing?
  const Mission unclear = read_mission(folder / "s");
  CHECK(unclear.problems.count("scans may be counted from 1") == 1);
  CHECK(unclear.problems.count("node without scan") == 1);
  CHECK(unclear.scans->load(1)->size() == 20);
}

TEST_CASE("savers: a missing first scan does not mean a count from 1", "[io][session][saver]") {
  const TemporaryFolder folder;
  testing::write_fast_lio_slam(folder / "s", drive(12));
  fs::remove_all(folder / "s" / "Scans");
  // Its stamps are a row short, with scans 1 to 11 row by row; or there are scans beyond its rows.
  const bool short_stamps = GENERATE(true, false);
  CAPTURE(short_stamps);
  testing::write_scans(folder / "s" / "Scans", short_stamps ? 11 : 15, 1);
  if (short_stamps) drop_last_line(folder / "s" / "times.txt");
  const Mission mission = read_mission(folder / "s");
  CHECK(mission.problems.count("scans are counted from 1") == 0);
  CHECK(mission.problems.count("scans may be counted from 1") == 1);
  CHECK(mission.scans->load(1)->size() == 20);
  CHECK(mission.scans->load(10)->size() == 29);
}

TEST_CASE("savers: scans with two extensions", "[io][session][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  testing::write_fast_lio_slam(folder / "s", drive(3));
  fs::remove_all(folder / "s" / "Scans");
  fs::create_directories(folder / "s" / "Scans");
  fs::create_directories(folder / "g" / "pcd");
  testing::write_text(folder / "g" / "a.g2o", testing::posegraph_text(drive(3).odometry, drive(3).odometry));
  for (const char* name : {"000000.pcd.bin", "000001.pcd.bin", "000002.pcd.bin"}) {
    testing::write_text(folder / "s" / "Scans" / name, std::string(16 * 30, '\0'));
    testing::write_text(folder / "g" / "pcd" / name, std::string(16 * 30, '\0'));
  }
  for (const char* name : {"s", "g"}) {
    const Mission mission = read_mission(folder / name);
    CHECK(mission.problems.count("foreign file in scans") == 0);
    CHECK(mission.problems.count("node without scan") == 0);
    CHECK(mission.scans->load(2)->size() == 30);
  }
}

TEST_CASE("savers: information of low rank stays usable from the other end", "[io][session][saver]") {
  const TemporaryFolder folder;
  const fs::path session = folder / "s";
  fs::create_directories(session);
  testing::write_text(session / "optimized_poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
  const double angle = (0.3 + 0.2 * GENERATE(range(0, 12))) * GENERATE(1.0, -1.0);
  CAPTURE(angle);
  // Known across a corridor alone, which the other node sees along an axis.
  const double c = std::cos(angle), s = std::sin(angle);
  std::ostringstream edge;
  edge.precision(17);
  edge << "EDGE_SE3:QUAT 1 0 0 0 0 0 0 " << -std::sin(0.5 * angle) << " " << std::cos(0.5 * angle) << " "
       << 100 * c * c << " " << 100 * c * s << " 0 0 0 0 " << 100 * s * s;
  for (int i = 0; i < 14; ++i) edge << " 0";
  edge << "\n";
  testing::write_text(session / "singlesession_posegraph.g2o",
                      "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n" + edge.str());
  const Mission mission = read_mission(session);
  REQUIRE(mission.graph.edges().size() == 1);
  CHECK(mission.graph.edges()[0].information.trace() == Approx(100.0));
}

TEST_CASE("savers: files of different sessions", "[io][session][saver][error]") {
  const TemporaryFolder folder;
  testing::write_fast_lio_slam(folder / "s", drive(12));
  testing::write_text(folder / "s" / "times.txt", "1\n2\n3\n");
  CHECK_THROWS_AS(read_mission(folder / "s"), InputError);
  CHECK_THROWS_WITH(read_mission(folder / "s"),
                    Contains("times.txt has 3 rows") && Contains("poses.txt has 12"));
}

TEST_CASE("savers: hdl_graph_slam's dump", "[io][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  const Drive made = drive(12);
  const std::vector<std::size_t> ids = testing::write_hdl_dump(folder / "dump", made, {true, true, true});
  const Mission mission = read_mission(folder / "dump");
  CHECK(mission.kind == MissionKind::kG2oPcd);
  REQUIRE(mission.graph.keys() == std::vector<Key>(ids.begin(), ids.end()));
  CHECK(mission.graph.edges().size() == 12);  // the steps and a closure
  CHECK(mission.scans->size() == 12);
  for (std::size_t i = 0; i < ids.size(); ++i) {
    CHECK(mission.scans->load(ids[i])->size() == 20 + i);
    CHECK(mission.graph.node(ids[i]).stamp_ns ==
          static_cast<std::int64_t>(1567410201 + i) * 1'000'000'000 + 250'000'000);
    CHECK(testing::difference(mission.graph.node(ids[i]).pose, made.odometry[i]) < 3e-4);
  }
  // The anchor at the origin holds the first node by the edge between them.
  REQUIRE(mission.graph.priors().size() == 1);
  CHECK(mission.graph.priors()[0].key == 0);
  CHECK(testing::difference(mission.graph.priors()[0].pose, made.odometry[0]) < 3e-4);
  CHECK(mission.graph.priors()[0].information(0, 0) == Approx(25.0));
  CHECK(mission.problems.count("unknown tag VERTEX_PLANE") == 1);
  CHECK(mission.problems.count("FIX of VERTEX_PLANE left out") == 1);
  CHECK(mission.problems.count("unknown tag EDGE_SE3_PLANE") == 11);
  CHECK(mission.problems.count("unknown tag EDGE_SE3_PRIORXYZ") == 11);
  CHECK(mission.problems.count("key frame's floor_coeffs not used") == 12);
  CHECK(mission.problems.count("key frame's utm_coord not used") == 12);
  CHECK(mission.problems.count("edge to a fixed node without key frame, converted to a prior") == 1);
  CHECK(mission.problems.count("node without scan") == 0);
  CHECK(mission.problems.count("foreign file in scans") == 0);
  CHECK(mission.problems.all().size() == 7);
}

TEST_CASE("savers: hdl_graph_slam's dump without anchor and floor, and broken ones", "[io][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  const fs::path dump = folder / "dump";
  testing::write_hdl_dump(dump, drive(12), {false, false, false});
  CHECK(read_mission(dump).problems.empty());
  fs::remove(dump / "000004" / "cloud.pcd");
  CHECK(read_mission(dump).problems.count("node without scan") == 1);
  const std::string data = testing::read_text(dump / "000003" / "data");
  testing::write_text(dump / "000003" / "data", data.substr(0, data.find("id ")));
  const Mission mission = read_mission(dump);
  CHECK(mission.problems.count("key frame without node left out") == 1);
  CHECK(mission.problems.count("node without stamp") == 1);
  CHECK(mission.graph.nodes().size() == 12);
  testing::write_text(dump / "000003" / "data", data.substr(0, data.find("id ")) + "id 5\n");
  CHECK_THROWS_WITH(read_mission(dump), Contains("id 5 is also the id of 000003"));
  testing::write_text(dump / "000003" / "data", "stamp 12 1e9\n");
  CHECK_THROWS_WITH(read_mission(dump), Contains("data:1: stamp needs seconds and nanoseconds"));
}

TEST_CASE("savers: the stamps of hdl_graph_slam's dump get the robot's character too",
          "[io][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  const std::vector<std::size_t> ids =
      testing::write_hdl_dump(folder / "dump", drive(5), {true, false, false});
  MissionOptions options;
  options.robot_character = "c";
  const Mission mission = read_mission(folder / "dump", options);
  CHECK(mission.problems.count("stamp without node") == 0);
  CHECK(mission.problems.count("no stamps given") == 0);
  for (std::size_t i = 0; i < ids.size(); ++i) {
    CHECK(mission.graph.node(make_key('c', ids[i])).stamp_ns ==
          static_cast<std::int64_t>(1567410201 + i) * 1'000'000'000 + 250'000'000);
    CHECK(mission.scans->load(make_key('c', ids[i]))->size() == 20 + i);
  }
}

TEST_CASE("savers: of hdl_graph_slam's fixed nodes only the anchor is left out", "[io][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  const fs::path dump = folder / "dump";
  testing::write_hdl_dump(dump, drive(12), {true, false, false});
  // A key frame that lost its folder, fixed or with a prior, stays.
  const std::string graph = testing::read_text(dump / "graph.g2o");
  const std::string pins = "FIX 0\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nEDGE_SE3_PRIOR 5 0 1 2 3 0 0 0 1" +
                           std::string(" 4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 9 0 0 9 0 9\n");
  testing::write_text(dump / "graph.g2o", graph + pins);
  fs::remove_all(dump / "000000");
  fs::remove_all(dump / "000004");
  const Mission mission = read_mission(dump);
  CHECK(mission.graph.nodes().size() == 12);
  CHECK(mission.graph.contains(0));
  CHECK(mission.graph.contains(5));
  CHECK(mission.graph.priors().size() == 3);
  CHECK(mission.problems.count("node without scan") == 2);
  CHECK(mission.problems.count("odometry chain broken") == 0);
  CHECK(mission.problems.count("fixed node without key frame, treated as an anchor") == 0);

  // Without the file that names it, the fixed ones are used, which is reported.
  fs::remove(dump / "special_nodes.csv");
  const Mission guessed = read_mission(dump);
  CHECK(guessed.graph.nodes().size() == 11);
  CHECK(guessed.graph.contains(5));
  CHECK(guessed.problems.count("fixed node without key frame, treated as an anchor") == 2);
  CHECK(guessed.problems.count("edge between fixed nodes left out") == 1);
  MissionOptions strict;
  strict.strict = true;
  CHECK_THROWS_WITH(read_mission(dump, strict), Contains("treated as an anchor"));
  testing::write_text(dump / "special_nodes.csv", "anchor_node x\n");
  CHECK_THROWS_WITH(read_mission(dump), Contains("special_nodes.csv:1: anchor_node needs the id"));
}

TEST_CASE("savers: an edge to a fixed node costs the same as the prior that it becomes",
          "[io][g2o_pcd][saver]") {
  const TemporaryFolder folder;
  const bool from_anchor = GENERATE(true, false);
  const unsigned seed = GENERATE(range(1u, 6u));
  CAPTURE(from_anchor, seed);
  Rng rng(seed);
  const Eigen::Isometry3d anchor = testing::random_pose(rng), measured = testing::random_pose(rng),
                          node = testing::random_pose(rng);
  const fs::path dump = folder / "dump";
  testing::write_hdl_dump(dump, drive(2), {false, false, false});
  const std::string pose = testing::streamed(anchor), own = testing::streamed(node);
  testing::write_text(dump / "special_nodes.csv", "anchor_node 7\nanchor_edge 0\nfloor_node -1\n");
  testing::write_text(dump / "graph.g2o",
                      "VERTEX_SE3:QUAT 0 " + own + "\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nVERTEX_SE3:QUAT 7 " +
                          pose + "\nFIX 7\nEDGE_SE3:QUAT " + (from_anchor ? "7 0 " : "0 7 ") +
                          testing::streamed(measured) + " 9 1 0 0 0 1 7 0 2 0 0 5 0 0 0 30 4 0 20 0 10\n");
  const Mission mission = read_mission(dump);
  REQUIRE(mission.graph.priors().size() == 1);
  Matrix6d information = Matrix6d::Zero();
  information.diagonal() << 9, 7, 5, 30, 20, 10;
  information(0, 1) = information(1, 0) = 1;
  information(0, 5) = information(5, 0) = 1;
  information(1, 3) = information(3, 1) = 2;
  information(3, 4) = information(4, 3) = 4;
  const PriorFactor& prior = mission.graph.priors()[0];
  const Vector6d r = from_anchor ? se3::log(measured.inverse() * anchor.inverse() * node)
                                 : se3::log(measured.inverse() * node.inverse() * anchor);
  const Vector6d made = se3::log(prior.pose.inverse() * node);
  // Measured: relative difference up to 1e-5, of six digits; without the adjoint it is of order 1.
  CHECK(made.dot(prior.information * made) == Approx(r.dot(information * r)).epsilon(1e-3));
}

TEST_CASE("savers: the recorded examples", "[io][saver][data]") {
  if (const auto folder = testing::test_data("../cases/sc_lio_sam_session")) {
    const Mission mission = read_mission(*folder);
    CHECK(mission.kind == MissionKind::kSession);
    CHECK(mission.graph.nodes().size() == 24);
    CHECK(mission.graph.edges().size() == 23);
    CHECK(odometry_edges(mission) == 23);
    CHECK(mission.scans->size() == 24);
    for (const Edge& edge : mission.graph.edges())
      CHECK(edge.information.isApprox(odometry_information(edge.T_from_to), 1e-12));
    CHECK(mission.problems.count("odometry missing in the session's graph") == 0);
  }
  if (const auto folder = testing::test_data("../cases/hdl_graph_slam_dump")) {
    const Mission mission = read_mission(*folder);
    CHECK(mission.graph.nodes().size() == 24);
    CHECK(mission.scans->size() == 24);
    CHECK(mission.problems.count("node without scan") == 0);
    CHECK(mission.problems.count("FIX of VERTEX_PLANE left out") == 1);
    CHECK(mission.graph.edges().size() == 24);  // 23 steps and a closure
  }
}

}  // namespace
}  // namespace loopwise::saver_test
