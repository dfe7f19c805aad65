// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <string>

#include <loopwise/engine/engine.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Reports a run to the hooks of a replay.
class RunLog {
 public:
  /// \param key_frames of the mission; the other arguments must outlive the log
  RunLog(const ReplayHooks& hooks, const Engine& engine, const ReplayResult& result, std::size_t key_frames,
         std::int64_t max_registrations)
      : hooks_(hooks),
        engine_(engine),
        result_(result),
        key_frames_(key_frames),
        max_registrations_(static_cast<std::size_t>(max_registrations)) {}

  void write(const std::string& line) const {
    if (hooks_.journal) hooks_.journal(line);
  }

  void show(ReplayMoment::Kind kind, double now_s) const {
    if (!hooks_.moment) return;
    hooks_.moment({kind, now_s, engine_.graph(), engine_.odometry(), result_.computed, account()});
  }

  /// \param computed registrations so far, including those that the engine has not handled
  /// \param verified number of them that are verified
  /// \param reachable registrations for which the clock has time, in addition to those that the engine has
  /// handled
  void report(std::size_t computed, std::size_t verified, std::size_t reachable) const {
    if (!hooks_.progress) return;
    const CandidateAccounting& a = account();
    std::size_t total = a.computed + std::min(a.in_flight + a.pending, reachable);
    if (max_registrations_ > 0) total = std::min(total, max_registrations_);
    hooks_.progress({"registering", computed, std::max(total, computed),
                     std::to_string(verified) + " accepted, " + std::to_string(a.computed - verified) +
                         " rejected, " + std::to_string(engine_.graph().nodes().size()) + "/" +
                         std::to_string(key_frames_) + " key frames"});
  }

 private:
  [[nodiscard]] const CandidateAccounting& account() const { return engine_.pool().accounting(); }

  const ReplayHooks& hooks_;
  const Engine& engine_;
  const ReplayResult& result_;
  const std::size_t key_frames_, max_registrations_;
};

}  // namespace loopwise
