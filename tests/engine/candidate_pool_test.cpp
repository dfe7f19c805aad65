// SPDX-License-Identifier: BSD-3-Clause
#include <map>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/prioritization/baselines.hpp>

#include "testing.hpp"

namespace loopwise::candidate_pool_test {
namespace {

CandidatePool arrival_pool(const CandidatePoolOptions& options = {}) {
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  return CandidatePool(options, RoundRobinQueue(std::move(prioritizers)));
}

KeyedScan scan_of(Key key) {
  KeyedScan scan;
  scan.key = key;
  scan.cloud = std::make_shared<PointCloud>();
  return scan;
}

LoopCandidate pair(Key from, Key to, double time_s = 0.0) {
  LoopCandidate c;
  c.from = from;
  c.to = to;
  c.time_s = time_s;
  return c;
}

RegistrationResult result_of(const LoopCandidate& candidate) {
  RegistrationResult result;
  result.candidate = candidate;
  result.reason = RejectionReason::kFewMatches;
  return result;
}

}  // namespace

TEST_CASE("pool: a pair counts once, in either direction and from any proposer", "[engine][pool]") {
  CandidatePool pool = arrival_pool();
  for (const Key key : {1, 2, 3}) pool.on_scan(scan_of(key));
  REQUIRE(pool.add({pair(3, 1), pair(1, 3), pair(3, 2), pair(3, 1)}) == 2);
  REQUIRE(pool.add({pair(2, 3)}) == 0);
  const auto batch = pool.take(10);
  REQUIRE(batch.size() == 2);
  for (const LoopCandidate& c : batch) pool.complete(result_of(c));
  REQUIRE(pool.add({pair(1, 3)}) == 0);  // also after it was computed
  REQUIRE(pool.accounting().generated == 2);
  REQUIRE(pool.accounting().computed == 2);
  REQUIRE(pool.accounting().balanced());
  REQUIRE_THROWS_AS(pool.complete(result_of(batch[0])), InputError);
}

TEST_CASE("pool: a recognition is added to a pair that already exists", "[engine][pool]") {
  CandidatePool pool = arrival_pool();
  for (const Key key : {1, 2, 3}) pool.on_scan(scan_of(key));
  pool.add({pair(3, 1), pair(3, 2), pair(4, 1)});
  const auto recognised = [](Key from, Key to, double x) {
    LoopCandidate candidate = pair(from, to);
    auto recognition = std::make_shared<Recognition>();
    recognition->T_from_to = Eigen::Translation3d(x, 0.0, 0.0) * Eigen::Isometry3d::Identity();
    candidate.recognition = recognition;
    return candidate;
  };
  // With exchanged ends, for a candidate that waits for a scan, and a second time: the first recognition
  // counts.
  REQUIRE(pool.add({recognised(1, 3, 5.0), recognised(4, 1, 7.0), recognised(3, 1, 9.0)}) == 0);
  pool.on_scan(scan_of(4));
  std::map<Key, LoopCandidate> taken;
  for (const LoopCandidate& c : pool.take(10)) taken[10 * c.from + c.to] = c;
  REQUIRE(taken.size() == 3);
  REQUIRE(taken.at(31).recognition->T_from_to->translation().x() == -5.0);
  REQUIRE(taken.at(41).recognition->T_from_to->translation().x() == 7.0);
  REQUIRE(taken.at(32).recognition == nullptr);
  REQUIRE(pool.add({recognised(3, 2, 1.0)}) == 0);  // handed out: too late
  REQUIRE(pool.accounting().generated == 3);
  REQUIRE(pool.accounting().balanced());
}

TEST_CASE("pool: candidates wait for both scans", "[engine][pool]") {
  CandidatePool pool = arrival_pool();
  pool.add({pair(3, 1), pair(3, 2), pair(2, 1)});
  REQUIRE(pool.accounting().waiting == 3);
  pool.on_scan(scan_of(1));
  REQUIRE(pool.accounting().pending == 0);
  pool.on_scan(scan_of(3));
  pool.on_scan(scan_of(3));  // again: no effect
  REQUIRE(pool.accounting().pending == 1);
  REQUIRE(pool.accounting().waiting == 2);
  REQUIRE(pool.take(5).size() == 1);
  pool.expire_waiting();
  REQUIRE(pool.accounting().expired == 2);
  REQUIRE(pool.expired_reasons().at("missing_scan") == 2);
  pool.on_scan(scan_of(2));  // too late, and harmless
  REQUIRE(pool.accounting().pending == 0);
  REQUIRE(pool.accounting().balanced());
}

TEST_CASE("pool: age, waiting time and the cap expire candidates with a reason", "[engine][pool]") {
  CandidatePoolOptions options;
  options.max_age_s = 100.0;
  options.max_wait_s = 50.0;
  options.max_pending = 3;
  CandidatePool pool = arrival_pool(options);
  for (const Key key : {1, 2, 3, 4, 5, 6}) pool.on_scan(scan_of(key));
  pool.add({pair(2, 1, 0.0), pair(3, 1, 10.0), pair(4, 1, 20.0), pair(5, 1, 30.0), pair(6, 1, 40.0),
            pair(9, 1, 40.0)});
  pool.expire(60.0);
  REQUIRE(pool.expired_reasons().at("pool_full") == 2);
  REQUIRE(pool.accounting().waiting == 1);
  pool.expire(95.0);
  REQUIRE(pool.expired_reasons().at("missing_scan") == 1);
  pool.expire(125.0);
  REQUIRE(pool.expired_reasons().at("too_old") == 1);  // the one of 20 s; 30 and 40 stay
  REQUIRE(pool.accounting().pending == 2);
  REQUIRE(pool.take(9).size() == 2);
  REQUIRE(pool.accounting().balanced());
  options.max_age_s = -1.0;
  REQUIRE_THROWS_WITH(arrival_pool(options), "max_age_s = -1, must be >= 0");
}

TEST_CASE("pool: a prioritiser that throws loses no candidate, and no candidate stays pending for ever",
          "[engine][pool][error]") {
  /// Like arrival, except for one function that throws on request.
  class ThrowingPrioritizer final : public Prioritizer {
   public:
    std::string_view name() const override { return "throwing"; }
    std::vector<Refusal> add(const std::vector<LoopCandidate>& c) override {
      const std::vector<Refusal> refused = inner_.add(c);
      if (throws_in_add) throw Error("add");
      return refused;
    }
    void remove(const std::vector<CandidateId>& ids) override {
      inner_.remove(ids);
      if (throws_in_remove) throw Error("remove");
    }
    std::vector<LoopCandidate> take(std::size_t count) override {
      if (throws_in_take) throw Error("take");
      std::vector<LoopCandidate> taken = inner_.take(count);
      for (LoopCandidate& c : taken) c.from = 99;  // has no effect
      return taken;
    }
    std::size_t size() const override { return inner_.size(); }
    bool throws_in_add = false, throws_in_remove = false, throws_in_take = false;

   private:
    ArrivalPrioritizer inner_;
  };
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  auto throwing = std::make_unique<ThrowingPrioritizer>();
  ThrowingPrioritizer& control = *throwing;
  prioritizers.push_back(std::move(throwing));
  CandidatePool pool({}, RoundRobinQueue(std::move(prioritizers)));
  for (Key key = 1; key <= 9; ++key) pool.on_scan(scan_of(key));

  pool.add({pair(5, 1), pair(5, 2), pair(5, 3)});
  control.throws_in_add = control.throws_in_remove = true;
  REQUIRE_THROWS_WITH(pool.add({pair(6, 1), pair(6, 2)}), "throwing: add(): add");
  control.throws_in_add = control.throws_in_remove = false;
  REQUIRE(pool.accounting().balanced());
  REQUIRE(pool.accounting().pending == 3);
  REQUIRE(pool.pruned_reasons().at("prioritizer_failed") == 2);

  control.throws_in_take = true;
  REQUIRE_THROWS_WITH(pool.take(3), "throwing: take(): take");
  control.throws_in_take = false;
  REQUIRE(pool.accounting().pending == 3);
  REQUIRE(pool.accounting().in_flight == 0);
  const auto batch = pool.take(9);
  REQUIRE(batch.size() == 3);
  for (const LoopCandidate& candidate : batch) {
    REQUIRE(candidate.from == 5);
    pool.complete(result_of(candidate));
  }
  REQUIRE(pool.accounting().computed == 3);
  REQUIRE(pool.accounting().balanced());
}

TEST_CASE("pool: candidates that are given back are pending again", "[engine][pool]") {
  CandidatePool pool = arrival_pool();
  for (const Key key : {1, 2, 3}) pool.on_scan(scan_of(key));
  pool.add({pair(2, 1), pair(3, 1), pair(3, 2)});
  const auto batch = pool.take(2);
  pool.complete(result_of(batch[0]));
  pool.give_back(batch);  // the computed one is not in flight any more
  REQUIRE(pool.accounting().pending == 2);
  REQUIRE(pool.accounting().in_flight == 0);
  REQUIRE(pool.accounting().balanced());
  REQUIRE(pool.take(2)[0].id == batch[1].id);
}

TEST_CASE("pool: the account balances through random work", "[engine][pool][property]") {
  for (const std::uint64_t seed : {1, 2, 3, 4, 5}) {
    CAPTURE(seed);
    Rng rng(seed);
    CandidatePoolOptions options;
    options.max_age_s = 30.0;
    options.max_wait_s = 20.0;
    options.max_pending = 40;
    CandidatePool pool = arrival_pool(options);
    std::vector<LoopCandidate> flying;
    for (int step = 0; step < 2000; ++step) {
      const double now = 0.1 * step;
      switch (rng.below(5)) {
        case 0:
          pool.on_scan(scan_of(rng.below(60)));
          break;
        case 1: {
          std::vector<LoopCandidate> some;
          for (int i = 0; i < 5; ++i) {
            const Key a = rng.below(60), b = rng.below(60);
            if (a != b) some.push_back(pair(a, b, now));
          }
          pool.add(some);
          break;
        }
        case 2:
          for (const LoopCandidate& c : pool.take(rng.below(4))) flying.push_back(c);
          break;
        case 3:
          if (!flying.empty()) {
            pool.complete(result_of(flying.back()));
            flying.pop_back();
          }
          break;
        default:
          if (rng.below(10) == 0) {
            pool.give_back(flying);
            flying.clear();
          }
          pool.expire(now);
      }
      REQUIRE(pool.accounting().balanced());
      REQUIRE(pool.accounting().in_flight == flying.size());
      REQUIRE(pool.queue().size() == pool.accounting().pending);
    }
    REQUIRE(pool.accounting().computed > 50);
    REQUIRE(pool.accounting().expired > 50);
  }
}

TEST_CASE("pool: candidates near a verified closure come last", "[engine][pool]") {
  const Robots robots = parse_robots("0-9,10-19,20-29");
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  CandidatePoolOptions options;
  options.redundant_m = 3.0;
  REQUIRE_THROWS_AS(arrival_pool(options), OptionError);  // which robots?
  CandidatePool pool(options, RoundRobinQueue(std::move(prioritizers)), robots);

  // Each robot drives along x, a node every 2 m, 1 m beside the last one.
  PoseGraph graph;
  for (Key key = 0; key < 30; ++key) {
    Node node;
    node.key = key;
    const Key row = key / 10;
    node.pose.translation() << 2.0 * static_cast<double>(key % 10), static_cast<double>(row), 0.0;
    graph.add_node(node);
    pool.on_scan(scan_of(key));
  }
  pool.on_graph(graph);
  pool.add({pair(15, 5)});
  RegistrationResult closed = result_of(pool.take(1).at(0));
  closed.reason = RejectionReason::kNone;
  closed.closure = LoopClosure();
  closed.closure->from = 15;
  closed.closure->to = 5;
  pool.complete(closed);
  pool.closure_added(15, 5);

  // Redundant: both ends within 3 m, also with exchanged ends. Not redundant: one end far away, or another
  // robot.
  pool.add({pair(16, 4), pair(6, 14), pair(17, 5), pair(25, 5), pair(19, 9)});
  std::vector<std::pair<Key, Key>> order;
  for (const std::size_t count : {2U, 3U}) {
    const auto batch = pool.take(count);
    REQUIRE(batch.size() == count);
    for (const LoopCandidate& c : batch) order.emplace_back(c.from, c.to);
    REQUIRE(pool.accounting().balanced());
  }
  REQUIRE(order == std::vector<std::pair<Key, Key>>{{17, 5}, {25, 5}, {19, 9}, {16, 4}, {6, 14}});

  // Once the closure has been taken out, nothing lies near one.
  pool.closure_removed(5, 15);
  pool.add({pair(16, 5), pair(25, 6)});
  const auto batch = pool.take(2);
  REQUIRE(batch.at(0).from == 16);
  REQUIRE(batch.at(1).from == 25);
}

TEST_CASE("pool: a candidate put last expires like any other", "[engine][pool]") {
  CandidatePoolOptions options;
  options.redundant_m = 100.0;
  options.max_age_s = 10.0;
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  CandidatePool pool(options, RoundRobinQueue(std::move(prioritizers)), parse_robots("0-9"));
  PoseGraph graph;
  for (Key key = 0; key < 6; ++key) {
    Node node;
    node.key = key;
    graph.add_node(node);
    pool.on_scan(scan_of(key));
  }
  pool.on_graph(graph);
  pool.add({pair(1, 0)});
  RegistrationResult closed = result_of(pool.take(1).at(0));
  closed.reason = RejectionReason::kNone;
  closed.closure = LoopClosure();
  pool.complete(closed);
  pool.add({pair(2, 0, 1.0), pair(3, 0, 8.0), pair(4, 0, 8.0)});
  REQUIRE(pool.oldest_pending_s() == 1.0);
  REQUIRE(pool.take(1).at(0).from == 2);  // all are redundant: in their order
  pool.expire(19.0);
  REQUIRE(pool.accounting().expired == 2);
  REQUIRE(pool.take(5).empty());
  REQUIRE(pool.accounting().balanced());
}

}  // namespace loopwise::candidate_pool_test
