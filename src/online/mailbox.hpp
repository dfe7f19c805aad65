// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace loopwise {

/// Messages for one thread. Producers block while the mailbox is full. Internal stages, for which the thread
/// itself may wait, never block, because both would wait for each other; their messages come first.
template <class Message>
class Mailbox {
 public:
  explicit Mailbox(std::size_t capacity) : capacity_(capacity) {}

  /// Blocks until there is room. \returns false, without taking the message, if closed
  template <class OnFull>
  bool post(Message&& message, OnFull&& on_full) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!closed_ && outer_.size() >= capacity_) {
      on_full();
      room_.wait(lock, [this] { return closed_ || outer_.size() < capacity_; });
    }
    return push(std::move(message));
  }

  /// Never blocks. \returns false, without taking the message, if closed
  bool post_now(Message&& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return push(std::move(message));
  }

  /// For an internal stage: never blocks, and works after close() too.
  void post_inside(Message message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    inner_.push_back(std::move(message));
    some_.notify_one();
  }

  /// Blocks until there is a message and returns it. \returns nothing if the mailbox is closed and empty, and
  /// no message of an internal stage is expected
  std::optional<Message> next(bool expect_inside) {
    std::unique_lock<std::mutex> lock(mutex_);
    some_.wait(lock, [&] {
      return !inner_.empty() || !outer_.empty() || (closed_ && (!expect_inside || abandoned_));
    });
    return pop();
  }

  /// The next message of an internal stage, if there is one.
  std::optional<Message> try_next_inside() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return inner_.empty() ? std::nullopt : pop();
  }

  /// Takes no more messages of producers. With `abandon`, next() does not wait for internal stages either.
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
  /// Whether there is a message of an internal stage.
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
