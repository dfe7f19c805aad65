// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/task.hpp>

#include <loopwise/core/error.hpp>
#include "testing.hpp"

namespace loopwise::task_test {
namespace {

/// Robots of keys 0..9 and 100..104, with odometry along each that differs from the poses, and a closure
/// between them.
struct Mission {
  PoseGraph graph;
  Robots robots{{{"a", 0, 99}, {"b", 100, 199}}};
  Rng rng{5};

  Mission() {
    for (const auto& [first, count] : {std::pair<Key, Key>{0, 10}, {100, 5}}) {
      for (Key key = first; key < first + count; ++key) {
        Node node;
        node.key = key;
        node.pose = testing::random_pose(rng);
        graph.add_node(node);
        if (key > first) connect(key - 1, key, EdgeKind::kOdometry);
      }
    }
    connect(3, 102, EdgeKind::kLoopClosure);
    connect(3, 9, EdgeKind::kLoopClosure);
  }
  void connect(Key from, Key to, EdgeKind kind) {
    Edge edge;
    edge.from = from;
    edge.to = to;
    edge.T_from_to = testing::random_pose(rng);
    edge.kind = kind;
    graph.add_edge(edge);
  }
  [[nodiscard]] Eigen::Isometry3d odometry(Key from, Key to) const {
    for (const Edge& edge : graph.edges()) {
      if (edge.from == from && edge.to == to) return edge.T_from_to;
    }
    throw UnknownKeyError("no such edge");
  }
};

LoopCandidate candidate(Key from, Key to) {
  LoopCandidate out;
  out.from = from;
  out.to = to;
  return out;
}

std::vector<Key> keys(const std::vector<SubmapMember>& members) {
  std::vector<Key> out;
  for (const SubmapMember& member : members) out.push_back(member.key);
  return out;
}

TEST_CASE("make_task: neighbours along the odometry, placed by it", "[task]") {
  const Mission m;
  const RegistrationTask task = make_task(m.graph, m.robots, candidate(8, 3), {}, 42);
  REQUIRE(keys(task.source) == std::vector<Key>{8});
  REQUIRE(keys(task.target) == std::vector<Key>{3, 2, 4, 1, 5});
  REQUIRE(testing::difference(task.target[0].T_center_member, Eigen::Isometry3d::Identity()) == 0.0);
  REQUIRE(testing::difference(task.target[3].T_center_member,
                              m.odometry(2, 3).inverse() * m.odometry(1, 2).inverse()) < 1e-12);
  REQUIRE(testing::difference(task.target[4].T_center_member, m.odometry(3, 4) * m.odometry(4, 5)) < 1e-12);
  REQUIRE(task.seed == pair_seed(42, 8, 3));
  REQUIRE(testing::difference(*task.guess_from_to, m.graph.node(8).pose.inverse() * m.graph.node(3).pose) <
          1e-12);
}

TEST_CASE("make_task: chains end with the robot; missing scans are stepped over", "[task]") {
  const Mission m;
  TaskOptions options;
  options.source_neighbours = 3;
  options.use_guess = false;
  const auto has_scan = [](Key key) { return key != 101; };
  const RegistrationTask task = make_task(m.graph, m.robots, candidate(102, 9), options, 1, has_scan);
  REQUIRE(keys(task.source) == std::vector<Key>{102, 103, 100, 104});
  REQUIRE(keys(task.target) == std::vector<Key>{9, 8, 7});
  REQUIRE_FALSE(task.guess_from_to.has_value());
}

TEST_CASE("make_task: the other end is no neighbour, where it would be placed by odometry", "[task]") {
  const Mission m;
  TaskOptions options;
  options.source_neighbours = 2;
  const RegistrationTask task = make_task(m.graph, m.robots, candidate(5, 3), options, 1);
  REQUIRE(keys(task.target) == std::vector<Key>{3, 2, 4, 1});
  REQUIRE(keys(task.source) == std::vector<Key>{5, 4, 6, 7});
}

TEST_CASE("make_task: keys that differ in their high bits alone belong to different robots", "[task]") {
  PoseGraph graph;
  const Key a = make_key('a', 5), b = make_key('b', 5);
  for (const Key key : {a, b}) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  Edge edge;
  edge.from = a;
  edge.to = b;
  edge.kind = EdgeKind::kOdometry;
  graph.add_edge(edge);
  const RegistrationTask task = make_task(graph, Robots::from_keys({a, b}), candidate(b, a), {}, 0);
  REQUIRE(keys(task.target) == std::vector<Key>{a});
}

TEST_CASE("make_task: a candidate without a node is an error", "[task][error]") {
  const Mission m;
  REQUIRE_THROWS_AS(make_task(m.graph, m.robots, candidate(8, 77), {}, 0), UnknownKeyError);
  REQUIRE_THROWS_AS(make_task(m.graph, m.robots, candidate(77, 8), {}, 0), UnknownKeyError);
}

}  // namespace
}  // namespace loopwise::task_test
