// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Number of threads for an option `threads`: its value, or one per processor if it is 0.
/// \throws OptionError on a negative number
[[nodiscard]] LOOPWISE_EXPORT int resolve_threads(int threads);

/// Threads for coarse tasks. A task is never split further, and its result must not depend on its thread. So
/// the number of threads changes only the run time.
class LOOPWISE_EXPORT ThreadPool {
 public:
  /// \param threads see resolve_threads(). With 1, all work runs in the calling thread.
  explicit ThreadPool(int threads = 0);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  /// Number of threads that work at once.
  [[nodiscard]] int num_threads() const;
  /// Takes effect from the next for_each(). Must not be called during a for_each().
  void resize(int threads);

  /// Calls body(i) once for every i in [0, count), in any order and on any thread, and returns when all calls
  /// are done. Calls from several threads share the workers and may wait for each other. If calls throw, the
  /// exception of the lowest index is rethrown after the others have finished.
  void for_each(std::size_t count, const std::function<void(std::size_t)>& body);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
