// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// How many threads an option `threads` asks for: that many, or one per processor if it is 0.
/// \throws OptionError on a negative number
[[nodiscard]] LOOPWISE_EXPORT int resolve_threads(int threads);

/// Threads for coarse tasks. Work is never split further inside a task, and what a task computes must not
/// depend on the thread that runs it: then the number of threads changes the run time and nothing else.
class LOOPWISE_EXPORT ThreadPool {
 public:
  /// `threads` as resolve_threads() takes it. With 1 all work runs in the calling thread.
  explicit ThreadPool(int threads = 0);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  /// How many threads work at once.
  [[nodiscard]] int num_threads() const;
  /// Takes effect from the next for_each; must not be called while one runs.
  void resize(int threads);

  /// Calls body(i) once for every i in [0, count), in any order and on any thread, and returns when all are
  /// done; calls from several threads share the workers and may wait for each other. If calls throw, the
  /// exception of the lowest index is rethrown after the others have finished.
  void for_each(std::size_t count, const std::function<void(std::size_t)>& body);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
