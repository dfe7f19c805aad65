// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/clock.hpp>

#include <algorithm>
#include <string>
#include <thread>

#include <loopwise/core/error.hpp>

namespace loopwise {

void VirtualClock::wait_until(double time, const StopToken&) {
  now_ = std::max(now_, time);
}

RealClock::RealClock(double start, double rate)
    : origin_(std::chrono::steady_clock::now()), start_(start), rate_(rate) {
  if (!(rate > 0.0)) throw OptionError("rate = " + std::to_string(rate) + ", must be > 0");
}

double RealClock::now() const {
  return start_ + rate_ * std::chrono::duration<double>(std::chrono::steady_clock::now() - origin_).count();
}

void RealClock::wait_until(double time, const StopToken& stop) {
  constexpr double kLongestNap = 0.05;  // s; the longest delay until a stop request is noticed
  while (!stop.stop_requested()) {
    const double left = (time - now()) / rate_;
    if (left <= 0.0) return;
    std::this_thread::sleep_for(std::chrono::duration<double>(std::min(left, kLongestNap)));
  }
}

}  // namespace loopwise
