// SPDX-License-Identifier: BSD-3-Clause
#include <atomic>
#include <cmath>
#include <set>
#include <thread>

#ifdef LOOPWISE_TEST_TBB
#include <tbb/global_control.h>
#endif

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/thread_pool.hpp>

#include "testing.hpp"

namespace loopwise::basics_test {
namespace {

struct SampleOptions {
  double share = 0.5;
  int count = 3;
  RejectionReason reason = RejectionReason::kNone;
  std::vector<double> sigmas{1.0, 2.0};
  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("share", self.share, between(0.0, 1.0), "A share.");
    field("count", self.count, at_least(1), "A count.");
    field("reason", self.reason, any_value(), "A reason.");
    field("sigmas", self.sigmas, above(0.0), "Sigmas.");
  }
};

}  // namespace

TEST_CASE("key: the layout of gtsam::Symbol", "[core][key]") {
  REQUIRE(make_key('a', 0) == 6989586621679009792ULL);
  REQUIRE(make_key('h', 0) == 7493989779944505344ULL);
  REQUIRE(key_character(make_key('c', 12)) == 'c');
  REQUIRE(key_index(make_key('c', 12)) == 12);
  REQUIRE(make_key('\0', 77) == 77);
  REQUIRE(key_name(make_key('b', 3)) == "b3");
  REQUIRE(key_name(3) == "3");
}

TEST_CASE("key: reads numbers above 2^63 and names, refuses the rest", "[core][key][error]") {
  REQUIRE(parse_key("18446744073709551615") == ~Key{0});
  REQUIRE(parse_key("a12") == make_key('a', 12));
  for (const char* bad : {"", "a", "-1", "12x", " 1", "1.5", "18446744073709551616", "a72057594037927936"}) {
    REQUIRE_THROWS_WITH(parse_key(bad), Contains("is not a key"));
  }
}

TEST_CASE("robots: by character and by range", "[core][robots]") {
  const Robots ranges = parse_robots("0-624,spot=625-1249");
  REQUIRE(ranges.size() == 2);
  REQUIRE(ranges[1].name == "spot");
  REQUIRE(ranges.of(624) == 0);
  REQUIRE(ranges.of(625) == 1);
  REQUIRE(ranges.node_index(630) == 5);
  REQUIRE_FALSE(ranges.find(1250));
  REQUIRE_THROWS_AS(ranges.of(1250), UnknownKeyError);

  const Robots letters = Robots::from_keys({make_key('b', 1), make_key('a', 5), make_key('b', 2), 7});
  REQUIRE(letters.size() == 3);
  REQUIRE(letters[0].name == "0");
  REQUIRE(letters[1].name == "a");
  REQUIRE(letters.node_index(make_key('b', 2)) == 2);
  REQUIRE(parse_robots("a,b").of(make_key('b', 9)) == 1);
}

TEST_CASE("robots: overlapping or unreadable ranges are errors", "[core][robots][error]") {
  REQUIRE_THROWS_WITH(Robots({{"x", 0, 5}, {"y", 5, 9}}), "robots \"x\" and \"y\" share keys");
  REQUIRE_THROWS_WITH(Robots({{"x", 0, 5}, {"x", 6, 9}}), "robot \"x\" is listed twice");
  REQUIRE_THROWS_WITH(Robots({{"x", 5, 4}}), Contains("last key is below"));
  for (const char* bad : {"", "5", "1-", "x=", "3-2", "0-5,5-9", "7-8,"}) {
    CAPTURE(bad);
    REQUIRE_THROWS_AS(parse_robots(bad), OptionError);
  }
}

TEST_CASE("options: the error names the field, its value and its bounds", "[core][options][error]") {
  SampleOptions options;
  REQUIRE_NOTHROW(validate(options));
  options.count = 0;
  REQUIRE_THROWS_WITH(validate(options), "count = 0, must be >= 1");
  options = {};
  options.share = std::nan("");
  REQUIRE_THROWS_WITH(validate(options), "share = nan, must be a number");
  options = {};
  options.sigmas[1] = 0.0;
  REQUIRE_THROWS_WITH(validate(options), "sigmas = 0, must be > 0");
  REQUIRE(parse_enum<RejectionReason>("reason", "gicp_fitness") == RejectionReason::kGicpFitness);
  REQUIRE_THROWS_WITH(parse_enum<RejectionReason>("reason", "bad"),
                      Contains("reason = \"bad\", must be one of"));
}

TEST_CASE("random: fixed sequences with the right moments", "[core][random]") {
  Rng rng(42), same(42), other(43);
  REQUIRE(rng() == same());
  REQUIRE(rng() != other());
  double sum = 0.0, squares = 0.0;
  constexpr int n = 200000;
  for (int i = 0; i < n; ++i) {
    const double x = rng.normal();
    sum += x;
    squares += x * x;
  }
  REQUIRE(std::abs(sum / n) < 5.0 / std::sqrt(n));  // five sigmas of the mean
  REQUIRE(squares / n == Approx(1.0).margin(5.0 * std::sqrt(2.0 / n)));
  std::vector<int> histogram(7, 0);
  for (int i = 0; i < 70000; ++i) ++histogram[rng.below(7)];
  for (const int count : histogram) REQUIRE(std::abs(count - 10000) < 500);
  REQUIRE(pair_seed(1, 2, 3) != pair_seed(1, 3, 2));
  REQUIRE(pair_seed(1, 2, 3) != pair_seed(2, 2, 3));
}

TEST_CASE("problems: counted by kind, the first one kept", "[core]") {
  Problems problems;
  problems.add("odd", "f:1");
  problems.add("odd", "f:2", 2);
  problems.add("none", "f:3", 0);
  REQUIRE(problems.count("odd") == 3);
  REQUIRE(problems.all().size() == 1);
  REQUIRE(to_string(problems.all()[0]) == "odd (3 times, first: f:1)");
}

TEST_CASE("problems: those that altered a measurement are refused by strict reading", "[core]") {
  Problems problems, others;
  problems.add("odd", "f:1");
  problems.add_altered("odd", "f:2", 0);
  REQUIRE_NOTHROW(require_unaltered(problems));
  others.add_altered("cut", "f:3", 2);
  problems.add(others);
  problems.add("cut", "f:4");
  REQUIRE(problems.count("cut") == 3);
  REQUIRE_FALSE(problems.all()[0].altered);
  REQUIRE(problems.all()[1].altered);
  REQUIRE_THROWS_AS(require_unaltered(problems), InputError);
  REQUIRE_THROWS_WITH(require_unaltered(problems), Contains("cut (3 times, first: f:3)"));
}

TEST_CASE("thread pool: every index once, the error of the lowest index, resizable", "[core][threads]") {
  ThreadPool pool(1);
  for (const int threads : {1, 2, 5, 3}) {
    pool.resize(threads);
    REQUIRE(pool.num_threads() == threads);
    std::vector<int> calls(1000, 0);
    pool.for_each(calls.size(), [&](std::size_t i) { ++calls[i]; });
    REQUIRE(calls == std::vector<int>(1000, 1));
    pool.for_each(0, [](std::size_t) { FAIL("called for nothing"); });
    std::atomic<int> finished{0};
    try {
      pool.for_each(100, [&](std::size_t i) {
        if (i == 90 || i == 30) throw InputError("at " + std::to_string(i));
        ++finished;
      });
      FAIL("no exception");
    } catch (const InputError& error) {
      REQUIRE(std::string(error.what()) == "at 30");
    }
    REQUIRE(finished == 98);
  }
  REQUIRE_THROWS_AS(pool.resize(-1), OptionError);
}

TEST_CASE("thread pool: as many threads as asked for, more than processors too", "[core][threads]") {
  // Every task waits until all four run: with fewer threads this would never end.
  ThreadPool pool(4);
  std::atomic<int> arrived{0};
  pool.for_each(4, [&](std::size_t) {
    ++arrived;
    while (arrived < 4) std::this_thread::yield();
  });
  REQUIRE(arrived == 4);
}

#ifdef LOOPWISE_TEST_TBB
TEST_CASE("thread pool: the process keeps its setting of TBB", "[core][threads]") {
  const auto allowed = [] {
    return tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
  };
  const std::size_t before = allowed();
  for (const int threads : {1, 2, 7}) {
    ThreadPool pool(threads);
    REQUIRE(allowed() == before);
    std::atomic<int> calls{0}, others{0};
    pool.for_each(20, [&](std::size_t) {
      ++calls;
      if (allowed() != before) ++others;
    });
    REQUIRE(calls == 20);
    REQUIRE(others == 0);
  }
  REQUIRE(allowed() == before);
}
#endif

TEST_CASE("thread pool: several callers share the threads, each waits for its own", "[core][threads]") {
  ThreadPool pool(3);
  constexpr std::size_t kCallers = 4, kCount = 200;
  std::vector<std::vector<int>> calls(kCallers, std::vector<int>(kCount, 0));
  std::vector<int> complete(kCallers, 0);
  std::vector<std::thread> callers;
  for (std::size_t c = 0; c < kCallers; ++c) {
    callers.emplace_back([&, c] {
      for (int round = 1; round <= 20; ++round) {
        pool.for_each(kCount, [&](std::size_t i) { ++calls[c][i]; });
        complete[c] += calls[c] == std::vector<int>(kCount, round) ? 1 : 0;
      }
    });
  }
  for (std::thread& caller : callers) caller.join();
  REQUIRE(complete == std::vector<int>(kCallers, 20));
}

TEST_CASE("clock: virtual time jumps forward only; a stop ends a real wait", "[core][clock]") {
  VirtualClock clock(2.0);
  StopSource stop;
  clock.wait_until(10.0, stop.token());
  REQUIRE(clock.now() == 10.0);
  clock.wait_until(5.0, stop.token());
  REQUIRE(clock.now() == 10.0);

  RealClock real(0.0, 1000.0);
  real.wait_until(5.0, StopToken());
  REQUIRE(real.now() >= 5.0);
  stop.request_stop();
  real.wait_until(1e9, stop.token());  // returns
  REQUIRE_THROWS_AS(RealClock(0.0, 0.0), OptionError);
}

}  // namespace loopwise::basics_test
