// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <mutex>
#include <string>

#include <loopwise/core/clock.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/online/loop_closure_module.hpp>

namespace loopwise {

/// The statistics of a module. All its threads write them, any thread may read them.
class StatisticsBoard {
 public:
  [[nodiscard]] ModuleStatistics read() const;
  /// Updates the engine's part after `events` events.
  void publish(const Engine& engine, std::size_t events);
  void batch_begins();
  /// Stops counting time.
  void end();
  void problem(const std::string& text);
  void registration_overdue();
  void overdue_registration_back();
  void producer_waits() { count(&ModuleStatistics::producer_waits); }
  void improved() { count(&ModuleStatistics::improvements); }
  void optimized(double seconds) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++statistics_.optimizations;
    statistics_.optimizing_s += seconds;
  }

 private:
  void count(std::size_t ModuleStatistics::*field) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++(statistics_.*field);
  }
  /// Counts the time since the last call as busy or idle, and changes the state. \pre the mutex is held
  void set_busy(bool busy);

  mutable std::mutex mutex_;
  ModuleStatistics statistics_;
  Stopwatch watch_;
  double since_s_ = 0.0;
  bool busy_ = false, ended_ = false;
};

}  // namespace loopwise
