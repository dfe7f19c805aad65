// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <new>
#include <set>
#include <stdexcept>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/round_robin_queue.hpp>

#include "testing.hpp"

namespace loopwise::queue_test {
namespace {

std::vector<LoopCandidate> candidates(CandidateId first, std::size_t count) {
  std::vector<LoopCandidate> all(count);
  for (std::size_t i = 0; i < count; ++i) {
    all[i].id = first + i;
    all[i].from = 1000 + first + i;
    all[i].to = first + i;
  }
  return all;
}

std::vector<CandidateId> ids(const std::vector<LoopCandidate>& all) {
  std::vector<CandidateId> out;
  for (const LoopCandidate& c : all) out.push_back(c.id);
  return out;
}

/// Wants the candidates that `keep` selects, highest id first.
class SelectivePrioritizer final : public Prioritizer {
 public:
  SelectivePrioritizer(std::string name, std::function<bool(CandidateId)> keep)
      : name_(std::move(name)), keep_(std::move(keep)) {}
  std::string_view name() const override { return name_; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& all) override {
    std::vector<Refusal> refused;
    for (const LoopCandidate& c : all) {
      if (keep_(c.id)) {
        ranked_.insert(c, static_cast<double>(c.id));
      } else {
        refused.push_back({c.id, "not_for_" + name_});
      }
    }
    return refused;
  }
  void remove(const std::vector<CandidateId>& gone) override { ranked_.erase(gone); }
  std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  std::size_t size() const override { return ranked_.size(); }

 private:
  std::string name_;
  std::function<bool(CandidateId)> keep_;
  RankedCandidates ranked_;
};

template <class... P>
RoundRobinQueue queue_of(std::unique_ptr<P>... prioritizers) {
  std::vector<std::unique_ptr<Prioritizer>> all;
  (all.push_back(std::move(prioritizers)), ...);
  return RoundRobinQueue(std::move(all));
}

std::unique_ptr<SelectivePrioritizer> picky(const std::string& name, std::function<bool(CandidateId)> keep) {
  return std::make_unique<SelectivePrioritizer>(name, std::move(keep));
}

}  // namespace

TEST_CASE("arrival: the order of generation", "[prioritization]") {
  ArrivalPrioritizer arrival;
  REQUIRE(arrival.add(candidates(0, 5)).empty());
  arrival.remove({1, 99});
  REQUIRE(ids(arrival.take(3)) == std::vector<CandidateId>{0, 2, 3});
  REQUIRE(arrival.size() == 1);
  REQUIRE(ids(arrival.take(9)) == std::vector<CandidateId>{4});
  REQUIRE(arrival.take(9).empty());
}

TEST_CASE("random: a seeded order that does not depend on arrival, every pair as likely",
          "[prioritization]") {
  auto all = candidates(0, 200);
  RandomPrioritizer forward(5), backward(5), other(6);
  forward.add(all);
  other.add(all);
  std::reverse(all.begin(), all.end());
  backward.add(all);
  const auto order = ids(forward.take(200));
  REQUIRE(ids(backward.take(200)) == order);
  REQUIRE(ids(other.take(200)) != order);
  REQUIRE(std::set<CandidateId>(order.begin(), order.end()).size() == 200);

  // Over 2000 seeds each of 10 candidates comes first 200 times, five sigmas ± 67.
  std::map<CandidateId, int> first;
  for (std::uint64_t seed = 0; seed < 2000; ++seed) {
    RandomPrioritizer random(seed);
    random.add(candidates(0, 10));
    ++first[random.take(1)[0].id];
  }
  for (const auto& [id, count] : first) REQUIRE(std::abs(count - 200) < 67);
  REQUIRE(first.size() == 10);
}

TEST_CASE("queue: a failing prioritiser does not affect the others", "[prioritization][queue]") {
  struct Counting final : Prioritizer {
    explicit Counting(bool all_fail) : fails(all_fail) {}
    void count() {
      ++calls;
      if (fails) throw std::runtime_error("failed");
    }
    std::string_view name() const override { return "counting"; }
    std::vector<Refusal> add(const std::vector<LoopCandidate>&) override { return {}; }
    void remove(const std::vector<CandidateId>&) override { count(); }
    void on_graph(const PoseGraph&) override { count(); }
    void on_scan(const KeyedScan&) override { count(); }
    void on_result(const RegistrationResult&) override { count(); }
    std::vector<LoopCandidate> take(std::size_t) override { return {}; }
    std::size_t size() const override { return 0; }
    const bool fails;
    int calls = 0;
  };
  auto first = std::make_unique<Counting>(true), second = std::make_unique<Counting>(false);
  const Counting& other = *second;
  RoundRobinQueue queue = queue_of(std::move(first), std::move(second));
  REQUIRE_THROWS_AS(queue.on_graph(PoseGraph()), std::runtime_error);
  REQUIRE_THROWS_AS(queue.on_scan(KeyedScan{}), std::runtime_error);
  REQUIRE_THROWS_AS(queue.on_result(RegistrationResult{}), std::runtime_error);
  REQUIRE_THROWS_AS(queue.remove({1}), std::runtime_error);
  REQUIRE(other.calls == 4);
}

TEST_CASE("queue: improvements count even if another prioritiser fails", "[prioritization][queue]") {
  struct Improving final : Prioritizer {
    explicit Improving(std::function<std::uint64_t()> work) : work_(std::move(work)) {}
    std::string_view name() const override { return "improving"; }
    std::vector<Refusal> add(const std::vector<LoopCandidate>&) override { return {}; }
    void remove(const std::vector<CandidateId>&) override {}
    std::uint64_t improve(std::size_t, const StopToken&, std::uint64_t) override { return work_(); }
    std::vector<LoopCandidate> take(std::size_t) override { return {}; }
    std::size_t size() const override { return 1; }
    std::function<std::uint64_t()> work_;
  };
  bool no_memory = false;
  const auto fail = [&]() -> std::uint64_t {
    if (no_memory) throw std::bad_alloc();
    throw std::runtime_error("failed");
  };
  RoundRobinQueue queue =
      queue_of(std::make_unique<Improving>([] { return 300; }), std::make_unique<Improving>(fail),
               std::make_unique<Improving>([] { return 7; }));
  REQUIRE(queue.add(candidates(0, 9)).empty());
  std::vector<std::uint64_t> used;
  REQUIRE_THROWS_AS(queue.improve(9, {}, {}, used), std::runtime_error);
  REQUIRE(used == std::vector<std::uint64_t>{300, 0, 7});
  no_memory = true;  // is no failure of a prioritiser
  REQUIRE_THROWS_AS(queue.improve(9, {}, {}, used), std::bad_alloc);
}

TEST_CASE("queue: equal shares, best first, nothing twice", "[prioritization][queue]") {
  RoundRobinQueue queue =
      queue_of(std::make_unique<ArrivalPrioritizer>(), picky("high", [](CandidateId) { return true; }));
  REQUIRE(queue.add(candidates(0, 100)).empty());
  REQUIRE(queue.size() == 100);
  // Arrival gives 0, 1, …; "high" gives 99, 98, …; one of each in turn.
  REQUIRE(ids(queue.take(6)) == std::vector<CandidateId>{0, 99, 1, 98, 2, 97});
  REQUIRE(queue.size() == 94);

  std::set<CandidateId> seen{0, 99, 1, 98, 2, 97};
  while (queue.size() > 0) {
    for (const CandidateId id : ids(queue.take(7))) REQUIRE(seen.insert(id).second);
    // Odd batches alternate who gets the extra one.
    REQUIRE(std::max(queue.handed_out()[0], queue.handed_out()[1]) -
                std::min(queue.handed_out()[0], queue.handed_out()[1]) <=
            1);
  }
  REQUIRE(seen.size() == 100);
  REQUIRE(queue.take(5).empty());
}

TEST_CASE("queue: empty prioritisers are skipped, batches stay full", "[prioritization][queue]") {
  RoundRobinQueue queue = queue_of(
      picky("none", [](CandidateId) { return false; }), picky("few", [](CandidateId id) { return id < 3; }),
      picky("all", [](CandidateId) { return true; }), picky("none2", [](CandidateId) { return false; }));
  REQUIRE(queue.add(candidates(0, 50)).empty());
  REQUIRE(queue.take(1).size() == 1);
  REQUIRE(queue.take(2).size() == 2);
  REQUIRE(queue.take(20).size() == 20);
  REQUIRE(queue.take(100).size() == 27);
  REQUIRE(queue.size() == 0);
  REQUIRE(queue.handed_out()[0] == 0);
  REQUIRE(queue.handed_out()[1] == 3);
}

TEST_CASE("queue: pruned means refused by every prioritiser", "[prioritization][queue]") {
  RoundRobinQueue queue = queue_of(picky("even", [](CandidateId id) { return id % 2 == 0; }),
                                   picky("third", [](CandidateId id) { return id % 3 == 0; }));
  const auto refused = queue.add(candidates(0, 12));
  std::vector<CandidateId> pruned;
  for (const Refusal& r : refused) {
    pruned.push_back(r.id);
    REQUIRE(r.reason == "not_for_even;not_for_third");
  }
  REQUIRE(pruned == std::vector<CandidateId>{1, 5, 7, 11});
  REQUIRE(queue.size() == 8);
  queue.remove({0, 1, 3});
  REQUIRE(queue.size() == 6);
  REQUIRE(queue.take(100).size() == 6);
}

TEST_CASE("queue: handing out foreign candidates is an error, and nothing is lost",
          "[prioritization][queue][error]") {
  /// Hands out `extra` besides.
  class Wrong final : public Prioritizer {
   public:
    std::string_view name() const override { return "wrong"; }
    std::vector<Refusal> add(const std::vector<LoopCandidate>&) override { return {}; }
    void remove(const std::vector<CandidateId>&) override {}
    std::vector<LoopCandidate> take(std::size_t count) override {
      std::vector<LoopCandidate> out = extra;
      out.resize(std::min(out.size(), at_most == 0 ? count : at_most));
      return out;
    }
    std::size_t size() const override { return extra.size(); }
    std::vector<LoopCandidate> extra;
    std::size_t at_most = 0;
  };
  auto wrong = std::make_unique<Wrong>();
  Wrong& control = *wrong;
  RoundRobinQueue queue = queue_of(picky("all", [](CandidateId) { return true; }), std::move(wrong));
  REQUIRE(queue.add(candidates(0, 10)).empty());

  control.extra = candidates(77, 1);
  REQUIRE_THROWS_WITH(queue.take(4), "wrong: take(): returned candidate 77, which is not pending");
  control.extra = candidates(3, 1);
  control.extra.push_back(control.extra.front());
  REQUIRE_THROWS_WITH(queue.take(4), "wrong: take(): returned candidate 3, which is not pending");
  control.extra = candidates(0, 5);
  control.at_most = 5;
  REQUIRE_THROWS_WITH(queue.take(4), Contains("which was not requested"));
  REQUIRE(queue.size() == 10);
  REQUIRE(queue.handed_out() == std::vector<std::size_t>{0, 0});

  control.extra.clear();
  std::vector<CandidateId> taken = ids(queue.take(10));
  std::sort(taken.begin(), taken.end());
  REQUIRE(taken == ids(candidates(0, 10)));
}

TEST_CASE("queue: without prioritisers every candidate is refused", "[prioritization][queue]") {
  RoundRobinQueue queue{{}};
  const auto refused = queue.add(candidates(0, 3));
  REQUIRE(refused.size() == 3);
  REQUIRE(refused[0].reason == "no_prioritizer");
  REQUIRE(queue.take(5).empty());
  std::vector<std::unique_ptr<Prioritizer>> with_null(1);
  REQUIRE_THROWS_AS(RoundRobinQueue(std::move(with_null)), InputError);
}

TEST_CASE("ranked candidates: as a sorted set, through random work", "[prioritization][property]") {
  for (const double erasing : {0.0, 0.3, 0.6}) {
    CAPTURE(erasing);
    Rng rng(11);
    RankedCandidates ranked;
    std::set<std::pair<double, CandidateId>> order;  // (-score, id)
    std::map<CandidateId, double> held;
    for (int step = 0; step < 20000; ++step) {
      const CandidateId id = rng.below(3000);
      const double what = rng.uniform();
      if (what < erasing) {
        ranked.erase({id});
        if (held.count(id) != 0) order.erase({-held.at(id), id});
        held.erase(id);
      } else if (what < 0.95) {
        if (held.count(id) != 0) continue;
        LoopCandidate candidate;
        candidate.id = id;
        const double score = static_cast<double>(rng.below(50));  // many are equal
        ranked.insert(candidate, score);
        held[id] = score;
        order.emplace(-score, id);
      } else {
        for (const LoopCandidate& taken : ranked.take(rng.below(20))) {
          REQUIRE(taken.id == order.begin()->second);
          order.erase(order.begin());
          held.erase(taken.id);
        }
      }
      REQUIRE(ranked.size() == held.size());
    }
    for (const LoopCandidate& taken : ranked.take(held.size() + 1)) {
      REQUIRE(taken.id == order.begin()->second);
      order.erase(order.begin());
    }
    REQUIRE(order.empty());
  }
}

}  // namespace loopwise::queue_test
