// SPDX-License-Identifier: BSD-3-Clause
// The state after a failed allocation. scripts/fault_check does the same with whole commands.
#include <filesystem>
#include <new>
#include <set>
#include <utility>

#include <loopwise/engine/engine.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/graph_information.hpp>

#include "allocations.hpp"
#include "packed.hpp"
#include "testing.hpp"

namespace loopwise::without_memory_test {
namespace {

namespace fs = std::filesystem;

/// Whether the call succeeded although its n-th allocation failed.
template <class Call>
bool ends_without(long n, Call&& call) {
  fuzz::allocations_until_none = n;
  bool ended = true;
  try {
    call();
  } catch (const std::bad_alloc&) {
    ended = false;
  }
  fuzz::allocations_until_none = 0;
  return ended;
}

/// Nodes from 0 on, a metre apart, with odometry that says `odometry_m`.
PoseGraph straight_path(Key nodes, double odometry_m) {
  PoseGraph graph;
  for (Key key = 0; key < nodes; ++key) {
    Node node;
    node.key = key;
    node.pose.translation().x() = static_cast<double>(key);
    graph.add_node(node);
    if (key == 0) continue;
    Edge edge;
    edge.from = key - 1;
    edge.to = key;
    edge.T_from_to.translation().x() = odometry_m;
    edge.information = 100.0 * Matrix6d::Identity();
    edge.kind = EdgeKind::kOdometry;
    graph.add_edge(edge);
  }
  return graph;
}

TEST_CASE("without memory: a value of an option that cannot be copied", "[memory][error]") {
  using detail::OptionValue;
  for (const OptionValue& value :
       {OptionValue(std::string(100, 'x')), OptionValue(detail::OptionNumbers{{1.0, 2.0, 3.0}})}) {
    REQUIRE_FALSE(ends_without(1, [&] { const OptionValue copy(value); }));
  }
}

TEST_CASE("without memory: a file is written whole or not at all", "[memory][error]") {
  const testing::TemporaryFolder folder;
  const fs::path file = folder / "a_name_that_is_long_enough_to_ask_for_memory.txt";
  testing::write_text(file, "old");
  long n = 1;
  while (!ends_without(n, [&] { write_file(file, "new"); })) {
    REQUIRE(testing::read_text(file) == "old");
    ++n;
  }
  REQUIRE(n > 3);
  REQUIRE(testing::read_text(file) == "new");
  REQUIRE(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()) == 1);
}

TEST_CASE("without memory: numbers that cannot be packed", "[memory][error]") {
  const std::vector<double> values{1.0, 2.0, 3.0};
  long n = 1;
  while (!ends_without(n, [&] { const auto packed = training::pack(values); })) ++n;
  REQUIRE(n == 3);  // the bytes, and the value that holds them
  REQUIRE(training::Field("packed", training::pack(values)).values<double>() == values);
}

TEST_CASE("without memory: a failed call does not change a graph, and succeeds later", "[memory][error]") {
  const PoseGraph before = straight_path(6, 1.0);
  Node node;
  node.key = 6;
  Edge edge = before.edges().front();
  edge.from = 5;
  edge.to = 6;
  const auto is_whole = [](const PoseGraph& graph) {
    std::size_t ends = 0;
    for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
      for (const std::size_t e : graph.edges_of(i)) {
        if (graph.ends(e).from == i || graph.ends(e).to == i) ++ends;
      }
    }
    return ends == 2 * graph.edges().size();
  };
  const auto to_the_third = [](const Edge& e) { return e.to == 3; };
  long n = 1;
  for (bool ended = false; !ended; ++n) {
    CAPTURE(n);
    PoseGraph graph = before;
    ended = ends_without(n, [&] {
      graph.add_node(node);
      graph.add_edge(edge);
      graph.remove_edges_if(to_the_third);
    });
    REQUIRE(is_whole(graph));
    if (!graph.contains(6)) {
      REQUIRE(graph.nodes().size() == 6);
      graph.add_node(node);
    }
    if (graph.edges_of(6).empty()) graph.add_edge(edge);
    graph.remove_edges_if(to_the_third);
    REQUIRE(is_whole(graph));
    REQUIRE(graph.nodes().size() == 7);
    REQUIRE(graph.edges().size() == 5);
  }
  REQUIRE(n > 8);
}

TEST_CASE("without memory: no passage of a radio beacon is missed", "[memory][error]") {
  const PoseGraph graph = straight_path(60, 1.0);
  const auto readings_of = [](const std::vector<Key>& keys) {
    std::vector<RadioReading> readings;
    for (const Key key : keys)
      readings.push_back({key, "a beacon with a name that is long", 28.0, "0", -22.0});
    return readings;
  };
  BeaconDrop drop;
  drop.beacon = "a beacon with a name that is long";
  drop.drop_key = 5;
  using Pairs = std::set<std::pair<Key, Key>>;
  // Every call is repeated until it succeeds. Nodes 57 and 58 wait, because they come before the drop.
  const auto proposed = [&](long n, bool& ended) {
    RadioGenerator generator({}, parse_robots("0-29,30-59"));
    Pairs pairs;
    std::size_t candidates = 0;
    const auto attempt = [&](auto&& call) {
      std::vector<LoopCandidate> found;
      while (true) {
        try {
          found = call();
          break;
        } catch (const std::bad_alloc&) {
          ended = false;
        }
      }
      const long left = fuzz::allocations_until_none.exchange(0);
      for (const LoopCandidate& c : found) pairs.emplace(c.from, c.to);
      candidates += found.size();
      fuzz::allocations_until_none = left;
    };
    const auto early = readings_of({57, 58}), out = readings_of({6, 7, 28, 29, 30, 31}),
               back = readings_of({31, 59});
    fuzz::allocations_until_none = n;
    ended = true;
    attempt([&] { return generator.on_radio(graph, early, 1.0); });
    attempt([&] { return generator.on_drop(graph, drop, 2.0); });
    attempt([&] { return generator.on_radio(graph, out, 3.0); });
    attempt([&] { return generator.on_node(graph, 40, 4.0); });
    attempt([&] { return generator.on_radio(graph, back, 5.0); });
    fuzz::allocations_until_none = 0;
    REQUIRE(candidates == pairs.size());  // none twice
    REQUIRE(generator.waiting() == 0);
    return pairs;
  };
  bool ended = false;
  const Pairs wanted = proposed(0, ended);
  REQUIRE(wanted.size() > 8);
  long n = 1;
  for (ended = false; !ended; ++n) {
    CAPTURE(n);
    REQUIRE(proposed(n, ended) == wanted);
  }
  REQUIRE(n > 30);
}

TEST_CASE("without memory: a failed call does not change an optimizer", "[memory][error]") {
  const PoseGraph before = straight_path(12, 1.1);
  PoseGraph after = before;
  Edge closure;
  closure.from = 1;
  closure.to = 10;
  closure.T_from_to.setIdentity();
  closure.T_from_to.translation() << 9.0, 0.5, 0.0;
  closure.information = 100.0 * Matrix6d::Identity();
  closure.kind = EdgeKind::kLoopClosure;
  after.add_edge(closure);
  const auto start = [&before] {
    PoseGraphOptimizer optimizer;
    static_cast<void>(optimizer.optimize(before));
    return optimizer;
  };
  PoseGraphOptimizer untroubled = start();
  const std::vector<Eigen::Isometry3d> wanted = untroubled.optimize(after).poses;
  long n = 1;
  for (bool ended = false; !ended; ++n) {
    CAPTURE(n);
    PoseGraphOptimizer optimizer = start();
    ended = ends_without(n, [&] { static_cast<void>(optimizer.optimize(after)); });
    const std::vector<Eigen::Isometry3d> poses = optimizer.optimize(after).poses;
    REQUIRE(poses.size() == wanted.size());
    for (std::size_t i = 0; i < poses.size(); ++i) REQUIRE(poses[i].isApprox(wanted[i], 1e-9));
  }
  REQUIRE(n > 50);
}

TEST_CASE("without memory: an engine keeps the events before the one that failed", "[memory][error]") {
  const PoseGraph path = straight_path(12, 1.0);
  EngineOptions options;
  options.generation.skip_recent = 2;
  const auto frame_of = [&path](std::size_t i) {
    KeyFrame frame;
    frame.node = path.nodes()[i];
    if (i > 0) {
      const Edge& edge = path.edges()[i - 1];
      frame.odometry.push_back({edge.from, edge.to, edge.T_from_to, edge.information});
    }
    frame.cloud = std::make_shared<const PointCloud>();
    return frame;
  };
  std::vector<KeyFrame> frames;
  for (std::size_t i = 0; i < path.nodes().size(); ++i) frames.push_back(frame_of(i));
  long n = 1;
  for (bool ended = false; !ended; ++n) {
    CAPTURE(n);
    std::vector<std::unique_ptr<Prioritizer>> prioritizers;
    prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
    Engine engine(Robots::from_keys(path.keys()), options, RoundRobinQueue(std::move(prioritizers)));
    std::size_t handled = 0;
    ended = ends_without(n, [&] {
      for (const KeyFrame& frame : frames) {
        static_cast<void>(engine.handle(frame, static_cast<double>(handled)));
        ++handled;
      }
    });
    REQUIRE(engine.graph().nodes().size() >= handled);
    REQUIRE(engine.graph().nodes().size() <= handled + 1);
    REQUIRE(engine.graph().edges().size() + 1 >= handled);
    for (std::size_t i = 0; i < handled; ++i) REQUIRE(engine.graph().nodes()[i].key == path.nodes()[i].key);
  }
  REQUIRE(n > 50);
}

}  // namespace
}  // namespace loopwise::without_memory_test
