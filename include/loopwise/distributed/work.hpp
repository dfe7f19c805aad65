// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Distribution of independent pieces of work over ranks: rank 0 serves the others from a thread and computes
/// as well.
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

/// A piece of work in the format of the computing rank.
struct Work {
  std::string request;  ///< Contents of the message.
  /// Pieces of one affinity share data in memory and go to one rank as long as all ranks stay busy.
  std::uint64_t affinity = 0;
};

/// Time limit for the other ranks, and number of pieces handed out in advance.
struct WorkOptions {
  /// A rank counts as failed if it has unfinished pieces and sends no result for longer than this, s.
  double time_limit_s = 600.0;
  /// A rank counts as failed if it sends no first message within this time, s.
  double start_limit_s = 120.0;
  /// Number of pieces that a rank gets in advance, so that it never waits.
  std::int64_t ahead = 2;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("time_limit_s", self.time_limit_s, above(0.0));
    field("start_limit_s", self.start_limit_s, above(0.0));
    field("ahead", self.ahead, at_least(1));
  }
};

/// Statistics of messages since the start.
struct WorkStatistics {
  std::vector<std::size_t> done;  ///< Pieces by rank.
  std::size_t requests = 0;       ///< Sent.
  std::size_t request_bytes = 0;  ///< Of all of them, numbers included.
  std::size_t answers = 0;        ///< Received.
  std::size_t answer_bytes = 0;   ///< Of all of them, numbers included.
};

/// Rank 0. Its destructor ends the service of the other ranks.
class LOOPWISE_EXPORT WorkServer {
 public:
  /// Waits for the first message of every rank, which must be `greeting` (the common version and input).
  /// \throws OptionError; Error naming a rank that sends another greeting, reports a failure or does not
  /// answer
  WorkServer(Transport& transport, std::string_view greeting, const WorkOptions& options = {});
  ~WorkServer();
  WorkServer(const WorkServer&) = delete;
  WorkServer& operator=(const WorkServer&) = delete;

  /// Does all of the work, locally by `here(i)` on `local_workers` threads (0: all goes to the other ranks,
  /// if they exist) and on other ranks by messages, whose answers go to `there(rank, i, answer)`. Both are
  /// called from several threads, `there` by one at a time. After a stop request no further piece starts;
  /// running pieces complete. The assignment depends on timing. \throws exceptions of `here` or `there`;
  /// Error naming a rank that reports a failure or does not answer in time. Pieces on other ranks are then
  /// abandoned.
  void run(const std::vector<Work>& work, int local_workers, const std::function<void(std::size_t)>& here,
           const std::function<void(int, std::size_t, std::string_view)>& there, const StopToken& stop = {});

  /// Statistics since the start, over all calls of run().
  [[nodiscard]] const WorkStatistics& statistics() const { return statistics_; }

 private:
  class Round;

  Transport& transport_;
  WorkOptions options_;
  std::map<std::uint64_t, int> owner_;  ///< Rank that had an affinity last.
  WorkStatistics statistics_;
};

/// Service of every other rank: sends `greeting`, then answers requests until rank 0 ends it. Exceptions of
/// `answer` are reported to rank 0 as this rank's failure, and rethrown.
LOOPWISE_EXPORT void serve_work(Transport& transport, std::string_view greeting,
                                const std::function<std::string(std::string_view request)>& answer);

/// Reports to rank 0 why this rank cannot take part. May be called before the greeting.
LOOPWISE_EXPORT void report_failure(Transport& transport, std::string_view why);

}  // namespace loopwise
