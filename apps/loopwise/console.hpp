// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <cstddef>
#include <string>

#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise::cli {

/// "1 closure", "3 closures".
std::string counted(std::size_t count, const std::string& noun);

/// Standard error: progress, warnings and notes. Results go to standard output and never through here.
class Console {
 public:
  explicit Console(bool quiet);
  ~Console();
  Console(const Console&) = delete;
  Console& operator=(const Console&) = delete;

  /// A bar that rewrites itself on a terminal; elsewhere a plain line every few seconds. Rate and time left
  /// are of the stage. Nothing if quiet.
  void progress(const Progress& progress);
  [[nodiscard]] ProgressCallback progress_callback();

  /// One line; ends a progress bar first. Nothing if quiet.
  void note(const std::string& text);
  /// Shown even if quiet.
  void warn(const std::string& text);
  void warn(const Problems& problems);

 private:
  using Time = std::chrono::steady_clock::time_point;
  void end_bar();

  bool quiet_;
  bool terminal_;
  bool bar_open_ = false;
  std::string stage_;
  std::size_t stage_start_done_ = 0;
  Time stage_start_;
  Time last_shown_;
};

/// Turns SIGINT and SIGTERM into a stop request for as long as it lives; a second signal ends the process at
/// once.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;
  [[nodiscard]] StopToken token() const;
  [[nodiscard]] bool interrupted() const;
};

}  // namespace loopwise::cli
