// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/work.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <deque>
#include <exception>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>

#include "tags.hpp"

namespace loopwise {
namespace {

using detail::kAnswer;
using detail::kEnd;
using detail::kFailure;
using detail::kGreeting;
using detail::kRequest;

/// Sleeps between polls for messages, at first briefly, then longer. A waiting thread must leave its
/// processor to the computing threads, and MPI's blocking calls do not.
class PollBackoff {
 public:
  void reset() { next_ = kShortest; }
  void wait() {
    std::this_thread::sleep_for(next_);
    next_ = std::min(next_ * 2, kLongest);
  }

 private:
  using Time = std::chrono::microseconds;
  static constexpr Time kShortest{20}, kLongest{1000};
  Time next_ = kShortest;
};

std::string with_number(std::size_t number, std::string_view bytes) {
  const auto n = static_cast<std::uint64_t>(number);
  std::string out(sizeof n, '\0');
  std::memcpy(out.data(), &n, sizeof n);
  out += bytes;
  return out;
}

std::size_t read_number(std::string_view& bytes, int from) {
  std::uint64_t n = 0;
  if (bytes.size() < sizeof n) throw Error("rank " + std::to_string(from) + ": a message was cut short");
  std::memcpy(&n, bytes.data(), sizeof n);
  bytes.remove_prefix(sizeof n);
  return static_cast<std::size_t>(n);
}

/// Unlike std::to_string(), prints no trailing zeros.
std::string seconds_text(double seconds) {
  char text[32];
  std::snprintf(text, sizeof text, "%g s", seconds);
  return text;
}

[[noreturn]] void throw_failure(const Message& message) {
  throw Error("rank " + std::to_string(message.from) + ": " + message.bytes);
}

}  // namespace

/// One call of run(): assigns the pieces of work to ranks.
class WorkServer::Round {
 public:
  Round(WorkServer& server, const std::vector<Work>& work, bool here)
      : server_(server), work_(work), queues_(static_cast<std::size_t>(server.transport_.size())) {
    // Affinities in order of first appearance: each goes to the rank that last had it, a new one to the
    // shortest queue.
    std::map<std::uint64_t, std::vector<std::size_t>> groups;
    std::vector<std::uint64_t> order;
    for (std::size_t i = 0; i < work.size(); ++i) {
      const auto [group, fresh] = groups.try_emplace(work[i].affinity);
      if (fresh) order.push_back(work[i].affinity);
      group->second.push_back(i);
    }
    const std::size_t first = here || queues_.size() == 1 ? 0 : 1;
    const std::size_t fair = (work.size() + queues_.size() - first - 1) / (queues_.size() - first);
    for (const std::uint64_t affinity : order) {
      const std::vector<std::size_t>& pieces = groups.at(affinity);
      const auto owner = server.owner_.find(affinity);
      auto rank = owner == server.owner_.end() ? queues_.size() : static_cast<std::size_t>(owner->second);
      if (rank < first || rank >= queues_.size() || queues_[rank].size() + pieces.size() > 2 * fair) {
        rank = first;
        for (std::size_t r = first + 1; r < queues_.size(); ++r) {
          if (queues_[r].size() < queues_[rank].size()) rank = r;
        }
      }
      queues_[rank].insert(queues_[rank].end(), pieces.begin(), pieces.end());
    }
    left_ = work.size();
  }

  /// The next piece for a rank: the first of its own queue, or else the last of the longest queue.
  std::optional<std::size_t> next(int rank) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (left_ == 0 || closed_) return std::nullopt;
    auto* queue = &queues_[static_cast<std::size_t>(rank)];
    const bool own = !queue->empty();
    if (!own) {
      queue = &*std::max_element(queues_.begin(), queues_.end(),
                                 [](const auto& a, const auto& b) { return a.size() < b.size(); });
    }
    const std::size_t i = own ? queue->front() : queue->back();
    own ? queue->pop_front() : queue->pop_back();
    server_.owner_[work_[i].affinity] = rank;
    --left_;
    return i;
  }

  /// No more pieces are begun after this.
  void close() {
    const std::lock_guard<std::mutex> lock(mutex_);
    closed_ = true;
  }
  [[nodiscard]] bool exhausted() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return left_ == 0 || closed_;
  }

 private:
  WorkServer& server_;
  const std::vector<Work>& work_;
  std::mutex mutex_;
  std::vector<std::deque<std::size_t>> queues_;  // by rank
  std::size_t left_ = 0;
  bool closed_ = false;
};

WorkServer::WorkServer(Transport& transport, std::string_view greeting, const WorkOptions& options)
    : transport_(transport), options_(options) {
  validate(options_);
  const auto ranks = static_cast<std::size_t>(transport.size());
  statistics_.done.assign(ranks, 0);
  std::set<int> silent;
  for (int rank = 1; rank < transport.size(); ++rank) silent.insert(rank);
  const Stopwatch watch;
  PollBackoff backoff;
  std::exception_ptr failure;
  while (!silent.empty()) {
    const std::optional<Message> message = transport_.receive();
    if (!message) {
      if (watch.seconds() > options_.start_limit_s) {
        throw Error("rank " + std::to_string(*silent.begin()) + " has not answered within " +
                    seconds_text(options_.start_limit_s));
      }
      backoff.wait();
      continue;
    }
    backoff.reset();
    silent.erase(message->from);
    if (failure) continue;  // all ranks are heard first: each that has sent a message waits for kEnd
    try {
      if (message->tag == kFailure) throw_failure(*message);
      if (message->tag != kGreeting || message->bytes != greeting) {
        throw Error("rank " + std::to_string(message->from) +
                    " differs from rank 0: another version of the program, other options or another mission");
      }
    } catch (const Error&) {
      failure = std::current_exception();
    }
  }
  if (!failure) return;
  for (int rank = 1; rank < transport.size(); ++rank) transport_.send(rank, kEnd, {});
  std::rethrow_exception(failure);
}

WorkServer::~WorkServer() {
  for (int rank = 1; rank < transport_.size(); ++rank) {
    try {
      transport_.send(rank, kEnd, {});
    } catch (const Error&) {  // the rank has already ended
    }
  }
}

namespace {

/// Requests to the other ranks that have no answer yet.
class OpenRequests {
 public:
  OpenRequests(Transport& transport, const std::vector<Work>& work, const WorkOptions& options,
               WorkStatistics& statistics)
      : transport_(transport),
        work_(work),
        options_(options),
        statistics_(statistics),
        pending_(static_cast<std::size_t>(transport.size())),
        last_answer_s_(pending_.size(), 0.0) {}

  /// Whether an answer is missing.
  [[nodiscard]] bool any() const {
    return std::any_of(pending_.begin(), pending_.end(), [](const auto& own) { return !own.empty(); });
  }

  /// Sends pieces of `next(rank)` until the rank has as many as it gets in advance.
  template <class Next>
  void send(int rank, Next&& next) {
    auto& own = pending_[static_cast<std::size_t>(rank)];
    while (own.size() < static_cast<std::size_t>(options_.ahead)) {
      const std::optional<std::size_t> i = next(rank);
      if (!i) return;
      if (own.empty()) last_answer_s_[static_cast<std::size_t>(rank)] = watch_.seconds();
      own.insert(*i);
      const std::string message = with_number(*i, work_[*i].request);
      transport_.send(rank, kRequest, message);
      ++statistics_.requests;
      statistics_.request_bytes += message.size();
    }
  }

  /// Removes the request of an answer. \returns its piece and the bytes of the answer \throws Error
  std::pair<std::size_t, std::string_view> take(const Message& message) {
    if (message.tag == kFailure) throw_failure(message);
    std::string_view bytes = message.bytes;
    const std::size_t i = read_number(bytes, message.from);
    const auto rank = static_cast<std::size_t>(message.from);
    if (message.tag != kAnswer || pending_[rank].erase(i) == 0)
      throw Error("rank " + std::to_string(message.from) + " sent an answer without a request");
    last_answer_s_[rank] = watch_.seconds();
    ++statistics_.done[rank];
    ++statistics_.answers;
    statistics_.answer_bytes += message.bytes.size();
    return {i, bytes};
  }

  /// \throws Error naming a rank that has not answered for too long
  void check_time() const {
    for (std::size_t rank = 1; rank < pending_.size(); ++rank) {
      if (pending_[rank].empty() || watch_.seconds() - last_answer_s_[rank] <= options_.time_limit_s)
        continue;
      throw Error("rank " + std::to_string(rank) + " has " + std::to_string(pending_[rank].size()) +
                  " unanswered requests and has sent no answer for " + seconds_text(options_.time_limit_s) +
                  ": it is dead or hangs");
    }
  }

 private:
  Transport& transport_;
  const std::vector<Work>& work_;
  const WorkOptions& options_;
  WorkStatistics& statistics_;
  std::vector<std::set<std::size_t>> pending_;  ///< By rank.
  std::vector<double> last_answer_s_;           ///< By rank.
  Stopwatch watch_;
};

}  // namespace

void WorkServer::run(const std::vector<Work>& work, int local_workers,
                     const std::function<void(std::size_t)>& here,
                     const std::function<void(int, std::size_t, std::string_view)>& there,
                     const StopToken& stop) {
  if (transport_.size() == 1) local_workers = std::max(local_workers, 1);
  Round round(*this, work, local_workers > 0);
  std::mutex mutex;
  std::exception_ptr failure;
  const auto fail = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    if (!failure) failure = std::current_exception();
    round.close();
  };

  const auto has_failed = [&] {
    const std::lock_guard<std::mutex> lock(mutex);
    return failure != nullptr;
  };
  const auto serve = [&] {
    OpenRequests requests(transport_, work, options_, statistics_);
    PollBackoff backoff;
    const auto next = [&](int rank) { return round.next(rank); };
    try {
      for (int rank = 1; rank < transport_.size(); ++rank) requests.send(rank, next);
      while (true) {
        if (stop.stop_requested()) round.close();
        if (!requests.any() && round.exhausted()) return;
        bool any = false;
        while (const std::optional<Message> message = transport_.receive()) {
          any = true;
          const auto [i, answer] = requests.take(*message);
          there(message->from, i, answer);
          if (stop.stop_requested())
            round.close();  // also here: answers may arrive faster than this loop reads them
          requests.send(message->from, next);
        }
        if (any) {
          backoff.reset();
          continue;
        }
        if (has_failed()) return;  // this rank's own work failed, so the others are not waited for
        requests.check_time();
        backoff.wait();
      }
    } catch (...) {
      fail();
    }
  };

  const auto compute = [&] {
    try {
      while (!stop.stop_requested()) {
        const auto i = round.next(0);
        if (!i) return;
        here(*i);
        const std::lock_guard<std::mutex> lock(mutex);
        ++statistics_.done[0];
      }
    } catch (...) {
      fail();
    }
  };

  std::vector<std::thread> all;
  try {
    if (transport_.size() > 1) all.emplace_back(serve);
    for (int t = 1; t < local_workers; ++t) all.emplace_back(compute);
  } catch (...) {  // the system has no more threads: the existing ones end, and the error is thrown below
    fail();
  }
  if (local_workers > 0) compute();
  for (std::thread& thread : all) thread.join();
  if (failure) std::rethrow_exception(failure);
}

void serve_work(Transport& transport, std::string_view greeting,
                const std::function<std::string(std::string_view request)>& answer) {
  transport.send(0, kGreeting, greeting);
  PollBackoff backoff;
  while (true) {
    const std::optional<Message> message = transport.receive();
    if (!message) {
      backoff.wait();
      continue;
    }
    backoff.reset();
    if (message->tag == kEnd) return;
    if (message->tag != kRequest) throw Error("rank 0 sent a message that is not a request");
    std::string_view request = message->bytes;
    const std::size_t i = read_number(request, message->from);
    try {
      transport.send(0, kAnswer, with_number(i, answer(request)));
    } catch (const std::exception& error) {
      report_failure(transport, error.what());
      throw;
    }
  }
}

void report_failure(Transport& transport, std::string_view why) {
  transport.send(0, kFailure, why);
}

}  // namespace loopwise
