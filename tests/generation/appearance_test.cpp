// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/appearance.hpp>

#include <map>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>

#include "features/place_site.hpp"
#include "testing.hpp"

namespace loopwise::appearance_test {
namespace {

using testing::level_pose;
using testing::site;

constexpr std::uint64_t kNodes = 15;

/// Two robots cross one site, a node every 2 m, and each has a frame of its own, 300 m and a turn apart.
/// Their bodies are tilted.
struct Team {
  Robots robots = parse_robots("a,b");
  PoseGraph graph;
  std::map<Key, Eigen::Isometry3d> truth;
  std::set<Key> missing, broken;

  [[nodiscard]] ScanLoader scans() {
    return [this](Key key) -> std::shared_ptr<const PointCloud> {
      if (broken.count(key) != 0) throw InputError("scan is damaged");
      if (missing.count(key) != 0) return nullptr;
      return std::make_shared<PointCloud>(site(7, truth.at(key), key, 35.0));
    };
  }
  Key add(char robot, std::uint64_t index) {
    const Key key = make_key(robot, index);
    const double along = 2.0 * static_cast<double>(index);
    Eigen::Isometry3d pose =
        robot == 'a' ? level_pose(along - 14.0, 0.0, 1.2, 0.0) : level_pose(1.0, 14.0 - along, 1.2, -1.57);
    pose.linear() = pose.linear() * se3::so3_exp({0.1, -0.05, 0.0});
    truth[key] = pose;
    Node node;
    node.key = key;
    node.pose = robot == 'a' ? pose : level_pose(300.0, 50.0, 3.0, 2.0) * pose;
    graph.add_node(node);
    if (index > 0) {
      Edge edge;
      edge.from = key - 1;
      edge.to = key;
      edge.kind = EdgeKind::kOdometry;
      edge.T_from_to = truth.at(key - 1).inverse() * pose;
      graph.add_edge(edge);
    }
    return key;
  }
};

std::vector<LoopCandidate> drive(Team& team, AppearanceGenerator& generator) {
  std::vector<LoopCandidate> all;
  for (const char robot : {'a', 'b'}) {
    for (std::uint64_t i = 0; i < kNodes; ++i) {
      for (LoopCandidate& c : generator.on_node(team.graph, team.add(robot, i), 1.0)) all.push_back(c);
    }
  }
  return all;
}

}  // namespace

TEST_CASE("appearance: robots without a common frame find each other, with the relative pose",
          "[generation][appearance]") {
  Team team;
  AppearanceOptions options;
  options.per_place = 2;
  AppearanceGenerator generator(options, team.robots, team.scans());
  REQUIRE(generator.name() == "appearance");
  const auto candidates = drive(team, generator);
  REQUIRE(generator.places().size() == 2 * kNodes);
  REQUIRE(candidates.size() > kNodes);
  std::map<Key, int> per_node;
  double worst_m = 0.0;
  for (const LoopCandidate& c : candidates) {
    CAPTURE(key_name(c.from), key_name(c.to));
    REQUIRE(++per_node[c.from] <= 2);
    REQUIRE(team.robots.of(c.from) == 1);  // robot a's own path is not apart enough
    REQUIRE(team.robots.of(c.to) == 0);
    REQUIRE(c.source == CandidateSource::kAppearance);
    REQUIRE(c.recognition->similarity >= options.min_similarity);
    const Vector6d error =
        se3::log(c.recognition->T_from_to->inverse() * team.truth.at(c.from).inverse() * team.truth.at(c.to));
    REQUIRE(error.dot(c.recognition->covariance.inverse() * error) < 30.0);
    worst_m = std::max(worst_m, error.head<3>().norm());
  }
  CAPTURE(worst_m);
  REQUIRE(worst_m < 2.0);
}

TEST_CASE("appearance: the same calls give the same candidates; a node counts once",
          "[generation][appearance]") {
  Team one, two;
  AppearanceGenerator first({}, one.robots, one.scans()), second({}, two.robots, two.scans());
  const auto a = drive(one, first), b = drive(two, second);
  REQUIRE(a.size() == b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    REQUIRE(a[i].from == b[i].from);
    REQUIRE(a[i].to == b[i].to);
    REQUIRE(a[i].recognition->T_from_to->matrix() == b[i].recognition->T_from_to->matrix());
  }
  REQUIRE(first.on_node(one.graph, make_key('b', 3), 2.0).empty());
}

TEST_CASE("appearance: scans that come later, never, or cannot be read", "[generation][appearance][error]") {
  Team team;
  const Key late = make_key('b', 7), damaged = make_key('b', 9);
  team.missing = {late, make_key('b', 8)};
  team.broken = {damaged};
  AppearanceGenerator generator({}, team.robots, team.scans());
  const auto candidates = drive(team, generator);
  for (const LoopCandidate& c : candidates) REQUIRE((c.from != late && c.from != damaged));
  REQUIRE(generator.places().size() == 2 * kNodes - 3);
  REQUIRE(generator.problems().count("scan of a place cannot be read") > 0);
  team.missing.clear();
  REQUIRE(generator.on_node(team.graph, make_key('b', 20), 1.0).empty());  // not in the graph
  // Places are a metre apart along the path, and those behind the last one are left out.
  REQUIRE(generator.on_node(team.graph, late, 1.0).empty());
}

TEST_CASE("appearance: nodes of one robot must be apart along its path", "[generation][appearance]") {
  Team team;
  AppearanceOptions options;
  options.apart_m = 6.0;
  options.min_similarity = 0.0;
  AppearanceGenerator generator(options, team.robots, team.scans());
  std::size_t own = 0;
  for (const LoopCandidate& c : drive(team, generator)) {
    if (team.robots.of(c.from) != team.robots.of(c.to)) continue;
    ++own;
    REQUIRE(c.from - c.to >= 3);
  }
  REQUIRE(own > 0);
  options.apart_m = -1.0;
  REQUIRE_THROWS_AS(AppearanceGenerator(options, team.robots, team.scans()), OptionError);
  REQUIRE_THROWS_AS(AppearanceGenerator({}, team.robots, {}), InputError);
}

}  // namespace loopwise::appearance_test
