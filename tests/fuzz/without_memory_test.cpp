// SPDX-License-Identifier: BSD-3-Clause
// What is left where a request for memory finds none. scripts/fault_check does the same to whole commands.
#include <filesystem>
#include <new>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/prioritization/graph_information.hpp>

#include "allocations.hpp"
#include "packed.hpp"
#include "testing.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

/// Whether the call came to its end although the n-th request found no memory.
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

TEST_CASE("without memory: an optimizer goes on afterwards as if nothing had been asked", "[memory][error]") {
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

TEST_CASE("without memory: candidates that could not be chosen among are still there", "[memory][error]") {
  PoseGraph graph = straight_path(20, 1.0);
  PriorFactor prior;
  prior.information = 1e6 * Matrix6d::Identity();
  graph.add_prior(prior);
  std::vector<LoopCandidate> candidates;
  for (Key to = 0; to < 8; ++to) {
    LoopCandidate candidate;
    candidate.id = candidates.size();
    candidate.from = 19 - to;
    candidate.to = to;
    candidates.push_back(candidate);
  }
  for (const SelectorKind selector : {SelectorKind::kAnnealing, SelectorKind::kGreedy}) {
    GraphInformationOptions options;
    options.selector = selector;
    const auto start = [&] {
      GraphInformationPrioritizer gi(options, {}, {});
      gi.on_graph(graph);
      static_cast<void>(gi.add(candidates));
      return gi.take(8).size();
    };
    REQUIRE(start() == 8);
    long n = 1;
    for (bool ended = false; !ended; n += 1 + n / 20) {
      CAPTURE(n);
      GraphInformationPrioritizer gi(options, {}, {});
      gi.on_graph(graph);
      static_cast<void>(gi.add(candidates));
      std::size_t taken = 0;
      ended = ends_without(n, [&] {
        gi.improve(5, {}, 100);
        taken += gi.take(5).size();
      });
      while (const std::size_t more = gi.take(3).size()) taken += more;
      REQUIRE(taken == 8);
      REQUIRE(gi.size() == 0);
    }
    REQUIRE(n > 50);
  }
}

}  // namespace
}  // namespace loopwise
