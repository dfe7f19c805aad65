// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/radio.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>

#include "testing.hpp"

namespace loopwise::radio_test {
namespace {

using Pairs = std::vector<std::pair<std::string, std::string>>;

/// Robots a, b and c with 100 nodes each; node i of every robot is made at second i.
PoseGraph team(std::uint64_t nodes = 100) {
  PoseGraph graph;
  for (std::uint64_t i = 0; i < nodes; ++i) {
    for (const char robot : {'a', 'b', 'c'}) {
      Node node;
      node.key = make_key(robot, i);
      node.pose.translation().x() = 2.0 * static_cast<double>(i);
      node.stamp_ns = static_cast<std::int64_t>(i) * 1000000000;
      graph.add_node(node);
    }
  }
  return graph;
}

BeaconDrop dropped(const std::string& beacon, char robot, std::uint64_t index) {
  return {beacon, static_cast<std::size_t>(robot - 'a'), make_key(robot, index),
          static_cast<std::int64_t>(index) * 1000000000};
}

/// Two receivers with this mean loss.
std::vector<RadioReading> readings_of(Key key, const std::string& beacon, double loss_db = 50.0) {
  return {{key, beacon, 28.0, "0", 28.0 - loss_db - 3.0}, {key, beacon, 28.0, "1", 28.0 - loss_db + 3.0}};
}

class Fixture {
 public:
  explicit Fixture(RadioOptions options = {})
      : graph(team()), generator(options, Robots::from_keys(graph.keys())) {}

  void drop(const std::string& beacon, char robot, std::uint64_t index) {
    note(generator.on_drop(graph, dropped(beacon, robot, index), 1.0));
  }
  Pairs hear(char robot, std::uint64_t index, const std::string& beacon = "x", double loss_db = 50.0) {
    return note(generator.on_radio(graph, readings_of(make_key(robot, index), beacon, loss_db), 2.0));
  }
  Pairs note(const std::vector<LoopCandidate>& candidates) {
    Pairs out;
    for (const LoopCandidate& c : candidates) {
      REQUIRE(c.source == CandidateSource::kRadio);
      REQUIRE(std::abs(c.distance_m -
                       (graph.node(c.from).pose.translation() - graph.node(c.to).pose.translation()).norm()) <
              1e-12);
      out.emplace_back(key_name(c.from), key_name(c.to));
    }
    return out;
  }

  PoseGraph graph;
  RadioGenerator generator;
};

}  // namespace

TEST_CASE("radio: fly-bys are proposed against all earlier ones, in the order of traversal",
          "[generation][radio]") {
  Fixture f;
  f.drop("x", 'a', 5);
  // b passes by: against the drop. A little later c: against the drop and b's fly-by.
  REQUIRE(f.hear('b', 10) == Pairs{{"b10", "a5"}});
  REQUIRE(f.hear('b', 12) == Pairs{{"b12", "a5"}});
  REQUIRE(f.hear('c', 15) == Pairs{{"c15", "a5"}, {"c15", "b10"}, {"c15", "b12"}});
  // b comes back after more than 20 nodes: its second fly-by.
  REQUIRE(f.hear('b', 40) == Pairs{{"b40", "a5"}, {"b40", "b10"}, {"b40", "b12"}, {"b40", "c15"}});
  REQUIRE(f.hear('b', 60) == Pairs{{"b60", "a5"}, {"b60", "b10"}, {"b60", "b12"}, {"b60", "c15"}});
  // After 21 a third.
  REQUIRE(f.hear('b', 81).size() == 6);
}

TEST_CASE("radio: the dropping robot's first fly-by starts once it has left", "[generation][radio]") {
  Fixture f;
  f.drop("x", 'a', 5);
  for (const std::uint64_t on_its_way_out : {6, 7, 9, 25, 45}) REQUIRE(f.hear('a', on_its_way_out).empty());
  REQUIRE(f.hear('a', 66) == Pairs{{"a66", "a5"}});
  REQUIRE(f.hear('a', 67) == Pairs{{"a67", "a5"}});
  REQUIRE(f.hear('b', 68) == Pairs{{"b68", "a5"}, {"b68", "a66"}, {"b68", "a67"}});
  // The drop's own node and those before it are nothing.
  REQUIRE(f.hear('a', 5).empty());
  REQUIRE(f.hear('a', 4).empty());
}

TEST_CASE("radio: readings before the drop are ignored", "[generation][radio]") {
  Fixture f;
  f.drop("x", 'a', 20);
  REQUIRE(f.hear('b', 19).empty());
  REQUIRE(f.hear('a', 3).empty());
  REQUIRE(f.hear('b', 20) == Pairs{{"b20", "a20"}});
}

TEST_CASE("radio: threshold on the mean over receivers with a reading", "[generation][radio]") {
  RadioOptions options;
  options.max_loss_db = 55.0;
  Fixture f(options);
  f.drop("x", 'a', 0);
  REQUIRE(f.hear('b', 1, "x", 55.0).empty());  // must be less
  REQUIRE(f.hear('b', 2, "x", 54.9).size() == 1);
  REQUIRE(f.hear('b', 3, "x", -1.0).empty());  // louder than it was sent
  REQUIRE(f.generator.problems().count("radio loss not positive") == 1);

  const double nan = std::nan("");
  const Key key = make_key('c', 4);
  // One of three receivers deaf: mean of the other two, 50; with a zero for it the mean would be 33.
  REQUIRE(mean_path_loss_db({{key, "x", 20, "0", -25}, {key, "x", 20, "1", nan}, {key, "x", 20, "2", -35}}) ==
          Approx(50.0));
  REQUIRE(f.note(f.generator.on_radio(f.graph, {{key, "x", 20, "0", -25}, {key, "x", 20, "1", nan}}, 1.0)) ==
          Pairs{{"c4", "a0"}, {"c4", "b2"}});
  REQUIRE(f.note(f.generator.on_radio(f.graph, {{make_key('c', 5), "x", 20, "0", nan}}, 1.0)).empty());
  REQUIRE(f.note(f.generator.on_radio(f.graph, {{make_key('c', 5), "x", nan, "0", -20}}, 1.0)).empty());
  REQUIRE(f.generator.problems().count("radio reading without power") == 2);
  REQUIRE(std::isnan(mean_path_loss_db({})));
}

TEST_CASE("radio: robots that alternate at a beacon do not split each other's fly-bys",
          "[generation][radio]") {
  Fixture f;
  f.drop("x", 'a', 0);
  std::set<std::pair<std::string, std::string>> pairs;
  for (std::uint64_t i = 30; i < 36; ++i) {
    for (const char robot : {'b', 'c'}) {
      for (const auto& [from, to] : f.hear(robot, i)) {
        REQUIRE(pairs.emplace(from, to).second);
        REQUIRE(from[0] != to[0]);  // no pair within a fly-by
      }
    }
  }
  REQUIRE(pairs.size() == 12 + 36);  // each against the drop, and every b against every c
}

TEST_CASE("radio: several beacons at once, a pair proposed by two of them once", "[generation][radio]") {
  Fixture f;
  f.drop("x", 'a', 0);
  f.drop("y", 'a', 2);
  const auto both = [&](char robot, std::uint64_t index) {
    auto readings = readings_of(make_key(robot, index), "x");
    for (const RadioReading& r : readings_of(make_key(robot, index), "y")) readings.push_back(r);
    return f.note(f.generator.on_radio(f.graph, readings, 1.0));
  };
  REQUIRE(both('b', 10) == Pairs{{"b10", "a0"}, {"b10", "a2"}});
  REQUIRE(both('c', 12) == Pairs{{"c12", "a0"}, {"c12", "b10"}, {"c12", "a2"}});
  // At x alone: y's fly-bys are not x's.
  REQUIRE(f.hear('b', 50, "y").size() == 3);
  REQUIRE(f.hear('c', 50, "x") == Pairs{{"c50", "a0"}, {"c50", "b10"}, {"c50", "c12"}});
}

TEST_CASE("radio: waits for late data", "[generation][radio]") {
  const auto pairs_of = [](const std::vector<int>& order) {
    // Node c30, its reading and the drop in any order.
    PoseGraph graph = team(30);
    Node node;
    node.key = make_key('c', 30);
    node.stamp_ns = 30000000000;
    RadioGenerator generator({}, Robots::from_keys(team(1).keys()));
    std::vector<LoopCandidate> found;
    const auto note = [&](const std::vector<LoopCandidate>& more) {
      found.insert(found.end(), more.begin(), more.end());
    };
    note(generator.on_radio(graph, readings_of(make_key('b', 10), "x"), 1.0));
    note(generator.on_radio(graph, readings_of(make_key('b', 2), "x"),
                            1.0));  // before the drop, as will turn out
    for (const int step : order) {
      if (step == 0) {
        graph.add_node(node);
        note(generator.on_node(graph, node.key, 1.0));
      } else if (step == 1) {
        note(generator.on_radio(graph, readings_of(node.key, "x"), 1.0));
      } else {
        note(generator.on_drop(graph, dropped("x", 'a', 5), 1.0));
      }
    }
    REQUIRE(generator.waiting() == 0);
    std::set<std::pair<Key, Key>> pairs;
    for (const LoopCandidate& c : found) pairs.emplace(c.from, c.to);
    return pairs;
  };
  std::vector<int> order{0, 1, 2};
  const auto expected = pairs_of(order);
  REQUIRE(expected.size() == 3);
  while (std::next_permutation(order.begin(), order.end())) REQUIRE(pairs_of(order) == expected);
}

TEST_CASE("radio: unknown nodes and beacons, repeated words", "[generation][radio][error]") {
  RadioOptions options;
  options.max_waiting = 2;
  Fixture f(options);
  REQUIRE(f.hear('b', 10, "never dropped").empty());
  REQUIRE(f.generator.waiting() == 1);
  REQUIRE(f.note(f.generator.on_radio(f.graph, readings_of(make_key('b', 5000), "x"), 1.0)).empty());
  REQUIRE(f.note(f.generator.on_radio(f.graph, readings_of(make_key('z', 1), "x"), 1.0)).empty());
  REQUIRE(f.generator.problems().count("radio reading at a node of no robot") == 2);
  REQUIRE(f.generator.waiting() == 2);
  REQUIRE(f.hear('b', 11, "never dropped").empty());  // the oldest goes
  REQUIRE(f.generator.waiting() == 2);
  REQUIRE(f.generator.problems().count("radio reading of a node or beacon that did not arrive") == 1);
  f.drop("x", 'z', 0);
  REQUIRE(f.generator.problems().count("beacon dropped at a node of no robot") == 1);
  f.drop("x", 'a', 0);
  f.drop("x", 'b', 3);
  REQUIRE(f.generator.problems().count("beacon dropped twice") == 1);
  REQUIRE(f.hear('c', 50).size() == 1);
  REQUIRE(f.hear('c', 50).empty());  // heard again
  REQUIRE_THROWS_AS(f.generator.on_node(f.graph, make_key('a', 1000), 1.0), UnknownKeyError);
  REQUIRE(f.note(f.generator.on_radio(f.graph, {}, 1.0)).empty());
  options.max_loss_db = 0.0;
  REQUIRE_THROWS_WITH(RadioGenerator(options, Robots{}), "max_loss_db = 0, must be > 0");
}

}  // namespace loopwise::radio_test
