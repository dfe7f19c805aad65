// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <mutex>

namespace loopwise {

/// Counts messages that are not handled and jobs that are not done. At zero nothing more happens until
/// somebody adds something.
class OpenWork {
 public:
  void begin() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++count_;
  }
  void end() {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (--count_ == 0) done_.notify_all();
  }
  /// Ends all waiting, now and later.
  void stop() {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopped_ = true;
    done_.notify_all();
  }
  /// Waits for zero. \returns false once stopped
  [[nodiscard]] bool wait() {
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return count_ == 0 || stopped_; });
    return !stopped_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable done_;
  std::size_t count_ = 0;
  bool stopped_ = false;
};

}  // namespace loopwise
