// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <new>
#include <optional>
#include <thread>
#include <utility>

#include <loopwise/core/stop_token.hpp>

namespace loopwise {

/// How long what must not be lost waits for memory: until there is some, but once a stop is requested not for
/// ever, or the stop would.
class Patience {
 public:
  using Clock = std::chrono::steady_clock;
  /// When a request that finds no memory first asked with a stop requested.
  using Asked = std::optional<Clock::time_point>;

  explicit Patience(StopToken stop) : stop_(std::move(stop)) {}

  /// After a request that found no memory: waits a moment. \returns false once that request has waited a
  /// second with a stop requested, and from then on, for whoever asks.
  bool wait(Asked& asked) {
    if (!given_up_ && stop_.stop_requested()) {
      const Clock::time_point now = Clock::now();
      if (!asked) asked = now;
      if (now - *asked > std::chrono::seconds(1)) given_up_ = true;
    }
    if (given_up_) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return true;
  }
  [[nodiscard]] bool given_up() const { return given_up_; }

  /// Whether a message was lost: there may be one that waits for an answer to it.
  void lose() { lost_ = true; }
  [[nodiscard]] bool lost() const { return lost_; }

 private:
  const StopToken stop_;
  std::atomic<bool> given_up_{false}, lost_{false};
};

/// Messages for one thread. Producers are held while too many wait; the stages that the thread itself waits
/// for are not, or they would wait for each other, and their messages come first.
template <class Message>
class Mailbox {
 public:
  Mailbox(std::size_t capacity, Patience& patience) : capacity_(capacity), patience_(patience) {}

  /// Waits for room. \returns false, with the message not taken, once closed; nor is it where this throws.
  template <class OnFull>
  bool post(Message&& message, OnFull&& on_full) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!closed_ && outer_.size() >= capacity_) {
      on_full();
      room_.wait(lock, [this] { return closed_ || outer_.size() < capacity_; });
    }
    if (closed_) return false;
    outer_.push_back(std::move(message));
    some_.notify_one();
    return true;
  }

  /// Never waits. \returns false, with the message not taken, once closed; nor is it where this throws.
  bool post_now(Message&& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (closed_) return false;
    outer_.push_back(std::move(message));
    some_.notify_one();
    return true;
  }

  /// From a stage inside: never waits for room, and is taken even when closed. Without memory it tries again
  /// until there is some: a result that is there must not be lost. \returns false, with the message lost,
  /// once that is given up.
  bool post_inside(Message message) {
    for (Patience::Asked asked;;) {
      try {
        const std::lock_guard<std::mutex> lock(mutex_);
        inner_.push_back(std::move(message));  // does not touch the message if it throws
        some_.notify_one();
        return true;
      } catch (const std::bad_alloc&) {
        if (patience_.wait(asked)) continue;
        const std::lock_guard<std::mutex> lock(mutex_);
        patience_.lose();
        some_.notify_one();
        return false;
      }
    }
  }

  /// The next message, waiting for one; none once closed, empty, and no more expected from inside. Where a
  /// message from inside was lost, in whatever mailbox, what is expected may never come.
  std::optional<Message> next(bool expect_inside) {
    std::unique_lock<std::mutex> lock(mutex_);
    some_.wait(lock, [&] {
      return !inner_.empty() || !outer_.empty() || (closed_ && (!expect_inside || patience_.lost()));
    });
    std::deque<Message>& from = inner_.empty() ? outer_ : inner_;
    if (from.empty()) return std::nullopt;
    Message message = std::move(from.front());
    from.pop_front();
    room_.notify_one();
    return message;
  }

  void close() {
    const std::lock_guard<std::mutex> lock(mutex_);
    closed_ = true;
    room_.notify_all();
    some_.notify_all();
  }

  [[nodiscard]] std::size_t size() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return outer_.size() + inner_.size();
  }
  [[nodiscard]] bool closed() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return closed_;
  }

 private:
  const std::size_t capacity_;
  Patience& patience_;
  mutable std::mutex mutex_;
  std::condition_variable some_, room_;
  std::deque<Message> outer_, inner_;
  bool closed_ = false;
};

}  // namespace loopwise
