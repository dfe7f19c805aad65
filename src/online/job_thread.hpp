// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <thread>
#include <utility>

#include "mailbox.hpp"

namespace loopwise {

/// Executes jobs one after the other in its own thread.
template <class Job>
class JobThread {
 public:
  /// `work` must not throw. \throws std::system_error if the system has no more threads
  explicit JobThread(std::function<void(Job&&)> work)
      : work_(std::move(work)), thread_([this] {
          while (auto job = jobs_.next(false)) work_(std::move(*job));
        }) {}
  ~JobThread() { stop(); }
  JobThread(const JobThread&) = delete;
  JobThread& operator=(const JobThread&) = delete;

  void post(Job job) { jobs_.post_inside(std::move(job)); }
  /// Ends the thread after the posted jobs.
  void stop() {
    jobs_.close();
    if (thread_.joinable()) thread_.join();
  }

 private:
  const std::function<void(Job&&)> work_;
  Mailbox<Job> jobs_{1};
  std::thread thread_;
};

}  // namespace loopwise
