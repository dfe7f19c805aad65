// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <mutex>

namespace loopwise {

/// Counts unhandled messages and unfinished jobs. At zero nothing more happens until a producer adds
/// something.
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
  /// Ends all present and later waits.
  void stop() {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopped_ = true;
    done_.notify_all();
  }
  /// Waits for zero. \returns false after stop()
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
