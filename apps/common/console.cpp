// SPDX-License-Identifier: BSD-3-Clause
#include "console.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>

namespace loopwise::cli {
namespace {

std::string duration(double seconds) {
  if (!std::isfinite(seconds)) return "?";
  char text[32];
  if (seconds < 100.0) {
    std::snprintf(text, sizeof text, "%.0f s", seconds);
  } else if (seconds < 6000.0) {
    std::snprintf(text, sizeof text, "%.0f min", seconds / 60.0);
  } else {
    std::snprintf(text, sizeof text, "%.1f h", seconds / 3600.0);
  }
  return text;
}

// A signal handler can only use static objects. The source is made once and exists until the process ends.
StopSource& interrupt_source() {
  static StopSource source;
  return source;
}

extern "C" void on_interrupt(int signal) {
  interrupt_source().request_stop();
  std::signal(signal, SIG_DFL);
}

}  // namespace

Console::Console(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) == 1) {}

Console::~Console() {
  end_bar();
}

void Console::end_bar() {
  if (bar_open_) std::fputc('\n', stderr);
  bar_open_ = false;
}

ProgressCallback Console::progress_callback() {
  return [this](const Progress& p) { progress(p); };
}

void Console::progress(const Progress& p) {
  if (quiet_) return;
  const Time now = std::chrono::steady_clock::now();
  const auto since = [now](Time t) { return std::chrono::duration<double>(now - t).count(); };
  const bool new_stage = p.stage != stage_;
  if (new_stage) {
    end_bar();
    stage_ = p.stage;
    stage_start_ = now;
    stage_start_done_ = p.done;
  }
  const bool finished = p.total > 0 && p.done >= p.total;
  const double every = terminal_ ? 0.1 : 5.0;
  if (since(last_shown_) < every && !(finished && terminal_) && !(new_stage && terminal_)) return;
  last_shown_ = now;

  const double elapsed = since(stage_start_);
  const double rate =
      elapsed > 0.0 ? static_cast<double>(p.done - std::min(p.done, stage_start_done_)) / elapsed : 0.0;
  std::string line = p.stage;
  if (terminal_ && p.total > 0) {
    constexpr int kWidth = 24;
    const double share = std::min(1.0, static_cast<double>(p.done) / static_cast<double>(p.total));
    const int filled = static_cast<int>(share * kWidth);
    line += " [" + std::string(static_cast<std::size_t>(filled), '#') +
            std::string(static_cast<std::size_t>(kWidth - filled), '.') + "]";
  }
  line += " " + std::to_string(p.done);
  if (p.total > 0) line += "/" + std::to_string(p.total);
  if (rate > 0.0) {
    char text[32];
    std::snprintf(text, sizeof text, ", %.3g/s", rate);
    line += text;
    if (p.total > p.done) line += ", " + duration(static_cast<double>(p.total - p.done) / rate) + " left";
  }
  if (!p.detail.empty()) line += ", " + p.detail;
  if (terminal_) {
    std::fprintf(stderr, "\r\033[K%s", line.c_str());
    bar_open_ = true;
  } else {
    std::fprintf(stderr, "%s\n", line.c_str());
  }
  std::fflush(stderr);
}

void Console::note(const std::string& text) {
  if (quiet_) return;
  end_bar();
  std::fprintf(stderr, "%s\n", text.c_str());
}

void Console::warn(const std::string& text) {
  end_bar();
  std::fprintf(stderr, "warning: %s\n", text.c_str());
}

void Console::warn(const Problems& problems) {
  for (const Problem& problem : problems.all()) warn(to_string(problem));
}

InterruptGuard::InterruptGuard() {
  static_cast<void>(interrupt_source());
  std::signal(SIGINT, on_interrupt);
  std::signal(SIGTERM, on_interrupt);
}

InterruptGuard::~InterruptGuard() {
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

StopToken InterruptGuard::token() const {
  return interrupt_source().token();
}
bool InterruptGuard::interrupted() const {
  return interrupt_source().stop_requested();
}

}  // namespace loopwise::cli
