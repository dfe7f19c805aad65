// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <chrono>
#include <cstddef>
#include <string>

#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise::cli {

/// Output to standard error: progress, warnings and notes. Results go to standard output, never through this
/// class.
class Console {
 public:
  explicit Console(bool quiet);
  ~Console();
  Console(const Console&) = delete;
  Console& operator=(const Console&) = delete;

  /// On a terminal a bar that is redrawn, elsewhere a plain line every few seconds. Rate and remaining time
  /// are those of the stage. Shows nothing if quiet.
  void progress(const Progress& progress);
  [[nodiscard]] ProgressCallback progress_callback();

  /// Shows one line, after ending a progress bar. Shows nothing if quiet.
  void note(const std::string& text);
  /// Shows one line even if quiet.
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

/// While an object exists, SIGINT and SIGTERM request a stop. A second signal ends the process immediately.
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
