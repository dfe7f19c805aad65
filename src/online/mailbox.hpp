// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace loopwise {

/// Messages for one thread. Producers wait while the mailbox is full. Stages that the thread itself waits for
/// do not, or they would wait for each other, and their messages come first.
template <class Message>
class Mailbox {
 public:
  explicit Mailbox(std::size_t capacity) : capacity_(capacity) {}

  /// Waits for room. \returns false, with the message not taken, once closed
  template <class OnFull>
  bool post(Message&& message, OnFull&& on_full) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!closed_ && outer_.size() >= capacity_) {
      on_full();
      room_.wait(lock, [this] { return closed_ || outer_.size() < capacity_; });
    }
    return push(std::move(message));
  }

  /// Never waits. \returns false, with the message not taken, once closed
  bool post_now(Message&& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return push(std::move(message));
  }

  /// From a stage inside: never waits for room, and is taken even when closed.
  void post_inside(Message message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    inner_.push_back(std::move(message));
    some_.notify_one();
  }

  /// The next message, waiting for one; none once closed, empty, and no more expected from inside.
  std::optional<Message> next(bool expect_inside) {
    std::unique_lock<std::mutex> lock(mutex_);
    some_.wait(lock, [&] {
      return !inner_.empty() || !outer_.empty() || (closed_ && (!expect_inside || abandoned_));
    });
    return pop();
  }

  /// The next message from inside, if there is one.
  std::optional<Message> try_next_inside() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return inner_.empty() ? std::nullopt : pop();
  }

  /// Takes no more from producers. With `abandon`, messages from inside are not waited for either.
  void close(bool abandon = false) {
    const std::lock_guard<std::mutex> lock(mutex_);
    closed_ = true;
    abandoned_ = abandoned_ || abandon;
    room_.notify_all();
    some_.notify_all();
  }

  [[nodiscard]] std::size_t size() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return outer_.size() + inner_.size();
  }
  /// Whether a message from inside waits.
  [[nodiscard]] bool inside_waits() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return !inner_.empty();
  }

 private:
  bool push(Message&& message) {
    if (closed_) return false;
    outer_.push_back(std::move(message));
    some_.notify_one();
    return true;
  }
  std::optional<Message> pop() {
    std::deque<Message>& from = inner_.empty() ? outer_ : inner_;
    if (from.empty()) return std::nullopt;
    std::optional<Message> message(std::move(from.front()));
    from.pop_front();
    room_.notify_one();
    return message;
  }

  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable some_, room_;
  std::deque<Message> outer_, inner_;
  bool closed_ = false, abandoned_ = false;
};

}  // namespace loopwise
