// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <limits>
#include <map>

#include <loopwise/core/error.hpp>
#include <loopwise/prioritization/observability.hpp>

#include "testing.hpp"

namespace loopwise::observability_priority_test {
namespace {

/// Eigenvalues by key, as if computed from scans.
ObservabilityPrioritizer::Eigenvalue table(std::map<Key, double> values) {
  return [values = std::move(values)](const KeyedScan& scan) { return values.at(scan.key); };
}

KeyedScan scan_of(Key key) {
  KeyedScan scan;
  scan.key = key;
  scan.cloud = std::make_shared<PointCloud>();
  return scan;
}

LoopCandidate candidate(CandidateId id, Key from, Key to) {
  LoopCandidate c;
  c.id = id;
  c.from = from;
  c.to = to;
  return c;
}

const Key a0 = make_key('a', 0), a1 = make_key('a', 1), b0 = make_key('b', 0), b1 = make_key('b', 1);

}  // namespace

TEST_CASE("observability: scores are fixed on arrival by the largest so far",
          "[prioritization][observability]") {
  ObservabilityPrioritizer p({}, parse_robots("a,b"), table({{a0, 2.0}, {a1, 8.0}, {b0, 4.0}, {b1, 0.2}}));
  for (const Key key : {a0, a1, b0, b1}) p.on_scan(scan_of(key));
  REQUIRE(p.score(a0) == 1.0);  // the first
  REQUIRE(p.score(a1) == 1.0);  // the new largest
  REQUIRE(p.score(b0) == 0.5);
  REQUIRE(p.score(b1) == Approx(0.025));
  REQUIRE(p.score(make_key('b', 9)) == 0.0);
}

TEST_CASE("observability: the sum of both scores orders and refuses", "[prioritization][observability]") {
  ObservabilityPriorityOptions options;
  options.min_sum = 0.6;
  ObservabilityPrioritizer p(options, parse_robots("a,b"),
                             table({{a0, 8.0}, {a1, 0.8}, {b0, 4.0}, {b1, 0.1}}));
  for (const Key key : {a0, a1, b0, b1}) p.on_scan(scan_of(key));
  const auto refused =
      p.add({candidate(0, b0, a1), candidate(1, b1, a1), candidate(2, b0, a0), candidate(3, b1, a0)});
  REQUIRE(refused.size() == 1);
  REQUIRE(refused[0].id == 1);
  REQUIRE(refused[0].reason == "low_observability");
  const auto order = p.take(10);
  REQUIRE(order.size() == 3);
  REQUIRE(order[0].id == 2);
  REQUIRE(order[1].id == 3);
  REQUIRE(order[2].id == 0);
}

TEST_CASE("observability: the lamp variant normalises by robot and tests each score",
          "[prioritization][observability]") {
  ObservabilityPriorityOptions options;
  options.variant = ObservabilityVariant::kLamp;
  ObservabilityPrioritizer p(options, parse_robots("a,b"),
                             table({{a0, 0.30}, {a1, 0.03}, {b0, 0.01}, {b1, 0.005}}));
  for (const Key key : {a0, a1, b0, b1}) p.on_scan(scan_of(key));
  REQUIRE(p.score(b0) == 1.0);  // the largest of its own robot
  REQUIRE(p.score(b1) == 0.5);
  REQUIRE(p.score(a1) == Approx(0.1));
  REQUIRE(p.add({candidate(0, b0, a1)}).size() == 1);  // 1.1 in sum, but one end is under 0.2
  REQUIRE(p.add({candidate(1, b1, a0)}).empty());
}

TEST_CASE("observability: scans without structure score 0, never NaN",
          "[prioritization][observability][error]") {
  ObservabilityPrioritizer p({}, parse_robots("a"),
                             table({{a0, 0.0}, {a1, std::numeric_limits<double>::quiet_NaN()}}));
  p.on_scan(scan_of(a0));
  p.on_scan(scan_of(a1));
  REQUIRE(p.score(a0) == 0.0);
  REQUIRE(p.score(a1) == 0.0);
  REQUIRE(p.add({candidate(0, a1, a0)}).size() == 1);

  ObservabilityPriorityOptions options;
  options.min_sum = 3.0;
  REQUIRE_THROWS_WITH(ObservabilityPrioritizer(options, Robots(), table({})),
                      "min_sum = 3, must be in [0, 2]");
  REQUIRE_THROWS_AS(ObservabilityPrioritizer({}, Robots(), nullptr), InputError);
}

}  // namespace loopwise::observability_priority_test
