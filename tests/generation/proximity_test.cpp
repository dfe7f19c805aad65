// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/generation/proximity.hpp>

#include "testing.hpp"

namespace loopwise::proximity_test {
namespace {

Node node_at(Key key, const Eigen::Vector3d& position) {
  Node node;
  node.key = key;
  node.pose.translation() = position;
  return node;
}

/// Nodes of two robots that wander at random over a square; robot b's come in between robot a's.
std::vector<Node> random_nodes(Rng& rng, int count, double size_m) {
  std::vector<Node> nodes;
  std::uint64_t next[2] = {0, 0};
  for (int i = 0; i < count; ++i) {
    const std::size_t robot = rng.below(2);
    const Eigen::Vector3d position(rng.uniform(-size_m, size_m), rng.uniform(-size_m, size_m),
                                   rng.uniform(-3.0, 3.0));
    nodes.push_back(node_at(make_key(robot == 0 ? 'a' : 'b', next[robot]++), position));
  }
  return nodes;
}

using Pair = std::pair<Key, Key>;

/// The literal definition: all older nodes, without an index.
std::vector<Pair> brute_force(const std::vector<Node>& nodes, const ProximityOptions& o) {
  std::vector<Pair> pairs;
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    std::vector<std::pair<double, std::size_t>> near;
    for (std::size_t c = 0; c < n; ++c) {
      const Key a = nodes[n].key, b = nodes[c].key;
      const bool same = key_character(a) == key_character(b);
      const double gap = std::abs(static_cast<double>(key_index(a)) - static_cast<double>(key_index(b)));
      if (same && gap < static_cast<double>(o.skip_recent)) continue;
      double radius = o.rate_m * (same ? gap : static_cast<double>(key_index(a)));
      radius = std::max(radius, o.radius_min_m);
      if (o.radius_max_m > 0.0) radius = std::min(radius, o.radius_max_m);
      const double distance = (nodes[n].pose.translation() - nodes[c].pose.translation()).norm();
      if (distance <= radius) near.emplace_back(distance, c);
    }
    std::sort(near.begin(), near.end());
    if (o.n_closest > 0 && near.size() > static_cast<std::size_t>(o.n_closest)) {
      near.resize(static_cast<std::size_t>(o.n_closest));
    }
    std::sort(near.begin(), near.end(), [](const auto& x, const auto& y) { return x.second < y.second; });
    for (const auto& [distance, c] : near) pairs.emplace_back(nodes[n].key, nodes[c].key);
  }
  return pairs;
}

std::vector<Pair> generate(ProximityGenerator& generator, PoseGraph& graph, const std::vector<Node>& nodes) {
  std::vector<Pair> pairs;
  for (const Node& node : nodes) {
    graph.add_node(node);
    for (const LoopCandidate& c : generator.on_node(graph, node.key, 7.0)) {
      pairs.emplace_back(c.from, c.to);
      REQUIRE(c.time_s == 7.0);
      REQUIRE(c.source == CandidateSource::kProximity);
      REQUIRE(c.distance_m ==
              Approx((graph.node(c.from).pose.translation() - graph.node(c.to).pose.translation()).norm()));
    }
  }
  return pairs;
}

}  // namespace

TEST_CASE("proximity: every preset equals the definition", "[generation][property]") {
  for (const std::string& name : proximity_preset_names()) {
    for (const std::uint64_t seed : {1, 2, 3}) {
      CAPTURE(name, seed);
      Rng rng(seed);
      const std::vector<Node> nodes = random_nodes(rng, 500, 150.0);
      ProximityOptions options = proximity_preset(name);
      options.spacing_m = 0.0;
      ProximityGenerator generator(options, parse_robots("a,b"));
      PoseGraph graph;
      const auto pairs = generate(generator, graph, nodes);
      REQUIRE_FALSE(pairs.empty());
      REQUIRE(pairs == brute_force(nodes, options));
    }
  }
}

TEST_CASE("proximity: large worlds use the grid and still equal the definition", "[generation][property]") {
  Rng rng(4);
  const std::vector<Node> nodes = random_nodes(rng, 6000, 2000.0);
  for (const char* name : {"lamp_base", "lamp_robot"}) {
    ProximityOptions options = proximity_preset(name);
    options.spacing_m = 0.0;
    ProximityGenerator generator(options, parse_robots("a,b"));
    PoseGraph graph;
    REQUIRE(generate(generator, graph, nodes) == brute_force(nodes, options));
  }
}

TEST_CASE("proximity: nodes that arrive late are proposed like any other", "[generation]") {
  // Robot a's node 40 comes before its node 5, as after a communication gap of another radio.
  ProximityGenerator generator(proximity_preset("lamp_robot"), parse_robots("a"));
  PoseGraph graph;
  graph.add_node(node_at(make_key('a', 40), Eigen::Vector3d::Zero()));
  REQUIRE(generator.on_node(graph, make_key('a', 40), 0.0).empty());
  graph.add_node(node_at(make_key('a', 5), Eigen::Vector3d(6.9, 0, 0)));  // radius 0.2 · 35 = 7 m
  REQUIRE(generator.on_node(graph, make_key('a', 5), 0.0).size() == 1);
}

TEST_CASE("proximity: of nodes close together on a path only some are used", "[generation]") {
  // Twice round a square of 40 m with a node every 0.25 m, standing still for a while at each corner.
  const auto candidates_of = [](const ProximityOptions& options, bool turns) {
    ProximityGenerator generator(options, parse_robots("a"));
    PoseGraph graph;
    std::set<Key> taking_part;
    std::size_t candidates = 0;
    std::uint64_t next = 0;
    const auto add = [&](const Eigen::Vector3d& position, double yaw) {
      Node node = node_at(make_key('a', next++), position);
      node.pose.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, turns ? yaw : 0.0));
      graph.add_node(node);
      for (const LoopCandidate& c : generator.on_node(graph, node.key, 0.0)) {
        taking_part.insert({c.from, c.to});
        ++candidates;
      }
    };
    const Eigen::Vector3d corners[] = {{0, 0, 0}, {40, 0, 0}, {40, 40, 0}, {0, 40, 0}};
    for (int side = 0; side < 8; ++side) {
      const Eigen::Vector3d from = corners[side % 4], to = corners[(side + 1) % 4];
      for (int i = 0; i < 160; ++i) add(from + i / 160.0 * (to - from), 1.5 * side);
      for (int i = 0; i < 20; ++i) add(to, 1.5 * side + 0.075 * i);
    }
    return std::pair(candidates, taking_part.size());
  };
  ProximityOptions all = proximity_preset("lamp_base");
  all.spacing_m = 0.0;
  const auto [every, every_node] = candidates_of(all, false);
  ProximityOptions apart = proximity_preset("lamp_base");
  apart.spacing_m = 0.99;  // 1 m but for rounding
  const auto [some, some_nodes] = candidates_of(apart, false);
  REQUIRE(every_node == 1440);
  REQUIRE(some_nodes <= 321);  // one a metre
  REQUIRE(some_nodes >= 310);
  REQUIRE(some < every / 12);
  // Turning on the spot shows other things: 1.5 rad at each corner are one or two more nodes.
  const auto [turned, turned_nodes] = candidates_of(apart, true);
  REQUIRE(turned_nodes >= some_nodes + 8);
  REQUIRE(turned_nodes <= some_nodes + 8 * 3);
}

TEST_CASE("proximity: distances follow the current estimate", "[generation]") {
  ProximityGenerator generator(proximity_preset("lamp_base"), parse_robots("a"));
  PoseGraph graph;
  graph.add_node(node_at(make_key('a', 0), Eigen::Vector3d(500, 0, 0)));
  REQUIRE(generator.on_node(graph, make_key('a', 0), 0.0).empty());
  graph.set_pose(make_key('a', 0), Eigen::Isometry3d::Identity());
  generator.on_graph(graph);
  graph.add_node(node_at(make_key('a', 50), Eigen::Vector3d(10, 0, 0)));
  REQUIRE(generator.on_node(graph, make_key('a', 50), 0.0).size() == 1);
}

TEST_CASE("proximity: nodes that move are proposed at their present positions, as defined",
          "[generation][property]") {
  for (const std::string& name : proximity_preset_names()) {
    for (const int count : {200, 3000}) {  // by the list of all, and by the grid
      CAPTURE(name, count);
      Rng rng(8);
      ProximityOptions options = proximity_preset(name);
      options.spacing_m = 0.0;
      options.n_closest = 0;  // counts for each node that moves
      if (options.radius_max_m == 0.0) options.radius_max_m = 100.0;
      std::vector<Node> nodes = random_nodes(rng, count, 10.0 * std::sqrt(count));
      ProximityGenerator generator(options, parse_robots("a,b"));
      PoseGraph graph;
      static_cast<void>(generate(generator, graph, nodes));
      std::set<Key> moved;
      for (Node& node : nodes) {
        if (rng.below(10) != 0) continue;
        node.pose.translation() += Eigen::Vector3d(rng.uniform(-90, 90), rng.uniform(-90, 90), 0.0);
        graph.set_pose(node.key, node.pose);
        moved.insert(node.key);
      }
      std::set<Pair> found, expected;
      for (const LoopCandidate& c : generator.on_moved(graph, {moved.begin(), moved.end()}, 9.0))
        found.emplace(c.from, c.to);
      for (const Pair& pair : brute_force(nodes, options)) {
        if (moved.count(pair.first) + moved.count(pair.second) > 0) expected.insert(pair);
      }
      REQUIRE_FALSE(found.empty());
      REQUIRE(found == expected);
      // And those that come later find them there.
      const Node next = node_at(make_key('a', 9000), nodes[50].pose.translation());
      nodes.push_back(next);
      graph.add_node(next);
      std::size_t near = 0;
      for (const Pair& pair : brute_force(nodes, options)) near += pair.first == next.key ? 1 : 0;
      REQUIRE(generator.on_node(graph, next.key, 9.0).size() == near);
    }
  }
}

TEST_CASE("proximity: bad options and unknown nodes are errors", "[generation][error]") {
  ProximityOptions options;
  options.rate_m = -1.0;
  REQUIRE_THROWS_WITH(ProximityGenerator(options, Robots()), "rate_m = -1, must be >= 0");
  options = {};
  options.radius_min_m = 50.0;
  REQUIRE_THROWS_WITH(ProximityGenerator(options, Robots()), Contains("must be <= radius_max_m"));
  REQUIRE_THROWS_WITH(proximity_preset("lamp"), Contains("lamp_base"));

  PoseGraph graph;
  graph.add_node(node_at(3, Eigen::Vector3d::Zero()));
  ProximityGenerator generator(ProximityOptions{}, parse_robots("a"));
  REQUIRE_THROWS_AS(generator.on_node(graph, 3, 0.0), UnknownKeyError);  // no robot owns it
}

}  // namespace loopwise::proximity_test
