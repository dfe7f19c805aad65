// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <atomic>
#include <memory>

namespace loopwise {

/// Receives the request to end long work early. Copies share the request; a default token is never stopped.
class StopToken {
 public:
  StopToken() = default;
  /// Whether to end early.
  [[nodiscard]] bool stop_requested() const { return flag_ && flag_->load(std::memory_order_relaxed); }

 private:
  friend class StopSource;
  explicit StopToken(std::shared_ptr<const std::atomic<bool>> flag) : flag_(std::move(flag)) {}
  std::shared_ptr<const std::atomic<bool>> flag_;
};

/// Makes the request. request_stop() is lock-free, so a signal handler may call it.
class StopSource {
 public:
  StopSource() : flag_(std::make_shared<std::atomic<bool>>(false)) {}
  /// Asks the holders of all tokens to end early. Cannot be undone.
  void request_stop() const noexcept { flag_->store(true, std::memory_order_relaxed); }
  /// Whether the request was made.
  [[nodiscard]] bool stop_requested() const { return flag_->load(std::memory_order_relaxed); }
  /// The token for the work that may be stopped.
  [[nodiscard]] StopToken token() const { return StopToken(flag_); }

 private:
  std::shared_ptr<std::atomic<bool>> flag_;
};

}  // namespace loopwise
