// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/expected.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robots.hpp>

#include "prioritization/graphs.hpp"
#include "testing.hpp"

namespace loopwise::expected_test {
namespace {

constexpr std::size_t kNodes = 60;  // of each robot, 2 m apart

/// Two robots on parallel streets, `apart_m` from each other; the first has a prior, and a closure ties them.
PoseGraph two_streets(double apart_m = 3.0, bool tied = true) {
  PoseGraph graph;
  for (const char robot : {'a', 'b'}) {
    for (std::size_t i = 0; i < kNodes; ++i) {
      Node node;
      node.key = make_key(robot, i);
      node.pose.translation() << 2.0 * static_cast<double>(i), robot == 'a' ? 0.0 : apart_m, 0.0;
      graph.add_node(node);
      if (i == 0) continue;
      Edge edge;
      edge.from = make_key(robot, i - 1);
      edge.to = node.key;
      edge.kind = EdgeKind::kOdometry;
      edge.T_from_to.translation().x() = 2.0;
      edge.information = 400.0 * Matrix6d::Identity();
      graph.add_edge(edge);
    }
  }
  PriorFactor prior;
  prior.key = make_key('a', 0);
  prior.information = 1e6 * Matrix6d::Identity();
  graph.add_prior(prior);
  if (tied) {
    prior.key = make_key('b', 0);
    prior.pose.translation().y() = apart_m;
    graph.add_prior(prior);
  }
  return graph;
}

/// All pairs of a node of `a` with a node of `b` within `reach` nodes along the street.
std::vector<LoopCandidate> across(std::size_t reach) {
  std::vector<LoopCandidate> all;
  for (std::size_t i = 0; i < kNodes; ++i) {
    for (std::size_t j = 0; j < kNodes; ++j) {
      if (std::max(i, j) - std::min(i, j) > reach) continue;
      all.push_back(testing::candidate_of(all.size(), make_key('b', i), make_key('a', j)));
    }
  }
  return all;
}

ExpectedOptions best_first() {
  ExpectedOptions options;
  options.spread = 0.0;
  return options;
}

RegistrationResult result_of(const LoopCandidate& candidate, bool verified) {
  RegistrationResult result;
  result.candidate = candidate;
  result.reason = verified ? RejectionReason::kNone : RejectionReason::kLowOverlap;
  if (verified) result.closure = LoopClosure{candidate.from, candidate.to};
  return result;
}

std::size_t index_of(Key key) {
  return static_cast<std::size_t>(key_index(key));
}

std::vector<CandidateId> ids(const std::vector<LoopCandidate>& all) {
  std::vector<CandidateId> out;
  for (const LoopCandidate& c : all) out.push_back(c.id);
  return out;
}

}  // namespace

TEST_CASE("expected: the chance decides where all else is equal", "[prioritization][expected]") {
  // Clouds of nodes below 30 look alike, those beyond see nothing of each other.
  const auto signature = [](const KeyedScan& scan) {
    Rng rng(index_of(scan.key) < 30 ? 1 : scan.key);
    const double offset =
        index_of(scan.key) < 30
            ? 0.0
            : 50.0 * static_cast<double>(2 * index_of(scan.key) + (key_character(scan.key) == 'b' ? 1 : 0));
    PointCloud cloud;
    for (int i = 0; i < 500; ++i)
      cloud.points.emplace_back(offset + rng.uniform(-20.0, 20.0), rng.uniform(-20.0, 20.0),
                                rng.uniform(0.0, 3.0));
    return ScanSignature(cloud);
  };
  const PoseGraph graph = two_streets();
  ExpectedPrioritizer likely(
      [] {
        ExpectedOptions options = best_first();
        options.gain_exponent = 0.0;
        return options;
      }(),
      {}, parse_robots("a,b"), signature, 1, "likely");
  REQUIRE(likely.name() == "likely");
  for (const Node& node : graph.nodes()) likely.on_scan({node.key, 0, nullptr});
  REQUIRE(likely.add(across(0)).empty());
  likely.on_graph(graph);
  const auto batch = likely.take(25);
  REQUIRE(batch.size() == 25);
  for (const LoopCandidate& c : batch) REQUIRE(index_of(c.from) < 30);
  REQUIRE(likely.size() == across(0).size() - 25);
}

TEST_CASE("expected: without scans the near come first", "[prioritization][expected]") {
  const PoseGraph graph = two_streets();
  ExpectedOptions options = best_first();
  options.gain_exponent = 0.0;
  ExpectedPrioritizer expected(options, {}, parse_robots("a,b"), {}, 1);
  REQUIRE(expected.add(across(12)).empty());
  expected.on_graph(graph);
  double sum = 0.0;
  for (const LoopCandidate& c : expected.take(40)) {
    sum += (graph.node(c.from).pose.translation() - graph.node(c.to).pose.translation()).norm();
  }
  REQUIRE(sum / 40.0 < 6.0);  // 3 m is the least; the mean of all is 13.6 m
}

TEST_CASE("expected: the gain of one closure is not counted twice", "[prioritization][expected]") {
  // Closures at the first places of the street would gain nothing, those at its end most. Still all places
  // get closures before any place gets many.
  ExpectedPrioritizer expected(best_first(), {}, parse_robots("a,b"), {}, 1);
  REQUIRE(expected.add(across(2)).empty());
  expected.on_graph(two_streets());
  std::map<std::size_t, int> places;
  const auto batch = expected.take(24);
  REQUIRE(batch.size() == 24);
  for (const LoopCandidate& c : batch) ++places[index_of(c.from) / 6];
  REQUIRE(places.size() >= 6);
  for (const auto& [place, count] : places) REQUIRE(count <= 8);
  // The far end is worth more than the beginning, which a prior holds.
  REQUIRE(index_of(batch.front().from) > kNodes / 3);
}

TEST_CASE("expected: where candidates fail, fewer are tried", "[prioritization][expected]") {
  const auto share_of_first_half = [](bool learn) {
    ExpectedOptions options;
    options.use_places = learn;
    options.gain_exponent = 0.0;
    ExpectedPrioritizer expected(options, {}, parse_robots("a,b"), {}, 3);
    REQUIRE(expected.add(across(4)).empty());
    const PoseGraph graph = two_streets();
    std::size_t first_half = 0, all = 0;
    for (int round = 0; round < 10; ++round) {
      expected.on_graph(graph);
      for (const LoopCandidate& c : expected.take(20)) {
        const bool half = index_of(c.from) < kNodes / 2;
        if (round >= 5) {
          ++all;
          first_half += half ? 1 : 0;
        }
        expected.on_result(result_of(c, half));
      }
    }
    return static_cast<double>(first_half) / static_cast<double>(all);
  };
  const double with = share_of_first_half(true), without = share_of_first_half(false);
  REQUIRE(with > without + 0.1);
}

TEST_CASE("expected: closures that robust optimisation leaves out count against their places",
          "[prioritization][expected]") {
  const auto share_of_first_half = [](bool right) {
    ExpectedOptions options;
    options.use_right = right;
    options.gain_exponent = 0.0;
    ExpectedPrioritizer expected(options, {}, parse_robots("a,b"), {}, 3);
    REQUIRE(expected.add(across(4)).empty());
    PoseGraph graph = two_streets();
    std::size_t first_half = 0, all = 0;
    for (int round = 0; round < 10; ++round) {
      expected.on_graph(graph);
      for (const LoopCandidate& c : expected.take(20)) {
        const bool half = index_of(c.from) < kNodes / 2;
        if (round >= 5) {
          ++all;
          first_half += half ? 1 : 0;
        }
        expected.on_result(result_of(c, true));
        Edge edge;
        edge.from = c.from;
        edge.to = c.to;
        edge.T_from_to = graph.node(c.from).pose.inverse() * graph.node(c.to).pose;
        edge.weight = half ? 1.0 : 0.0;
        graph.add_edge(edge);
      }
    }
    return static_cast<double>(first_half) / static_cast<double>(all);
  };
  REQUIRE(share_of_first_half(true) > share_of_first_half(false) + 0.1);
}

TEST_CASE("expected: predictions and results are kept for the calibration", "[prioritization][expected]") {
  ExpectedPrioritizer expected({}, {}, parse_robots("a,b"), {}, 1);
  REQUIRE(expected.add(across(2)).empty());
  expected.on_graph(two_streets());
  for (const LoopCandidate& c : expected.take(50)) expected.on_result(result_of(c, c.id % 2 == 0));
  expected.on_result(
      result_of(testing::candidate_of(9999, make_key('a', 1), make_key('b', 1)), true));  // another's
  std::size_t count = 0;
  for (const Calibration::Bin& bin : expected.calibration()->bins()) count += bin.count;
  REQUIRE(count == 50);
  REQUIRE(expected.calibration()->brier() < 0.6);
  expected.on_graph(two_streets());
  REQUIRE(expected.acceptance().weights() != AcceptanceModel::shipped_verified());
}

TEST_CASE("expected: results of other prioritisers count too", "[prioritization][expected]") {
  const auto share_of_first_half = [](bool use_results) {
    ExpectedOptions options;
    options.gain_exponent = 0.0;
    ExpectedPrioritizer expected(options, {}, parse_robots("a,b"), {}, 3);
    const std::vector<LoopCandidate> all = across(4);
    REQUIRE(expected.add(all).empty());
    expected.on_graph(two_streets());
    std::vector<CandidateId> others;
    for (const LoopCandidate& c : all) {
      if (c.id % 3 == 0) others.push_back(c.id);
    }
    expected.remove(others);
    for (const CandidateId id : others) {
      if (use_results) expected.on_result(result_of(all[id], index_of(all[id].from) < kNodes / 2));
    }
    expected.on_graph(two_streets());
    std::size_t first_half = 0;
    for (const LoopCandidate& c : expected.take(60)) first_half += index_of(c.from) < kNodes / 2 ? 1 : 0;
    return static_cast<double>(first_half) / 60.0;
  };
  REQUIRE(share_of_first_half(true) > share_of_first_half(false) + 0.2);
}

TEST_CASE("expected: a better candidate of the same places makes them more valuable",
          "[prioritization][expected]") {
  ExpectedOptions options = best_first();
  options.gain_exponent = 0.0;
  ExpectedPrioritizer expected(options, {}, parse_robots("a,b"), {}, 1);
  const PoseGraph graph = two_streets();
  // For the first place the pair is far apart, for the last one it is nearer.
  REQUIRE(expected
              .add({testing::candidate_of(0, make_key('b', 0), make_key('a', 5)),
                    testing::candidate_of(1, make_key('b', 58), make_key('a', 55)),
                    testing::candidate_of(2, make_key('b', 59), make_key('a', 55))})
              .empty());
  expected.on_graph(graph);
  REQUIRE(ids(expected.take(1)) == std::vector<CandidateId>{1});
  REQUIRE(expected.add({testing::candidate_of(3, make_key('b', 3), make_key('a', 3))}).empty());
  REQUIRE(ids(expected.take(1)) == std::vector<CandidateId>{3});
}

TEST_CASE("expected: the same calls give the same order, another seed another",
          "[prioritization][expected]") {
  const auto order_of = [](std::uint64_t seed) {
    ExpectedPrioritizer expected({}, {}, parse_robots("a,b"), {}, seed);
    REQUIRE(expected.add(across(5)).empty());
    std::vector<CandidateId> order;
    for (int round = 0; round < 6; ++round) {
      expected.on_graph(two_streets());
      for (const LoopCandidate& c : expected.take(30)) {
        order.push_back(c.id);
        expected.on_result(result_of(c, c.id % 3 == 0));
      }
    }
    return order;
  };
  REQUIRE(order_of(1) == order_of(1));
  REQUIRE(order_of(1) != order_of(2));
}

TEST_CASE("expected: components that only a closure can connect are connected",
          "[prioritization][expected]") {
  const PoseGraph graph = two_streets(3.0, /*tied=*/false);
  ExpectedPrioritizer expected(best_first(), {}, parse_robots("a,b"), {}, 1);
  // Within a street nothing is to be gained that comes near to it.
  std::vector<LoopCandidate> all = across(1);
  for (std::size_t i = 20; i < kNodes; ++i) {
    all.push_back(testing::candidate_of(all.size(), make_key('a', i), make_key('a', i - 15)));
  }
  REQUIRE(expected.add(all).empty());
  expected.on_graph(graph);
  const auto batch = expected.take(10);
  REQUIRE(std::count_if(batch.begin(), batch.end(), [](const LoopCandidate& c) {
            return key_character(c.from) != key_character(c.to);
          }) >= 5);
}

TEST_CASE("expected: candidates wait for their nodes, not for ever", "[prioritization][expected]") {
  ExpectedOptions options;
  options.max_wait_s = 60.0;
  ExpectedPrioritizer expected(options, {}, parse_robots("a,b,c"), {}, 1);
  LoopCandidate late = testing::candidate_of(0, make_key('b', 1), make_key('a', 1));
  LoopCandidate never = testing::candidate_of(1, make_key('c', 1), make_key('a', 1));
  late.time_s = never.time_s = 5.0;
  REQUIRE(expected.add({late, never}).empty());
  REQUIRE(expected.add({testing::candidate_of(2, make_key('a', 1), make_key('a', 1))}).at(0).reason ==
          "same_node");
  REQUIRE(expected.size() == 2);
  REQUIRE(expected.take(5).empty());
  expected.on_graph(two_streets());
  REQUIRE(expected.give_up(50.0).empty());
  REQUIRE(ids(expected.take(5)) == std::vector<CandidateId>{0});
  const auto gone = expected.give_up(70.0);
  REQUIRE(gone.size() == 1);
  REQUIRE(gone[0].id == 1);
  REQUIRE(gone[0].reason == "missing_node");
  REQUIRE(expected.size() == 0);
}

TEST_CASE("expected: a graph that leaves poses open is ordered by the chance alone",
          "[prioritization][expected]") {
  PoseGraph graph = two_streets();
  graph.remove_edges_if([](const Edge& edge) { return index_of(edge.to) % 7 == 3; });
  ExpectedPrioritizer expected({}, {}, parse_robots("a,b"), {}, 1);
  REQUIRE(expected.add(across(2)).empty());
  expected.on_graph(graph);
  std::set<CandidateId> seen;
  while (expected.size() > 0) {
    for (const LoopCandidate& c : expected.take(37)) REQUIRE(seen.insert(c.id).second);
  }
  REQUIRE(seen.size() == across(2).size());
}

TEST_CASE("expected: the account holds through random work", "[prioritization][expected][property]") {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    CAPTURE(seed);
    Rng rng(seed);
    PoseGraph graph = two_streets();
    ExpectedPrioritizer expected({}, {}, parse_robots("a,b"), {}, seed);
    expected.on_graph(graph);
    const std::vector<LoopCandidate> all = across(6);
    std::set<CandidateId> held;
    std::vector<LoopCandidate> in_flight;
    for (int step = 0; step < 300; ++step) {
      const double luck = rng.uniform();
      if (luck < 0.3) {
        std::vector<LoopCandidate> some;
        for (int k = 0; k < 20; ++k) some.push_back(all[rng.below(all.size())]);
        some.erase(std::remove_if(some.begin(), some.end(),
                                  [&](const LoopCandidate& c) {
                                    return std::any_of(in_flight.begin(), in_flight.end(),
                                                       [&](const LoopCandidate& f) { return f.id == c.id; });
                                  }),
                   some.end());
        REQUIRE(expected.add(some).empty());
        for (const LoopCandidate& c : some) held.insert(c.id);
      } else if (luck < 0.4) {
        std::vector<CandidateId> some;
        for (int k = 0; k < 10; ++k) some.push_back(rng.below(all.size()));
        expected.remove(some);
        for (const CandidateId id : some) held.erase(id);
      } else if (luck < 0.7) {
        const std::size_t count = rng.below(15);
        const auto batch = expected.take(count);
        REQUIRE(batch.size() == std::min(count, held.size()));
        for (const LoopCandidate& c : batch) {
          REQUIRE(held.erase(c.id) == 1);
          REQUIRE(c.from == all[c.id].from);
          REQUIRE(c.to == all[c.id].to);
          in_flight.push_back(c);
        }
      } else if (luck < 0.9) {
        for (int k = 0; k < 5 && !in_flight.empty(); ++k) {
          const std::size_t at = rng.below(in_flight.size());
          const LoopCandidate c = in_flight[at];
          in_flight.erase(in_flight.begin() + static_cast<std::ptrdiff_t>(at));
          if (rng.uniform() < 0.2) {  // given back
            REQUIRE(expected.add({c}).empty());
            held.insert(c.id);
          } else {
            expected.on_result(result_of(c, rng.uniform() < 0.5));
          }
        }
      } else {
        for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
          Eigen::Isometry3d pose = graph.nodes()[i].pose;
          pose.translation().y() += rng.normal(0.0, 0.2);
          graph.set_pose(graph.nodes()[i].key, pose);
        }
        expected.on_graph(graph);
      }
      REQUIRE(expected.size() == held.size());
    }
  }
}

}  // namespace loopwise::expected_test
