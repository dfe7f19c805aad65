// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>

namespace loopwise::detail {

/// Keeps OpenBLAS and the OpenMP loops of CHOLMOD to the calling thread while an object of this class exists.
/// The sums of a multi-threaded BLAS depend on its number of threads, and its spinning workers compete with a
/// thread pool for the processors. OpenMP's settings belong to each thread: every object restores those of
/// its thread, so the thread that made it must destroy it. OpenBLAS has one setting for the process, which
/// the last object restores; until then other users of OpenBLAS are restricted too. With another BLAS only
/// OpenMP is affected. Exported for loopwise-train, because a process must have one count of these objects.
class LOOPWISE_EXPORT SingleThreadedBlas {
 public:
  SingleThreadedBlas();
  ~SingleThreadedBlas();
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;

 private:
  int levels_ = 0;   // OpenMP's active levels as found; 0: not changed
  int threads_ = 1;  // of OpenMP's next region as found; 1: not changed
};

}  // namespace loopwise::detail
