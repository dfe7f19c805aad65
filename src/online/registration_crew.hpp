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

/// Threads that compute batches of registrations. Unlike with a thread pool, a batch does not wait for a
/// registration that hangs: that registration is reported and keeps its thread, and the others continue. When
/// all threads hang, new threads replace them, at most as many as the original ones.
class RegistrationCrew {
 public:
  struct Hooks {
    std::function<void(RegistrationResult&&)> result;  ///< Called from a thread of the crew. Must not throw.
    /// A registration that has run for this many seconds. Called from run() while all threads of the crew are
    /// blocked: must not wait for them, nor throw.
    std::function<void(const LoopCandidate&, double)> overdue;
    std::function<void()>
        back;  ///< An overdue registration has returned; called after its result. Must not throw.
  };

  /// \param threads 0: one per processor \param overdue_after_s 0: run() waits for all \throws
  /// std::system_error if the system has no more threads.
  RegistrationCrew(const Registrar& registrar, int threads, double overdue_after_s, Hooks hooks);
  /// Waits for running registrations without a time limit: a registrar cannot be interrupted.
  ~RegistrationCrew();
  RegistrationCrew(const RegistrationCrew&) = delete;
  RegistrationCrew& operator=(const RegistrationCrew&) = delete;

  /// Returns when each task has a result, is overdue, or was not begun because of a stop request. \returns
  /// the candidates that were not begun.
  [[nodiscard]] std::vector<LoopCandidate> run(std::vector<RegistrationTask> tasks, const StopToken& stop);

  /// Whether the caller runs in a thread of the crew, as registrars do.
  [[nodiscard]] bool is_own_thread();

 private:
  struct Worker {
    std::thread thread;
    std::thread::id id;  // copy of the thread's id, valid while another thread joins it
    bool busy = false;
    bool overdue = false;
    bool ended = false;       // its thread has ended because a spare one replaced it
    LoopCandidate candidate;  // while busy
    Stopwatch watch;          // since it became busy
  };

  void start(Worker& worker);
  void work(Worker& self);
  void end();
  /// \pre the mutex is held, also during the hook, so that Hooks::back cannot come first
  void report_overdue();
  /// Starts a spare thread if all threads hang and the system has one. \pre the mutex is held
  void replace_hanging();
  [[nodiscard]] bool finished() const;
  /// Waits for a change, at most this long.
  void pause(std::unique_lock<std::mutex>& lock, double seconds);

  const Registrar& registrar_;
  const double overdue_after_s_;
  const Hooks hooks_;
  std::mutex mutex_;  // protects all fields below
  std::condition_variable some_, changed_;
  std::deque<RegistrationTask> tasks_;
  std::vector<LoopCandidate> not_begun_;
  StopToken stop_;
  bool ending_ = false;
  std::deque<Worker> workers_;  // a deque, because threads refer to its elements
  std::size_t threads_ = 0;     // requested number
  std::size_t spares_ = 0;      // threads in addition to that number
};

}  // namespace loopwise
