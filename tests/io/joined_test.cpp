// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Several sources as one mission: their robots, frames with sigmas, and parts whose frames come later.
#include <string>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/place_parts.hpp>

#include "testing.hpp"

namespace loopwise::joined_test {
namespace {

using testing::TemporaryFolder;
using testing::fs::path;

/// A mission whose robots drive 2 m a node along x, each from its own y; `landmark` gives the first one to
/// see.
Mission small_mission(const std::string& name, const std::string& letters, bool landmark = false) {
  Mission mission;
  mission.name = name;
  std::vector<Robot> robots;
  for (std::size_t r = 0; r < letters.size(); ++r) {
    robots.push_back(robot_of_character(letters[r], std::string("husky") + letters[r]));
    for (std::uint64_t i = 0; i < 4; ++i) {
      Node node;
      node.key = make_key(letters[r], i + 7);
      node.pose.translation() =
          Eigen::Vector3d(2.0 * static_cast<double>(i), 3.0 * static_cast<double>(r), 0.0);
      node.stamp_ns = static_cast<std::int64_t>(i) * 1'000'000'000;
      mission.graph.add_node(node);
      mission.ground_truth[node.key] = node.pose;
      mission.radio.push_back({node.key, "beacon", 20.0, "r", -50.0});
      if (i == 0) continue;
      Edge edge;
      edge.from = make_key(letters[r], i + 6);
      edge.to = node.key;
      edge.T_from_to.translation().x() = 2.0;
      edge.kind = EdgeKind::kOdometry;
      mission.graph.add_edge(edge);
    }
    mission.graph.add_prior({make_key(letters[r], 7), mission.graph.node(make_key(letters[r], 7)).pose,
                             1e4 * Matrix6d::Identity()});
    mission.gaps.push_back({r, 1.0, 2.0});
  }
  if (landmark) {
    robots.push_back(robot_of_character('L', "things"));
    robots.back().landmarks = true;
    Node node;
    node.key = make_key('L', 0);
    node.pose.translation().y() = 9.0;
    mission.graph.add_node(node);
    mission.graph.add_edge({make_key(letters[0], 8), node.key, node.pose});
  }
  mission.robots = Robots(robots);
  for (CommunicationGap& gap : mission.gaps) gap.robot = mission.robots.of(make_key(letters[gap.robot], 7));
  return mission;
}

path written(const TemporaryFolder& folder, const Mission& mission) {
  MissionWriter(folder / mission.name).finish(mission);
  return folder / mission.name;
}

Vector6d sigmas_of(const PriorFactor& prior) {
  return prior.information.diagonal().cwiseSqrt().cwiseInverse();
}

}  // namespace

TEST_CASE("joined: sources of several robots", "[io][joined]") {
  const TemporaryFolder folder;
  const path map = written(folder, small_mission("map", "kq", /*landmark=*/true)),
             session = written(folder, small_mission("session", "a"));
  const Mission mission = read_missions({map, session});
  REQUIRE(mission.robots.size() == 4);
  CHECK(mission.robots[mission.robots.of(make_key('a', 0))].name == "map_huskyk");
  CHECK(mission.robots[mission.robots.of(make_key('b', 0))].name == "map_huskyq");
  CHECK(mission.robots[mission.robots.of(make_key('c', 0))].name == "session");
  CHECK(mission.robots.is_landmark(make_key('A', 0)));
  CHECK(mission.graph.node(make_key('b', 10)).pose.translation() == Eigen::Vector3d(6.0, 3.0, 0.0));
  REQUIRE(mission.robot_sources.size() == 4);
  for (const auto& [letter, source] :
       {std::pair('A', 0U), std::pair('a', 0U), std::pair('b', 0U), std::pair('c', 1U)})
    CHECK(mission.robot_sources[mission.robots.of(make_key(letter, 0))] == source);
  REQUIRE(mission.gaps.size() == 3);
  for (const CommunicationGap& gap : mission.gaps) CHECK_FALSE(mission.robots[gap.robot].landmarks);
  CHECK(mission.problems.count("joined without a frame") == 2);
  REQUIRE_THAT(to_string(mission.problems.all().front()), Contains("--frames auto"));
}

TEST_CASE("joined: frames with sigmas", "[io][joined]") {
  const TemporaryFolder folder;
  const std::vector<path> paths = {written(folder, small_mission("one", "a")),
                                   written(folder, small_mission("two", "a"))};
  MissionOptions options;
  options.frames = (folder / "frames.csv").string();
  const auto read = [&](const std::string& text) {
    testing::write_text(options.frames, text);
    return read_missions(paths, options);
  };
  SECTION("of a whole pose") {
    const Mission mission = read(
        "source,x,y,z,qx,qy,qz,qw,sx,sy,sz,srx,sry,srz\n"
        "one,0,0,0,0,0,0,1,0.1,0.1,0.1,0.01,0.01,0.01\ntwo,5,6,7,0,0,1,0,1,2,3,0.1,0.2,0.3\n");
    REQUIRE(mission.graph.priors().size() == 2);
    Vector6d expected;
    expected << 1, 2, 3, 0.1, 0.2, 0.3;
    CHECK(sigmas_of(mission.graph.priors()[1]).isApprox(expected));
    CHECK(mission.graph.priors()[1].pose.translation().isApprox(Eigen::Vector3d(5.0, 6.0, 7.0)));
    CHECK(mission.graph.node(make_key('b', 10)).pose.translation().isApprox(Eigen::Vector3d(-1.0, 6.0, 7.0)));
  }
  SECTION("of position and yaw alone") {
    const Mission mission = read(
        "source,x,y,z,yaw,sx,sy,sz,syaw\none,0,0,0,0,1,1,1,0.1\ntwo,5,6,7,1.5707963267948966,1,2,3,0.5\n");
    CHECK(mission.graph.node(make_key('b', 10)).pose.translation().isApprox(Eigen::Vector3d(5.0, 12.0, 7.0)));
    const Vector6d sigmas = sigmas_of(mission.graph.priors()[1]);
    CHECK(sigmas[5] == Approx(0.5));
    CHECK(sigmas[3] == Approx(options.prior_sigmas[3]));
    CHECK(read("source,x,y,z,yaw\none,0,0,0,0\ntwo,1,2,3,-1\n").graph.priors().size() == 2);
  }
  SECTION("errors name the place") {
    CHECK_THROWS_WITH(read("source,x,y,z,yaw\none,0,0,0,90\ntwo,0,0,0,0\n"),
                      Contains("frames.csv:2: column \"yaw\": must be in rad"));
    CHECK_THROWS_WITH(read("source,x,y,z,yaw,sx,sy,sz,syaw\none,0,0,0,0,1,1,0,1\ntwo,0,0,0,0,1,1,1,1\n"),
                      Contains("column \"sz\": a sigma must be > 0"));
    CHECK_THROWS_WITH(read("source,x,y,yaw\none,0,0,0\n"), Contains("frames.csv:1: header is"));
    options.frames = "auto";
    CHECK_THROWS_WITH(read_missions(paths, options), Contains("frames = \"auto\""));
  }
}

TEST_CASE("parts: placed with all their data, or left out", "[io][joined]") {
  const Mission mission = small_mission("team", "abc", /*landmark=*/true);
  MissionPart first, second;
  first.robots = {mission.robots.of(make_key('b', 7))};
  second.robots = {mission.robots.of(make_key('a', 7))};
  second.T_common_part.translation().z() = 5.0;
  second.sigmas = {1.0, 2.0, 3.0, 0.1, 0.2, 0.3};
  LoopClosure closure;
  closure.from = make_key('a', 8);
  closure.to = make_key('b', 9);
  const Mission placed = place_parts(mission, {first, second}, {closure}, /*move_truth=*/true);
  CHECK(placed.robots.size() == 3);  // with the landmarks
  CHECK(placed.graph.nodes().size() == 9);
  CHECK(placed.graph.node(make_key('a', 8)).pose.translation().z() == 5.0);
  CHECK(placed.graph.node(make_key('L', 0)).pose.translation().z() == 5.0);
  CHECK(placed.graph.node(make_key('b', 8)).pose.translation().z() == 0.0);
  CHECK(placed.graph.edges().size() == 8);
  CHECK(placed.graph.edges().back().kind == EdgeKind::kLoopClosure);
  REQUIRE(placed.graph.priors().size() == 2);
  CHECK(sigmas_of(placed.graph.priors()[0])[0] == Approx(0.01));
  CHECK(sigmas_of(placed.graph.priors()[1])[1] == Approx(2.0));
  CHECK(placed.ground_truth.at(make_key('a', 7)).translation().z() == 5.0);
  CHECK(placed.ground_truth.size() == 8);
  CHECK(placed.radio.size() == 8);
  CHECK(placed.gaps.size() == 2);
  CHECK(placed.problems.count("robot left out: its frame is unknown") == 1);
  CHECK_THROWS_AS(require_unaltered(placed.problems), InputError);
  CHECK(
      place_parts(mission, {first, second}, {}, false).ground_truth.at(make_key('a', 7)).translation().z() ==
      0.0);
  CHECK_THROWS_WITH(place_parts(mission, {first, first}, {}, false), Contains("is in two parts"));
  first.robots = {17};
  CHECK_THROWS_WITH(place_parts(mission, {first}, {}, false), Contains("unknown robot 17"));
}

TEST_CASE("joined: recordings of different days are reported", "[io][joined]") {
  const TemporaryFolder folder;
  Mission later = small_mission("later", "a");
  PoseGraph moved;
  constexpr std::int64_t kDay_ns = 86'400'000'000'000;
  for (Node node : later.graph.nodes()) {
    node.stamp_ns += 3 * kDay_ns;
    moved.add_node(node);
  }
  for (const Edge& edge : later.graph.edges()) moved.add_edge(edge);
  for (const PriorFactor& prior : later.graph.priors()) moved.add_prior(prior);
  later.graph = moved;
  later.start_ns = 3 * kDay_ns;
  const path first = written(folder, small_mission("first", "a")),
             second = written(folder, small_mission("second", "a")), last = written(folder, later);
  const std::string kind = "source recorded more than a day after the others";
  CHECK(read_missions({first, second}).problems.count(kind) == 0);
  CHECK(read_missions({last, first, second}).problems.count(kind) == 1);
  MissionOptions options;
  options.start_together = true;
  CHECK(read_missions({first, last}, options).problems.count(kind) == 0);
}

}  // namespace loopwise::joined_test
