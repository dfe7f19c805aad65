// SPDX-License-Identifier: BSD-3-Clause
// Bags of odometry and clouds, of ROS 1 and ROS 2, as missions.
#include <loopwise/core/error.hpp>

#include "lamp_testing.hpp"

namespace loopwise::key_frame_bag_test {
namespace {

namespace fs = std::filesystem;
using testing::expected_of;
using testing::rosbag2_data;
using testing::TemporaryFolder;

/// Every key frame stands where the odometry was at its stamp, and has the cloud of that stamp.
void check_key_frames(const Mission& mission, const Json& expected, double distance_m) {
  std::size_t nodes = 0;
  for (const Json& robot : expected["robots"]) {
    const auto& stamps = robot["stamps"];
    Eigen::Vector3d last = Eigen::Vector3d::Constant(1e9);
    for (std::size_t i = 0; i < stamps.size(); ++i) {
      const auto node =
          std::find_if(mission.graph.nodes().begin(), mission.graph.nodes().end(), [&](const Node& n) {
            return std::to_string(n.stamp_ns) == stamps[i].get_ref<const std::string&>();
          });
      const Eigen::Isometry3d pose = testing::pose_of(robot["poses"][i]);
      if (node == mission.graph.nodes().end()) continue;
      ++nodes;
      CAPTURE(key_name(node->key));
      // Measured: 2e-16 to 2e-13; clouds in the map's frame are moved back as float, 3e-6 m off.
      CHECK(testing::difference(node->pose, pose) < 1e-9);
      CHECK((pose.translation() - last).norm() >= distance_m - 1e-9);
      last = pose.translation();
      const auto cloud = mission.scans->load(node->key);
      REQUIRE(cloud);
      const Json& points = robot["clouds"][i];
      REQUIRE(cloud->size() == points.size());
      for (std::size_t p = 0; p < points.size(); ++p) {
        for (std::size_t k = 0; k < 3; ++k)
          CHECK(std::abs(static_cast<double>(cloud->points[p][static_cast<Eigen::Index>(k)]) -
                         points[p][k].get<double>()) < 2e-5);
      }
    }
  }
  CHECK(nodes == mission.graph.nodes().size());
  CHECK(nodes > 2 * expected["robots"].size());
  CHECK(mission.scans->problems().empty());
}

TEST_CASE("bags: odometry and clouds become key frames, in every storage", "[io][bag][key_frames]") {
  const TemporaryFolder folder;
  const std::string arguments =
      GENERATE("--storage mcap --pack zstd", "--storage db3", "--storage rosbag1",
               "--storage mcap --big-endian --definitions --metadata --split 30", "--storage db3 --poses");
  const std::string robots = GENERATE("c", "c,e");
  CAPTURE(arguments, robots);
  if (!rosbag2_data("stream", folder / "lio", arguments + " --nodes 4 --robots " + robots)) return;
  const Json expected = expected_of(folder / "lio");
  MissionOptions options;
  options.keyframe_distance_m = 0.7;
  const Mission mission = read_mission(folder / "lio", options);
  CHECK(mission.kind == MissionKind::kBags);
  CHECK(mission.name == "lio");
  CHECK(testing::names_of(mission.robots) ==
        (robots == "c"
             ? std::vector<std::string>{arguments.find("split") == std::string::npos ? "lio" : "run"}
             : std::vector<std::string>{"husky3", "spot1"}));
  check_key_frames(mission, expected, 0.7);
  CHECK(mission.graph.edges().size() == mission.graph.nodes().size() - expected["robots"].size());
  CHECK(mission.graph.edges()[0].kind == EdgeKind::kOdometry);
  const std::string odometry = arguments.find("--poses") == std::string::npos ? "lio/odometry" : "pose";
  const auto topic = std::find_if(mission.topics.begin(), mission.topics.end(), [&](const RecordedTopic& t) {
    return t.name == (robots == "c" ? "/" : "/husky3/") + odometry;
  });
  REQUIRE(topic != mission.topics.end());
  CHECK(topic->messages == 80);
  CHECK_THAT(topic->use, Contains("odometry of "));
  const auto note = std::find_if(mission.topics.begin(), mission.topics.end(),
                                 [](const RecordedTopic& t) { return t.name == "/note"; });
  REQUIRE(note != mission.topics.end());
  CHECK(note->use.empty());
}

TEST_CASE("bags: clouds in other frames than the robot's", "[io][bag][key_frames]") {
  const TemporaryFolder folder;
  const std::string frame = GENERATE("sensor", "world", "other");
  const std::string storage = GENERATE("mcap", "rosbag1");
  CAPTURE(frame, storage);
  if (!rosbag2_data("stream", folder / "lio",
                    "--nodes 3 --robots c --storage " + storage + " --frame " + frame))
    return;
  const Mission mission = read_mission(folder / "lio");
  check_key_frames(mission, expected_of(folder / "lio"), 1.0);
  CHECK(
      mission.problems.count("clouds in the frame of the odometry, transformed to the frame of the robot") ==
      (frame == "world" ? 1 : 0));
  CHECK(mission.problems.count("clouds assumed to be in the frame whose poses are recorded") ==
        (frame == "other" ? 1 : 0));
}

TEST_CASE("bags: the truth is a topic", "[io][bag][key_frames]") {
  const TemporaryFolder folder;
  const std::string topic = GENERATE("/ground_truth/pose", "/leica");
  CAPTURE(topic);
  if (!rosbag2_data("stream", folder / "lio", "--nodes 4 --robots c --truth-topic " + topic)) return;
  MissionOptions options;
  if (topic == "/leica") {
    options.odometry_topic = "lio/odometry";
    options.truth_topic = "leica";
  }
  const Mission mission = read_mission(folder / "lio", options);
  check_key_frames(mission, expected_of(folder / "lio"), 1.0);
  REQUIRE(mission.ground_truth.size() == mission.graph.nodes().size());
  // It is the odometry in another frame, and was aligned to it.
  CHECK(mission.truth_is_aligned);
  CHECK(mission.problems.count("truth in another frame") == 1);
  for (const Node& node : mission.graph.nodes())
    CHECK((mission.ground_truth.at(node.key).translation() - node.pose.translation()).norm() < 1e-6);
}

TEST_CASE("bags: topics that are guessed are counted, those that are missing listed",
          "[io][bag][key_frames][error]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("stream", folder / "lio", "--nodes 3 --robots c --truth-topic /other/odometry")) return;
  const Mission mission = read_mission(folder / "lio");
  CHECK(mission.problems.count("several topics of poses, one is used") == 1);
  MissionOptions options;
  options.odometry_topic = "/lio/odometry";
  CHECK(read_mission(folder / "lio", options).problems.count("several topics of poses, one is used") == 0);
  options.odometry_topic = "/nothing";
  CHECK_THROWS_WITH(
      read_mission(folder / "lio", options),
      Contains("odometry_topic = \"/nothing\"") && Contains("/points (sensor_msgs/PointCloud2, 60"));
  options = {};
  options.truth_topic = "/points";
  CHECK_THROWS_WITH(read_mission(folder / "lio", options), Contains("truth_topic"));
  if (!rosbag2_data("stream", folder / "json", "--nodes 1 --robots c --encoding json")) return;
  CHECK_THROWS_WITH(read_mission(folder / "json"), Contains("no mission in it") && Contains("/lio/odometry"));
}

}  // namespace
}  // namespace loopwise::key_frame_bag_test
