// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Independent pieces of work spread over ranks: rank 0 serves the others from a thread while it computes as
/// well.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/distributed/transport.hpp>

namespace loopwise {

/// A piece of work, as the rank that does it understands it.
struct Work {
  std::string request;  ///< What is sent.
  /// Pieces of one affinity go to one rank as far as that keeps all busy: they share what it has in memory.
  std::uint64_t affinity = 0;
};

/// How long rank 0 waits for the others, and what it gives them ahead.
struct WorkOptions {
  double time_limit_s = 600.0;
  double start_limit_s = 120.0;
  std::int64_t ahead = 2;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("time_limit_s", self.time_limit_s, above(0.0),
          "A rank that owes answers and has sent none for this long is taken for dead, s.");
    field("start_limit_s", self.start_limit_s, above(0.0), "The same for its first word, s.");
    field("ahead", self.ahead, at_least(1), "Pieces that a rank is given ahead, so that it never waits.");
  }
};

/// What has gone to and fro since the start.
struct WorkStatistics {
  std::vector<std::size_t> done;  ///< Pieces by rank.
  std::size_t requests = 0;       ///< Sent.
  std::size_t request_bytes = 0;  ///< Of all of them, numbers included.
  std::size_t answers = 0;        ///< Received.
  std::size_t answer_bytes = 0;   ///< Of all of them, numbers included.
};

/// Rank 0. Ends the other ranks' serving when it goes.
class LOOPWISE_EXPORT WorkServer {
 public:
  /// Waits for the first word of every rank, which must be `greeting` (what all must agree on: version,
  /// inputs). \throws OptionError; Error naming the rank that says something else, reports a failure or stays
  /// silent
  WorkServer(Transport& transport, std::string_view greeting, const WorkOptions& options = {});
  ~WorkServer();
  WorkServer(const WorkServer&) = delete;
  WorkServer& operator=(const WorkServer&) = delete;

  /// Does all of the work, here by `here(i)` on `local_workers` threads (0: all goes to the others, if there
  /// are any) and elsewhere by messages, whose answers `there(rank, i, answer)` takes. Both are called from
  /// several threads, `there` by one at a time. After a stop request nothing more is begun; what was begun is
  /// finished. Who does what depends on timing. \throws what `here` or `there` throws; Error naming a rank
  /// that reports a failure or stays silent for too long. What had been begun elsewhere is then not waited
  /// for.
  void run(const std::vector<Work>& work, int local_workers, const std::function<void(std::size_t)>& here,
           const std::function<void(int, std::size_t, std::string_view)>& there, const StopToken& stop = {});

  /// Since the start, over all calls of run().
  [[nodiscard]] const WorkStatistics& statistics() const { return statistics_; }

 private:
  class Round;

  Transport& transport_;
  WorkOptions options_;
  std::map<std::uint64_t, int> owner_;  ///< Rank that had an affinity last.
  WorkStatistics statistics_;
};

/// Every other rank: says `greeting`, then answers requests until rank 0 ends it. What `answer` throws is
/// reported to rank 0 as this rank's failure, and thrown on.
LOOPWISE_EXPORT void serve_work(Transport& transport, std::string_view greeting,
                                const std::function<std::string(std::string_view request)>& answer);

/// Tells rank 0 why this rank cannot take part. Nobody need have greeted.
LOOPWISE_EXPORT void report_failure(Transport& transport, std::string_view why);

}  // namespace loopwise
