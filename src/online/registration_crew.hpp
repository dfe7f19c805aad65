// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Threads that compute batches of registrations. Unlike a thread pool's, a batch does not wait for a
/// registration that hangs: it is reported and keeps its thread, the others go on. Once all hang, others take
/// their place, as many again and no more.
class RegistrationCrew {
 public:
  struct Hooks {
    std::function<void(RegistrationResult&&)> result;  ///< From a thread of the crew. Must not throw.
    /// Has run for so many seconds. From run(), with all others held up: must not wait for them, nor throw.
    std::function<void(const LoopCandidate&, double)> overdue;
    std::function<void()> back;  ///< An overdue one has come back, after its result. Must not throw.
  };

  /// `threads` 0: one per processor. `overdue_after_s` 0: run() waits for all. \throws std::system_error if
  /// the system has no more threads.
  RegistrationCrew(const Registrar& registrar, int threads, double overdue_after_s, Hooks hooks);
  /// Waits for running registrations without a time limit: a registrar cannot be interrupted.
  ~RegistrationCrew();
  RegistrationCrew(const RegistrationCrew&) = delete;
  RegistrationCrew& operator=(const RegistrationCrew&) = delete;

  /// Returns once each task has a result, is overdue, or was not begun because of a stop request.
  /// \returns those that were not begun.
  [[nodiscard]] std::vector<LoopCandidate> run(std::vector<RegistrationTask> tasks, const StopToken& stop);

  /// Whether the caller runs in a thread of the crew, as registrars do.
  [[nodiscard]] bool is_own_thread();

 private:
  struct Worker {
    std::thread thread;
    std::thread::id id;  // of the thread, which another one may be joining
    bool busy = false;
    bool overdue = false;
    bool ended = false;       // its thread, for others have its place
    LoopCandidate candidate;  // while busy
    Stopwatch watch;          // since it became busy
  };

  void start(Worker& worker);
  void work(Worker& self);
  void end();
  /// With the mutex held, also while the hook runs: Hooks::back must not come before it.
  void report_overdue();
  /// With the mutex held: a thread in place of those that hang, if none is left and the system has one.
  void replace_hanging();
  [[nodiscard]] bool finished() const;
  /// Until something changes, or for so long.
  void pause(std::unique_lock<std::mutex>& lock, double seconds);

  const Registrar& registrar_;
  const double overdue_after_s_;
  const Hooks hooks_;
  std::mutex mutex_;  // of all below
  std::condition_variable some_, changed_;
  std::deque<RegistrationTask> tasks_;
  std::vector<LoopCandidate> not_begun_;
  StopToken stop_;
  bool ending_ = false;
  std::deque<Worker> workers_;  // their places stay
  std::size_t threads_ = 0;     // as asked for
  std::size_t spares_ = 0;      // beyond that
};

}  // namespace loopwise
