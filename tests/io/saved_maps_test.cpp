// SPDX-License-Identifier: BSD-3-Clause
// What other SLAM programs save, whole and with flaws.
#include <cstdlib>

#include <loopwise/core/error.hpp>
#include <loopwise/io/convert.hpp>
#include <loopwise/io/mission.hpp>

#include "saved_maps_data.hpp"

namespace loopwise::saved_maps_test {
namespace {

namespace fs = std::filesystem;
using testing::TemporaryFolder;

void replace_in(const fs::path& file, const std::string& what, const std::string& with) {
  std::string text = testing::read_text(file);
  const std::size_t at = text.find(what);
  REQUIRE(at != std::string::npos);
  testing::write_text(file, text.replace(at, what.size(), with));
}

std::size_t count_kind(const Mission& mission, EdgeKind kind) {
  std::size_t count = 0;
  for (const Edge& edge : mission.graph.edges()) count += edge.kind == kind ? 1 : 0;
  return count;
}

TEST_CASE("GLIM: submaps are nodes, odometry between them is the program's own", "[io][saved_map][glim]") {
  const TemporaryFolder folder;
  const testing::GlimDrive drive = testing::glim_drive(6);
  testing::write_glim(folder / "dump", drive);
  const Mission mission = read_mission(folder / "dump");
  CHECK(mission.kind == MissionKind::kGlim);
  REQUIRE(mission.graph.nodes().size() == 6);
  REQUIRE(mission.graph.edges().size() == 5);
  for (const Edge& edge : mission.graph.edges()) {
    CHECK(edge.kind == EdgeKind::kOdometry);
    const std::size_t last = (edge.from + 1) * drive.frames - 1;
    const Eigen::Isometry3d between = (drive.odom_lidar[last] * drive.T_lidar_imu).inverse() *
                                      drive.odom_lidar[last + 1] * drive.T_lidar_imu;
    const Eigen::Isometry3d expected = drive.origin(edge.from).inverse() * drive.world_imu(last) * between *
                                       drive.world_imu(last + 1).inverse() * drive.origin(edge.to);
    // Measured: 9e-5, of six digits; the optimised poses differ by 2e-3.
    CHECK(testing::difference(edge.T_from_to, expected) < 3e-4);
  }
  REQUIRE(mission.reference.size() == 6);
  CHECK(testing::difference(mission.reference.at(5), drive.origin(5)) < 1e-3);
  CHECK(mission.graph.node(1).stamp_ns == 1'567'410'202'250'000'000);  // its frame 10
  CHECK(mission.scans->load(3)->size() == 23);
  CHECK(mission.problems.count("factor of GLIM's own graph left out") == 2);
  CHECK(mission.problems.all().size() == 1);
}

TEST_CASE("GLIM: flaws of a dump", "[io][saved_map][glim][error]") {
  const TemporaryFolder folder;
  const fs::path dump = folder / "dump";
  testing::write_glim(dump, testing::glim_drive(4));
  SECTION("a submap is missing: odometry goes across") {
    fs::remove(dump / "000001" / "data.txt");
    const Mission mission = read_mission(dump);
    CHECK(mission.graph.nodes().size() == 3);
    CHECK(count_kind(mission, EdgeKind::kOdometry) == 2);
    CHECK(mission.problems.count("submap without data.txt left out") == 1);
    MissionOptions strict;
    strict.strict = true;
    CHECK_THROWS_WITH(read_mission(dump, strict), Contains("000001/data.txt"));
  }
  SECTION("the saver was stopped within a matrix") {
    std::string text = testing::read_text(dump / "000002" / "data.txt");
    text.resize(text.rfind("T_world_lidar"));
    text.resize(text.rfind("T_odom_lidar") + 20);
    testing::write_text(dump / "000002" / "data.txt", text);
    CHECK_THROWS_WITH(read_mission(dump), Contains("000002/data.txt:") && Contains("T_odom_lidar"));
  }
  SECTION("no pose, no submap, points that are cut") {
    replace_in(dump / "000000" / "data.txt", "T_world_origin", "T_world_centre");
    CHECK_THROWS_WITH(read_mission(dump), Contains("000000/data.txt") && Contains("T_world_origin"));
    testing::write_text(dump / "graph.txt", "num_submaps: -3\n");
    CHECK_THROWS_WITH(read_mission(dump), Contains("graph.txt:1"));
    testing::write_text(dump / "graph.txt", "num_submaps: 0\n");
    CHECK_THROWS_WITH(read_mission(dump), Contains("graph.txt: num_submaps is missing or 0"));
  }
  SECTION("points that are cut") {
    testing::write_text(dump / "000001" / "points_compact.bin", std::string(13, 'x'));
    const Mission mission = read_mission(dump);
    CHECK_THROWS_WITH(mission.scans->load(1), Contains("points_compact.bin"));
  }
  SECTION("frames without odometry") {
    std::string text = testing::read_text(dump / "000001" / "data.txt");
    text.resize(text.find("num_frames"));
    testing::write_text(dump / "000001" / "data.txt", text);
    const Mission mission = read_mission(dump);
    CHECK(mission.problems.count("odometry taken from the optimised poses") == 2);
    CHECK(mission.problems.count("no stamps given") == 1);
  }
}

TEST_CASE("FAST-LIO-SAM-QN: scans by row, stamps of the TUM file", "[io][saved_map][fast_lio_sam]") {
  const TemporaryFolder folder;
  const testing::Drive made = testing::drive(12);
  testing::write_fast_lio_sam_qn(folder / "seq", made);
  const Mission mission = read_mission(folder / "seq");
  CHECK(mission.kind == MissionKind::kFastLioSamQn);
  REQUIRE(mission.graph.nodes().size() == 12);
  CHECK(count_kind(mission, EdgeKind::kOdometry) == 11);
  CHECK(testing::difference(mission.graph.node(7).pose, made.truth[7]) < 1e-6);
  CHECK(std::abs(mission.graph.node(1).stamp_ns - 1'567'410'201'950'000'000) < 100);  // a double's digits
  CHECK(mission.scans->load(3)->size() == 23);
  CHECK(mission.problems.count("odometry taken from the optimised poses") == 11);
  CHECK(mission.problems.all().size() == 1);
  fs::remove(folder / "seq" / "poses_tum.txt");
  const Mission rows = read_mission(folder / "seq");
  CHECK(testing::difference(rows.graph.node(7).pose, made.truth[7]) < 1e-3);
  CHECK(rows.problems.count("no stamps given") == 1);
  fs::remove(folder / "seq" / "scans" / "000004.pcd");
  CHECK(read_mission(folder / "seq").problems.count("node without scan") == 1);
  testing::write_text(folder / "seq" / "poses_tum.txt", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n");
  CHECK_THROWS_WITH(read_mission(folder / "seq"), Contains("poses_tum.txt") && Contains("not ascending"));
}

TEST_CASE("HBA: seven numbers a line, the scalar first", "[io][saved_map][hba]") {
  const TemporaryFolder folder;
  const std::vector<Eigen::Isometry3d> poses = testing::drive(12).truth;
  testing::write_hba(folder / "h", poses);
  const Mission mission = read_mission(folder / "h");
  CHECK(mission.kind == MissionKind::kHba);
  REQUIRE(mission.graph.nodes().size() == 12);
  for (const Node& node : mission.graph.nodes())
    CHECK(testing::difference(node.pose, poses[node.key]) < 1e-3);
  CHECK(mission.scans->load(11)->size() == 31);
  testing::write_text(folder / "h" / "pose.json", "0 0 0 1 0 0 0\n0 0 0 1 0 0\n");
  CHECK_THROWS_WITH(read_mission(folder / "h"), Contains("pose.json:2") && Contains("7 values"));
}

TEST_CASE("Voxel-SLAM: sweeps of one session and of several", "[io][saved_map][voxel_slam]") {
  const TemporaryFolder folder;
  const std::vector<Eigen::Isometry3d> poses = testing::car_drive(30);
  testing::write_voxel_session(folder / "maps" / "first", poses);
  testing::write_voxel_session(folder / "maps" / "second", poses);
  const Mission one = read_mission(folder / "maps" / "first");
  CHECK(one.kind == MissionKind::kVoxelSlam);
  CHECK(one.graph.nodes().size() == 15);
  CHECK(one.scans->load(1)->size() == 22);
  testing::write_text(folder / "maps" / "edge.txt",
                      "first second 3 4 0 0 0 0 0 0 1\nfirst first 3 24 0 0 0 0 0 0 1\n");
  const Mission both = read_mission(folder / "maps");
  REQUIRE(both.robots.size() == 2);
  CHECK(both.robots[1].name == "second");
  CHECK(both.graph.nodes().size() == 30);
  CHECK(both.problems.count("closure of the session's own graph left out") == 2);
  CHECK(both.problems.count("joined without a frame") == 2);
  CHECK(both.problems.count("odometry taken from the optimised poses") == 2);
  fs::remove(folder / "maps" / "first" / "2.pcd");
  CHECK(read_mission(folder / "maps" / "first").graph.nodes().size() == 15);
  testing::write_text(folder / "maps" / "first" / "alidarState.txt", "1567410201.25 1 2 3\n");
  CHECK_THROWS_WITH(read_mission(folder / "maps"),
                    Contains("first/alidarState.txt:1") && Contains("8 values"));
}

TEST_CASE("KISS-SLAM: local maps go back to their nodes", "[io][saved_map][kiss_slam]") {
  const TemporaryFolder folder;
  std::vector<Eigen::Isometry3d> poses = testing::drive(12).truth;
  for (Eigen::Isometry3d& T : poses) T.translation().x() += 700.0;  // further than clouds of a sensor may lie
  testing::write_kiss_slam(folder / "results", poses);
  for (const fs::path& given : {folder / "results", folder / "results" / "local_maps"}) {
    const Mission mission = read_mission(given);
    CHECK(mission.kind == MissionKind::kKissSlam);
    CHECK(mission.graph.nodes().size() == 12);
    CHECK(count_kind(mission, EdgeKind::kOdometry) == 11);
    CHECK(count_kind(mission, EdgeKind::kLoopClosure) == 1);
    const PointCloud expected = testing::random_cloud(23, true, false, 3);
    const auto cloud = mission.scans->load(3);
    REQUIRE(cloud->size() == 23);
    for (std::size_t i = 0; i < cloud->size(); ++i)
      CHECK((cloud->points[i] - expected.points[i]).norm() < 0.01f);  // six digits of 700 m
    CHECK(mission.problems.count("edge with the identity as information, replaced by that of the options") ==
          12);
    for (const Edge& edge : mission.graph.edges()) CHECK(edge.information(0, 0) > 1.5);
  }
  write_ply(folder / "results" / "local_maps" / "plys" / "000003.ply",
            testing::random_cloud(23, true, false));
  CHECK_THROWS_WITH(read_mission(folder / "results").scans->load(3),
                    Contains("000003.ply") && Contains("from its node"));
}

TEST_CASE("Open3D: a pose graph, alone and with clouds", "[io][saved_map][open3d]") {
  const TemporaryFolder folder;
  const std::vector<Eigen::Isometry3d> poses = testing::drive(8).truth;
  Matrix6d rotation_first = Matrix6d::Zero();
  rotation_first.diagonal() << 100.0, 200.0, 300.0, 1.0, 2.0, 3.0;
  fs::create_directories(folder / "scene");
  const fs::path file = folder / "scene" / "global_registration.json";
  testing::write_text(file, testing::open3d_text(poses, rotation_first));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    write_ply(folder / "scene" / ("fragment_00" + std::to_string(i) + ".ply"),
              testing::random_cloud(20 + i, true, false, static_cast<unsigned>(i)));
  }
  const Mission alone = read_mission(file);
  CHECK(alone.kind == MissionKind::kOpen3d);
  CHECK(alone.graph.nodes().size() == 8);
  CHECK(count_kind(alone, EdgeKind::kOdometry) == 7);
  CHECK(count_kind(alone, EdgeKind::kLoopClosure) == 1);
  for (const Node& node : alone.graph.nodes()) CHECK(testing::difference(node.pose, poses[node.key]) < 1e-12);
  for (const Edge& edge : alone.graph.edges()) {
    CHECK(testing::difference(edge.T_from_to, poses[edge.from].inverse() * poses[edge.to]) < 1e-9);
    // A motion of the source in its own frame costs what the same motion costs where the target sees it.
    Vector6d xi;
    xi << 0.01, -0.02, 0.03, 0.002, 0.001, -0.003;
    const Vector6d seen = se3::log(edge.T_from_to * se3::exp(xi) * edge.T_from_to.inverse());
    Vector6d swapped;
    swapped << seen.tail<3>(), seen.head<3>();
    CHECK(xi.dot(edge.information * xi) == Approx(swapped.dot(rotation_first * swapped)).epsilon(1e-6));
  }
  const Mission whole = read_mission(folder / "scene");
  CHECK(whole.scans->size() == 8);
  CHECK(whole.scans->load(5)->size() == 25);

  SECTION("two graphs") {
    fs::copy_file(file, folder / "scene" / "optimised.json");
    CHECK_THROWS_WITH(read_mission(folder / "scene"),
                      Contains("optimised.json") && Contains("give one of the files"));
  }
  SECTION("an edge to nowhere, a matrix that is none") {
    replace_in(file, "\"source_node_id\": 0", "\"source_node_id\": 80");
    CHECK_THROWS_WITH(read_mission(file), Contains("edge 0") && Contains("source_node_id"));
    testing::write_text(file, testing::open3d_text(poses, rotation_first));
    replace_in(file, "\"pose\": [", "\"pose\": [7, ");
    CHECK_THROWS_WITH(read_mission(file), Contains("node 0") && Contains("16 numbers"));
  }
}

TEST_CASE("mrg_slam: robots by their names", "[io][saved_map][mrg_slam]") {
  const TemporaryFolder folder;
  const testing::Drive made = testing::drive(11);
  testing::write_mrg_slam(folder / "team", {"bestla", "atlas"}, made);
  const Mission mission = read_mission(folder / "team");
  CHECK(mission.kind == MissionKind::kG2oPcd);
  REQUIRE(mission.robots.size() == 2);
  CHECK(mission.robots[0].name == "atlas");
  CHECK(mission.robots[1].name == "bestla");
  CHECK(mission.graph.nodes().size() == 22);
  CHECK(count_kind(mission, EdgeKind::kOdometry) == 20);
  CHECK(count_kind(mission, EdgeKind::kLoopClosure) == 2);
  const Node& node = mission.graph.node(make_key('a', 4));
  CHECK(node.stamp_ns == 1'567'410'205'250'000'000);
  CHECK((node.pose.translation() - made.odometry[4].translation() - Eigen::Vector3d(0.0, 3.0, 0.0)).norm() <
        1e-3);
  CHECK(mission.scans->load(make_key('b', 7))->size() == 27);
  CHECK(mission.problems.count("edge to a fixed node without key frame, converted to a prior") == 1);
  CHECK(mission.problems.count("no prior given") == 1);  // of atlas
  CHECK(mission.problems.all().size() == 2);

  testing::write_mrg_slam(folder / "alone", {""}, made);
  CHECK(read_mission(folder / "alone").robots[0].name == "a");
  replace_in(folder / "team" / "keyframes" / "000003.txt", "g2o_id", "other");
  CHECK_THROWS_WITH(read_mission(folder / "team"), Contains("node 4 has no key frame"));
  testing::write_mrg_slam(folder / "team", {"bestla", "atlas"}, made);
  replace_in(folder / "team" / "keyframes" / "000003.txt", "g2o_id 4", "g2o_id 3");
  CHECK_THROWS_WITH(read_mission(folder / "team"), Contains("g2o_id 3"));
}

TEST_CASE("convert: dumps of hdl_graph_slam read back", "[io][saved_map][convert]") {
  const TemporaryFolder folder;
  testing::write_glim(folder / "glim", testing::glim_drive(6));
  const Mission mission = read_mission(folder / "glim");
  const ConvertResult result = convert_mission(mission, folder / "dump", MissionFormat::kHdlGraphSlam);
  CHECK(result.scans == 6);
  CHECK(result.left_out.count("reference pose left out") == 6);
  const Mission back = read_mission(folder / "dump");
  CHECK(back.kind == MissionKind::kG2oPcd);
  REQUIRE(back.graph.nodes().size() == 6);
  REQUIRE(back.graph.edges().size() == 5);
  for (const Node& node : back.graph.nodes()) {
    CHECK(testing::difference(node.pose, mission.graph.node(node.key).pose) < 1e-12);
    CHECK(node.stamp_ns == mission.graph.node(node.key).stamp_ns);
    CHECK(back.scans->load(node.key)->points == mission.scans->load(node.key)->points);
  }
  for (std::size_t e = 0; e < 5; ++e) {
    CHECK(testing::difference(back.graph.edges()[e].T_from_to, mission.graph.edges()[e].T_from_to) < 1e-12);
    CHECK(back.graph.edges()[e].information.isApprox(mission.graph.edges()[e].information, 1e-9));
  }
  REQUIRE(back.graph.priors().size() == 1);
  CHECK(testing::difference(back.graph.priors()[0].pose, mission.graph.priors()[0].pose) < 1e-12);
  CHECK(back.graph.priors()[0].information.isApprox(mission.graph.priors()[0].information, 1e-9));
}

TEST_CASE("convert: HBA's folder read back, and what both programs cannot hold", "[io][saved_map][convert]") {
  const TemporaryFolder folder;
  testing::write_glim(folder / "glim", testing::glim_drive(6));
  fs::remove(folder / "glim" / "000003" / "points_compact.bin");
  const Mission mission = read_mission(folder / "glim");
  const ConvertResult result = convert_mission(mission, folder / "hba", MissionFormat::kHba);
  CHECK(result.left_out.count("node without scan left out") == 1);
  const Mission back = read_mission(folder / "hba");
  CHECK(back.kind == MissionKind::kHba);
  REQUIRE(back.graph.nodes().size() == 5);
  CHECK(testing::difference(back.graph.node(4).pose, mission.graph.node(5).pose) < 1e-12);
  CHECK(back.scans->load(4)->size() == 25);

  Mission bare = read_mission(folder / "glim");
  bare.scans = std::make_shared<ScanStore>();
  static_cast<void>(convert_mission(bare, folder / "poses", MissionFormat::kHba));
  CHECK(testing::read_text(folder / "poses" / "pose.json").find('\n') != std::string::npos);
  CHECK_FALSE(fs::exists(folder / "poses" / "pcd"));

  testing::write_mrg_slam(folder / "team", {"bestla", "atlas"}, testing::drive(5));
  const Mission team = read_mission(folder / "team");
  for (const MissionFormat format : {MissionFormat::kHba, MissionFormat::kHdlGraphSlam}) {
    CHECK_THROWS_WITH(convert_mission(team, folder / "out", format),
                      Contains("2 robots") && Contains("g2o_pcd"));
    CHECK_FALSE(fs::exists(folder / "out"));
  }
}

}  // namespace
}  // namespace loopwise::saved_maps_test
