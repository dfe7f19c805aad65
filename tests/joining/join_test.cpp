// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/joining/join.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise::join_test {
namespace {

/// A winding path, 2 m from node to node.
Eigen::Isometry3d on_path(double place) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Vector3d(2.0 * place, 12.0 * std::sin(place / 7.0), 0.0);
  T.linear() =
      Eigen::AngleAxisd(std::atan2(12.0 / 7.0 * std::cos(place / 7.0), 2.0), Eigen::Vector3d::UnitZ())
          .matrix();
  return T;
}

/// Robots in separate frames, and their true poses.
struct Team {
  PoseGraph graph;
  Robots robots;
  std::vector<JoinComponent> components;
  std::map<Key, Eigen::Isometry3d> truth;
  std::map<char, Eigen::Isometry3d> frames;  // T_own_world

  void add_robot(char letter, const Eigen::Isometry3d& T_own_world, std::size_t nodes,
                 const std::function<Eigen::Isometry3d(double)>& place) {
    frames[letter] = T_own_world;
    JoinComponent component;
    component.name = std::string(1, letter);
    for (std::size_t i = 0; i < nodes; ++i) {
      const Key key = make_key(letter, i);
      truth[key] = place(static_cast<double>(i));
      Node node;
      node.key = key;
      node.pose = T_own_world * truth[key];
      graph.add_node(node);
      component.keys.push_back(key);
      if (i == 0) continue;
      Edge edge;
      edge.from = make_key(letter, i - 1);
      edge.to = key;
      edge.T_from_to = truth[edge.from].inverse() * truth[key];
      edge.information.diagonal() << Eigen::Vector3d::Constant(2500.0), Eigen::Vector3d::Constant(250000.0);
      edge.kind = EdgeKind::kOdometry;
      graph.add_edge(edge);
    }
    components.push_back(component);
    std::vector<Robot> all = robots.all();
    all.push_back(robot_of_character(letter, component.name));
    robots = Robots(all);
  }
};

/// Answers by rules instead of scans.
class RuleRegistrar final : public Registrar {
 public:
  /// The resulting pose T_from_to, if the pair is verified.
  using Rule = std::function<std::optional<Eigen::Isometry3d>(Key from, Key to)>;
  explicit RuleRegistrar(Rule rule) : rule_(std::move(rule)) {}

  [[nodiscard]] std::string_view name() const override { return "rule"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    RegistrationResult result;
    result.candidate = task.candidate;
    result.overlap = 0.2;
    CHECK_FALSE(task.guess_from_to);  // no frame is trusted
    const auto T = rule_(task.candidate.from, task.candidate.to);
    if (!T) {
      result.reason = reason;
      return result;
    }
    LoopClosure closure;
    closure.from = task.candidate.from;
    closure.to = task.candidate.to;
    Rng rng(pair_seed(3, closure.from, closure.to));
    Vector6d noise;
    for (int i = 0; i < 6; ++i) noise[i] = std::sqrt(covariance(i, i)) * rng.normal();
    closure.T_from_to = *T * se3::exp(noise);
    closure.covariance = covariance;
    result.closure = closure;
    return result;
  }

  RejectionReason reason = RejectionReason::kFewMatches;
  Matrix6d covariance = Vector6d(Vector6d::Constant(0.02 * 0.02)).asDiagonal();

 private:
  Rule rule_;
};

Eigen::Isometry3d moved(double x, double y, double yaw) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).matrix();
  T.translation() = Eigen::Vector3d(x, y, 0.0);
  return T;
}

/// Two robots on one path; b begins 20 nodes further on.
Team two_robots() {
  Team team;
  team.add_robot('a', moved(10.0, -80.0, 1.0), 60, on_path);
  team.add_robot('b', moved(-70.0, 30.0, -2.5), 60, [](double i) { return on_path(i + 20.3); });
  return team;
}

/// The result of a registration at places that both robots saw; seven pairs of ten are verified.
RuleRegistrar::Rule true_places(const Team& team) {
  return [&team](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    const Eigen::Isometry3d T = team.truth.at(from).inverse() * team.truth.at(to);
    if (T.translation().norm() > 4.0 || pair_seed(1, from, to) % 10 >= 7) return std::nullopt;
    return T;
  };
}

JoinResult joined(const Team& team, const Registrar& registrar, const JoinOptions& options = {},
                  int threads = 1) {
  ThreadPool pool(threads);
  return find_frames(team.graph, team.robots, team.components, {}, registrar, pool, options);
}

/// T_a_b of the truth.
Eigen::Isometry3d true_frame(const Team& team, char a, char b) {
  return team.frames.at(a) * team.frames.at(b).inverse();
}

}  // namespace

TEST_CASE("joining: two robots that saw the same places", "[joining]") {
  const Team team = two_robots();
  const RuleRegistrar registrar(true_places(team));
  const JoinResult result = joined(team, registrar);
  CAPTURE(to_string(result, team.components), result.ties[0].reason);
  REQUIRE(result.groups == 1);
  const Eigen::Isometry3d error = true_frame(team, 'a', 'b').inverse() * result.frames[1].pose;
  // At the robot's nodes, up to 200 m from the origin of its frame. Measured: 0.004 rad.
  CHECK(se3::rotation_angle(error) < 0.02);
  const Eigen::Vector3d p = team.graph.node(make_key('b', 20)).pose.translation();
  CHECK((result.frames[1].pose * p - true_frame(team, 'a', 'b') * p).norm() < 0.1);
  CHECK(result.frames[0].pose.isApprox(Eigen::Isometry3d::Identity()));
  CHECK(result.frames[1].covariance.diagonal().minCoeff() > 0.0);
  CHECK(result.ties[0].confirmed >= 8);
  CHECK(result.computed == result.ties[0].computed);

  const JoinResult again = joined(team, registrar, {}, 4);
  CHECK(again.frames[1].pose.matrix() == result.frames[1].pose.matrix());
  CHECK(again.computed == result.computed);
}

TEST_CASE("joining: insufficient evidence", "[joining]") {
  const Team team = two_robots();
  const auto rule = true_places(team);
  SECTION("nothing in common") {
    const RuleRegistrar registrar([](Key, Key) { return std::nullopt; });
    const JoinResult result = joined(team, registrar);
    CHECK(result.groups == 2);
    REQUIRE_THAT(to_string(result, team.components),
                 Contains("0 of 2 joined") && Contains("pairs computed, best overlap 0.2"));
  }
  SECTION("one place") {
    const RuleRegistrar registrar([&](Key from, Key to) {
      return key_index(from) < 3 && key_index(to) < 24 ? rule(from, to) : std::nullopt;
    });
    CHECK(joined(team, registrar).groups == 2);
  }
  SECTION("false closures at random") {
    const RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
      if (pair_seed(2, from, to) % 4 != 0) return std::nullopt;
      Rng rng(pair_seed(4, from, to));
      return moved(rng.normal(), rng.normal(), rng.uniform(-3.0, 3.0));
    });
    const JoinResult result = joined(team, registrar);
    CHECK(result.groups == 2);
    CHECK(result.ties[0].verified > 100);
  }
  SECTION("a corridor that does not tell how far along") {
    RuleRegistrar registrar(rule);
    registrar.covariance(0, 0) = 25.0;
    Team straight;
    straight.add_robot('a', moved(0.0, 0.0, 0.0), 60, [](double i) { return moved(2.0 * i, 0.0, 0.0); });
    straight.add_robot('b', moved(9.0, 5.0, 2.0), 60, [](double i) { return moved(2.0 * i, 0.0, 0.0); });
    RuleRegistrar along(true_places(straight));
    along.covariance(0, 0) = 25.0;
    const JoinResult result = joined(straight, along);
    CAPTURE(result.ties[0].reason);
    CHECK(result.groups == 2);
  }
}

TEST_CASE("joining: twin floors stay apart", "[joining]") {
  // Both floors look alike, so that pairs of different floors are verified as well.
  Team team;
  const auto place = [](double i) {
    Eigen::Isometry3d T = on_path(i < 30.0 ? i : 59.0 - i);
    T.translation().z() = i < 30.0 ? 0.0 : 4.0;
    return T;
  };
  team.add_robot('a', moved(3.0, 4.0, 0.5), 60, place);
  team.add_robot('b', moved(-3.0, 40.0, -0.5), 30, place);
  const RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    Eigen::Isometry3d T = team.truth.at(from).inverse() * team.truth.at(to);
    if (std::abs(T.translation().z()) > 2.0) T.translation().z() = 0.0;
    if (T.translation().norm() > 4.0 || pair_seed(1, from, to) % 10 >= 7) return std::nullopt;
    return T;
  });
  const JoinResult result = joined(team, registrar);
  CAPTURE(to_string(result, team.components));
  CHECK(result.groups == 2);
  CHECK(result.ties[0].rival_closures > 3);
}

TEST_CASE("joining: a frame that pairs close together do not confirm", "[joining]") {
  const Team team = two_robots();
  const Eigen::Isometry3d wrong = moved(60.0, 3.0, 0.8);
  // Few pairs agree on a wrong frame, as places that look alike make them: one pair of eight near it.
  const RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    const Eigen::Isometry3d T = (wrong * team.truth.at(from)).inverse() * team.truth.at(to);
    if (T.translation().norm() > 4.0 || pair_seed(6, from, to) % 8 != 0) return std::nullopt;
    return T;
  });
  const JoinResult result = joined(team, registrar);
  CAPTURE(to_string(result, team.components));
  CHECK(result.groups == 2);
}

TEST_CASE("joining: a cycle that does not close is given up", "[joining]") {
  Team team;
  team.add_robot('a', moved(10.0, -80.0, 1.0), 110, on_path);
  team.add_robot('b', moved(-70.0, 30.0, -2.5), 60, [](double i) { return on_path(i + 20.3); });
  team.add_robot('c', moved(5.0, 60.0, 0.7), 60, [](double i) { return on_path(i + 10.1); });
  // The path looks the same a period further on.
  const Eigen::Isometry3d wrong = moved(2.0 * 14.0 * 3.14159265358979, 0.0, 0.0);
  const auto rule = true_places(team);
  const RuleRegistrar all(rule);
  CHECK(joined(team, all).groups == 1);
  // Between c and a all agree on another frame.
  const RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    if (key_character(from) != 'c' || key_character(to) != 'a') return rule(from, to);
    const Eigen::Isometry3d T = (wrong * team.truth.at(from)).inverse() * team.truth.at(to);
    if (T.translation().norm() > 4.0) return std::nullopt;
    return T;
  });
  const JoinResult result = joined(team, registrar);
  CAPTURE(to_string(result, team.components));
  CHECK(result.groups > 1);
  CHECK_FALSE(result.ties[1].joined);
  REQUIRE_THAT(result.ties[1].reason, Contains("contradict"));
}

TEST_CASE("joining: scans that cannot be read do not count against a frame", "[joining]") {
  const Team team = two_robots();
  const auto rule = true_places(team);
  RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    const Eigen::Isometry3d T = team.truth.at(from).inverse() * team.truth.at(to);
    return T.translation().norm() > 4.0 || key_index(from) % 3 != 0 ? std::nullopt : std::optional(T);
  });
  registrar.reason = RejectionReason::kMissingScan;
  const JoinResult result = joined(team, registrar);
  CAPTURE(result.ties[0].reason);
  CHECK(result.groups == 1);
}

TEST_CASE("joining: a stop leaves all apart", "[joining]") {
  const Team team = two_robots();
  const RuleRegistrar registrar(true_places(team));
  StopSource stop;
  stop.request_stop();
  ThreadPool pool(1);
  const JoinResult result =
      find_frames(team.graph, team.robots, team.components, {}, registrar, pool, {}, {}, stop.token());
  CHECK(result.stopped);
  CHECK(result.groups == 2);
  CHECK(result.computed == 0);
}

TEST_CASE("joining: proposed pairs come first, and work is bounded", "[joining]") {
  const Team team = two_robots();
  std::vector<std::pair<Key, Key>> order;
  const RuleRegistrar registrar([&](Key from, Key to) -> std::optional<Eigen::Isometry3d> {
    order.emplace_back(from, to);
    return std::nullopt;
  });
  JoinOptions options;
  options.max_pairs = 70;
  ThreadPool pool(1);
  std::vector<Progress> shown;
  const std::vector<ProposedPair> proposals = {{make_key('a', 3), make_key('b', 50), 0.9},
                                               {make_key('b', 7), make_key('a', 44), 0.95}};
  const JoinResult result =
      find_frames(team.graph, team.robots, team.components, proposals, registrar, pool, options,
                  [&](const Progress& progress) { shown.push_back(progress); });
  CHECK(result.computed <= 70);
  REQUIRE(order.size() >= 2);
  // Batches are computed by target; the two are among the first batch.
  CHECK(std::count(order.begin(), order.begin() + 64, std::pair(make_key('b', 50), make_key('a', 3))) == 1);
  CHECK(std::count(order.begin(), order.begin() + 64, std::pair(make_key('b', 7), make_key('a', 44))) == 1);
  REQUIRE_FALSE(shown.empty());
  CHECK(shown.back().stage == "joining a and b");
}

TEST_CASE("joining: bad input is named", "[joining][error]") {
  Team team = two_robots();
  const RuleRegistrar registrar(true_places(team));
  ThreadPool pool(1);
  const auto find = [&] {
    static_cast<void>(find_frames(team.graph, team.robots, team.components, {}, registrar, pool));
  };
  SECTION("a key twice") {
    team.components[1].keys.push_back(make_key('a', 1));
    CHECK_THROWS_WITH(find(), Contains("key a1 belongs to two components"));
  }
  SECTION("no key frames") {
    team.components[1].keys.clear();
    CHECK_THROWS_WITH(find(), Contains("b: has no key frames"));
  }
  SECTION("an option") {
    JoinOptions options;
    options.min_places = 1;
    CHECK_THROWS_WITH(find_frames(team.graph, team.robots, team.components, {}, registrar, pool, options),
                      Contains("min_places = 1"));
  }
}

}  // namespace loopwise::join_test
