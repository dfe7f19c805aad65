// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/work.hpp>

#include <array>
#include <atomic>
#include <chrono>
#include <set>
#include <thread>

#include <loopwise/core/error.hpp>

#include "testing.hpp"

namespace loopwise::work_test {
namespace {

using Answer = std::function<std::string(std::string_view)>;

/// Ranks 1, 2, … as threads that serve until they are ended.
class Ranks {
 public:
  explicit Ranks(int size) : transports_(local_transports(size)) {}
  ~Ranks() { join(); }
  void start(int rank, std::string greeting, Answer answer) {
    threads_.emplace_back([this, rank, greeting = std::move(greeting), answer = std::move(answer)] {
      try {
        serve_work(*transports_[static_cast<std::size_t>(rank)], greeting, answer);
      } catch (const std::exception&) {
        ++failed_;
      }
    });
  }
  void join() {
    for (std::thread& thread : threads_) thread.join();
    threads_.clear();
  }
  [[nodiscard]] Transport& of(int rank) { return *transports_[static_cast<std::size_t>(rank)]; }
  [[nodiscard]] int failed() const { return failed_; }

 private:
  std::vector<std::unique_ptr<Transport>> transports_;
  std::vector<std::thread> threads_;
  std::atomic<int> failed_{0};
};

std::string doubled(std::string_view request) {
  return std::to_string(2 * std::stoi(std::string(request)));
}

std::vector<Work> numbers(std::size_t count, std::uint64_t affinities = 7) {
  std::vector<Work> work;
  for (std::size_t i = 0; i < count; ++i) work.push_back({std::to_string(i), i % affinities});
  return work;
}

}  // namespace

TEST_CASE("work: every piece is done once, by any number of ranks and threads", "[distributed]") {
  for (const int size : {1, 2, 4, 8}) {
    for (const int threads : {0, 1, 3}) {
      CAPTURE(size, threads);
      Ranks ranks(size);
      for (int rank = 1; rank < size; ++rank) ranks.start(rank, "hello", doubled);
      std::vector<std::atomic<int>> times(500);
      std::vector<int> answers(500, -1);
      {
        WorkServer server(ranks.of(0), "hello");
        for (int round = 1; round <= 2; ++round) {
          server.run(
              numbers(500), threads,
              [&](std::size_t i) {
                ++times[i];
                answers[i] = 2 * static_cast<int>(i);
              },
              [&](int rank, std::size_t i, std::string_view answer) {
                REQUIRE((rank > 0 && rank < size));
                ++times[i];
                answers[i] = std::stoi(std::string(answer));
              });
          for (std::size_t i = 0; i < times.size(); ++i) {
            REQUIRE(times[i] == round);
            REQUIRE(answers[i] == 2 * static_cast<int>(i));
          }
        }
        std::size_t done = 0;
        for (const std::size_t of_rank : server.statistics().done) done += of_rank;
        REQUIRE(done == 1000);
        REQUIRE(server.statistics().requests == server.statistics().answers);
        server.run(
            {}, threads, [](std::size_t) {}, [](int, std::size_t, std::string_view) {});
      }
      ranks.join();
      REQUIRE(ranks.failed() == 0);
    }
  }
}

TEST_CASE("work: pieces of one affinity stay with their rank while all are busy", "[distributed]") {
  // The threads work in step, like ranks of equal speed. Otherwise the system may give one of them most of
  // the time, and that one takes over the pieces of the other.
  std::array<std::atomic<int>, 2> begun{};
  Ranks ranks(3);
  const auto in_step = [&](std::size_t own) {
    return [&begun, own](std::string_view request) {
      const int before = begun[own]++;
      for (int ms = 0; begun[1 - own] < before && ms < 1000;
           ++ms)  // not for ever: the shares may differ by a few
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      return std::string(request);
    };
  };
  ranks.start(1, "", in_step(0));
  ranks.start(2, "", in_step(1));
  WorkServer server(ranks.of(0), "");
  std::map<std::uint64_t, std::set<int>> seen;
  for (int round = 0; round < 3; ++round) {
    const std::vector<Work> work = numbers(60, 12);
    server.run(
        work, 0, [](std::size_t) {},
        [&](int rank, std::size_t i, std::string_view) { seen[work[i].affinity].insert(rank); });
  }
  std::size_t moved = 0;
  for (const auto& [affinity, by] : seen) moved += by.size() - 1;
  REQUIRE(seen.size() == 12);
  REQUIRE(moved <= 4);  // pieces taken over at the end of a round by ranks without work
}

TEST_CASE("work: a rank that disagrees, fails to begin or stays silent is named", "[distributed][error]") {
  SECTION("another version") {
    Ranks ranks(3);
    ranks.start(1, "replay 1", doubled);
    ranks.start(2, "replay 2", doubled);
    REQUIRE_THROWS_WITH(WorkServer(ranks.of(0), "replay 1"), Contains("rank 2 differs from rank 0"));
    ranks.join();
  }
  SECTION("no mission there") {
    Ranks ranks(3);
    ranks.start(1, "replay 1", doubled);
    report_failure(ranks.of(2), "missions/tunnel: No such file or directory");
    REQUIRE_THROWS_WITH(WorkServer(ranks.of(0), "replay 1"),
                        "rank 2: missions/tunnel: No such file or directory");
    ranks.join();
  }
  SECTION("silence") {
    Ranks ranks(2);
    WorkOptions options;
    options.start_limit_s = 0.05;
    REQUIRE_THROWS_WITH(WorkServer(ranks.of(0), "", options), Contains("rank 1 has not answered"));
  }
}

TEST_CASE("work: a failure ends the round with its reason, without a deadlock", "[distributed][error]") {
  const auto nothing = [](int, std::size_t, std::string_view) {};
  SECTION("elsewhere") {
    Ranks ranks(3);
    ranks.start(1, "", doubled);
    ranks.start(2, "", [calls = 0](std::string_view request) mutable -> std::string {
      if (++calls == 13) throw InputError("the thirteenth");
      return doubled(request);
    });
    {
      WorkServer server(ranks.of(0), "");
      // The number of pieces of rank 2 depends on timing, but it gets some in each round.
      REQUIRE_THROWS_WITH(
          [&] {
            for (int round = 0; round < 100; ++round)
              server.run(
                  numbers(100, 100), 0, [](std::size_t) {}, nothing);
          }(),
          "rank 2: the thirteenth");
    }
    ranks.join();
    REQUIRE(ranks.failed() == 1);
  }
  SECTION("here") {
    Ranks ranks(2);
    ranks.start(1, "", doubled);
    WorkServer server(ranks.of(0), "");
    REQUIRE_THROWS_WITH(server.run(
                            numbers(100), 2,
                            [](std::size_t i) {
                              if (i % 3 == 0) throw InputError("here");
                            },
                            nothing),
                        "here");
  }
  SECTION("an answer that cannot be used") {
    Ranks ranks(2);
    ranks.start(1, "", doubled);
    WorkServer server(ranks.of(0), "");
    REQUIRE_THROWS_WITH(server.run(
                            numbers(10), 0, [](std::size_t) {},
                            [](int, std::size_t, std::string_view) { throw InputError("disk full"); }),
                        "disk full");
  }
  SECTION("a rank that hangs") {
    Ranks ranks(2);
    std::atomic<bool> wake{false};
    ranks.start(1, "", [&](std::string_view) {
      while (!wake) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      return std::string();
    });
    {
      WorkOptions options;
      options.time_limit_s = 0.05;
      WorkServer server(ranks.of(0), "", options);
      REQUIRE_THROWS_WITH(server.run(
                              numbers(5), 0, [](std::size_t) {}, nothing),
                          Contains("rank 1 has 2 unanswered requests"));
      wake = true;
    }
    ranks.join();
  }
}

TEST_CASE("work: a stop request ends it soon; pieces in progress are finished", "[distributed]") {
  Ranks ranks(3);
  for (int rank : {1, 2}) ranks.start(rank, "", doubled);
  const WorkOptions options;
  WorkServer server(ranks.of(0), "", options);
  StopSource stop;
  std::size_t here = 0, there = 0;
  server.run(
      numbers(100000, 1000), 1,
      [&](std::size_t) {  // one piece as long as it takes, or the work could be done before the others answer
        ++here;
        while (!stop.token().stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      },
      [&](int, std::size_t, std::string_view) {
        if (++there == 50) stop.request_stop();
      },
      stop.token());
  REQUIRE(here <= 1);
  REQUIRE(there >= 50);
  REQUIRE(there <= 50 + 2 * static_cast<std::size_t>(options.ahead));
  REQUIRE(server.statistics().requests == there);
  REQUIRE(server.statistics().answers == there);
}

}  // namespace loopwise::work_test
