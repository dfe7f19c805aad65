// SPDX-License-Identifier: BSD-3-Clause
// What is left where a request for memory finds none. scripts/fault_check does the same to whole commands.
#include <filesystem>
#include <new>
#include <set>
#include <utility>

#include <loopwise/generation/radio.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/pipeline/candidate_pool.hpp>
#include <loopwise/prioritization/baselines.hpp>
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

TEST_CASE("without memory: a graph is as it was, and takes the same later", "[memory][error]") {
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
  // Every call is made again until it has memory. Nodes 57 and 58 wait: they come before the drop is known.
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

/// By arrival, without pairs with one node; those with another it holds back, and gives up late.
class ParticularPrioritizer final : public Prioritizer {
 public:
  ParticularPrioritizer(Key refused, Key held_back) : refused_(refused), held_back_(held_back) {}
  [[nodiscard]] std::string_view name() const override { return "particular"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    std::vector<Refusal> refusals;
    std::vector<LoopCandidate> wanted;
    for (const LoopCandidate& candidate : candidates) {
      if (candidate.to == refused_) {
        refusals.push_back({candidate.id, "a reason that is too long for its place in a string"});
      } else if (candidate.to == held_back_) {
        held_.insert(candidate.id);
      } else {
        wanted.push_back(candidate);
      }
    }
    static_cast<void>(arrival_.add(wanted));
    return refusals;
  }
  void remove(const std::vector<CandidateId>& ids) override {
    for (const CandidateId id : ids) held_.erase(id);
    arrival_.remove(ids);
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return arrival_.take(count); }
  [[nodiscard]] std::vector<Refusal> give_up(double now_s) override {
    std::vector<Refusal> given_up;
    if (now_s < 50.0) return given_up;
    for (const CandidateId id : held_) given_up.push_back({id, "held back"});
    held_.clear();
    return given_up;
  }
  [[nodiscard]] std::size_t size() const override { return arrival_.size() + held_.size(); }

 private:
  Key refused_, held_back_;
  std::set<CandidateId> held_;
  ArrivalPrioritizer arrival_;
};

std::vector<std::unique_ptr<Prioritizer>> some_prioritizers(bool particular) {
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  if (particular) {
    prioritizers.push_back(std::make_unique<ParticularPrioritizer>(1, 4));
    prioritizers.push_back(std::make_unique<ParticularPrioritizer>(2, 4));
    prioritizers.push_back(std::make_unique<ParticularPrioritizer>(3, 4));
  } else {
    prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  }
  return prioritizers;
}

TEST_CASE("without memory: the account of a pool lacks no candidate", "[memory][error]") {
  const bool particular = GENERATE(false, true);
  CandidatePoolOptions options;
  options.max_pending = 7;
  options.max_wait_s = 50.0;
  options.redundant_m = 1.5;
  const PoseGraph graph = straight_path(8, 1.0);
  const auto pair = [](Key from, Key to, double time_s) {
    LoopCandidate candidate;
    candidate.from = from;
    candidate.to = to;
    candidate.time_s = time_s;
    return candidate;
  };
  const auto scan_of = [](Key key) {
    KeyedScan scan;
    scan.key = key;
    return scan;
  };
  long n = 1;
  for (bool ended = false; !ended; ++n) {
    CAPTURE(n);
    CandidatePool pool(options, RoundRobinQueue(some_prioritizers(particular)),
                       Robots::from_keys({0, 1, 2, 3, 4, 5, 6, 7}));
    std::vector<LoopCandidate> batch, one(1);
    RegistrationResult result;
    result.closure = LoopClosure{};
    ended = true;
    const auto attempt = [&](auto&& call) {
      try {
        call();
      } catch (const std::bad_alloc&) {
        ended = false;
      }
    };
    const auto attempt_again = [&](auto&& call) {
      const bool before = std::exchange(ended, true);
      attempt(call);
      if (!ended) call();
      ended = ended && before;
    };
    std::vector<LoopCandidate> first{pair(3, 1, 0.0), pair(3, 2, 0.0), pair(2, 1, 0.0), pair(4, 1, 1.0),
                                     pair(5, 4, 1.0), pair(4, 2, 1.0), pair(7, 6, 1.0)};
    std::vector<LoopCandidate> second{pair(6, 1, 3.0), pair(6, 2, 3.0), pair(6, 3, 4.0), pair(6, 4, 4.0)};
    fuzz::allocations_until_none = n;
    attempt_again([&] { pool.on_graph(graph); });
    for (const Key key : {1, 2, 3}) attempt_again([&] { pool.on_scan(scan_of(key)); });
    attempt_again([&] { pool.add(first); });
    for (const Key key : {4, 5, 6}) attempt_again([&] { pool.on_scan(scan_of(key)); });
    attempt_again([&] { batch = pool.take(4); });
    for (std::size_t i = 0; i < batch.size(); ++i) {
      if (i % 2 == 0) {
        one[0] = batch[i];
        attempt_again([&] { pool.give_back(one); });
        continue;
      }
      result.candidate = batch[i];
      attempt([&] { pool.complete(result); });
    }
    attempt_again([&] { pool.add(second); });
    attempt_again([&] { pool.expire(60.0); });
    attempt_again([&] { batch = pool.take(3); });
    fuzz::allocations_until_none = 0;

    REQUIRE(pool.accounting().balanced());
    REQUIRE(pool.accounting().generated == first.size() + second.size());
    for (const Key key : {1, 2, 3, 4, 5, 6}) pool.on_scan(scan_of(key));
    static_cast<void>(pool.take(0));  // offers what nobody holds, for lack of memory
    pool.expire(61.0);
    pool.expire_waiting();
    REQUIRE(pool.accounting().balanced());
    pool.give_back(batch);  // also of a batch that is done, which changes nothing
    while (!(batch = pool.take(2)).empty()) {
      for (const LoopCandidate& candidate : batch) {
        result.candidate = candidate;
        pool.complete(result);
      }
    }
    REQUIRE(pool.accounting().balanced());
    REQUIRE(pool.accounting().pruned == 0);
    REQUIRE(pool.accounting().pending == 0);
    REQUIRE(pool.accounting().waiting == 0);
    REQUIRE(pool.accounting().in_flight == 0);
  }
  REQUIRE(n > 50);
}

}  // namespace
}  // namespace loopwise
