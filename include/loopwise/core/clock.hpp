// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>

#include <loopwise/core/export.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise {

/// Mission time in seconds since the start of the mission. The library reads time only through this
/// interface.
class LOOPWISE_EXPORT Clock {
 public:
  virtual ~Clock() = default;
  /// Mission time, s.
  [[nodiscard]] virtual double now() const = 0;
  /// Returns at `time`, or soon after a stop request if that comes earlier. Returns at once if `time` has
  /// passed.
  virtual void wait_until(double time, const StopToken& stop) = 0;
};

/// Jumps to the awaited time, so that a replay takes only the time of its computations.
class LOOPWISE_EXPORT VirtualClock final : public Clock {
 public:
  /// The clock shows `start` seconds of mission time until the first wait.
  explicit VirtualClock(double start = 0.0) : now_(start) {}
  [[nodiscard]] double now() const override { return now_; }
  void wait_until(double time, const StopToken& stop) override;

 private:
  double now_;
};

/// Follows the steady wall clock with `rate` mission seconds per second.
class LOOPWISE_EXPORT RealClock final : public Clock {
 public:
  /// \throws OptionError unless rate > 0.
  explicit RealClock(double start = 0.0, double rate = 1.0);
  [[nodiscard]] double now() const override;
  void wait_until(double time, const StopToken& stop) override;

 private:
  std::chrono::steady_clock::time_point origin_;
  double start_;
  double rate_;
};

/// Wall time since construction, s. For reports only: no decision may depend on it.
class Stopwatch {
 public:
  Stopwatch() : start_(std::chrono::steady_clock::now()) {}
  /// Time since construction, s.
  [[nodiscard]] double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  std::chrono::steady_clock::time_point start_;
};

/// A limit of wall time that starts at construction. Results that depend on it depend on the speed of the
/// machine, so use no limit if results must be repeatable.
class Deadline {
 public:
  /// \param limit_s the limit, s; 0: no limit
  explicit Deadline(double limit_s = 0.0) : limit_s_(limit_s) {}
  /// Whether the limit has passed.
  [[nodiscard]] bool passed() const { return limit_s_ > 0.0 && watch_.seconds() > limit_s_; }

 private:
  double limit_s_;
  Stopwatch watch_;
};

}  // namespace loopwise
