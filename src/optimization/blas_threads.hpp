// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>

namespace loopwise::detail {

/// Keeps OpenBLAS and the OpenMP loops of CHOLMOD to the calling thread while such an object lives: the sums
/// of a multi-threaded BLAS depend on its number of threads, and its spinning workers fight a pool for the
/// processors. OpenMP's settings belong to each thread: every object restores those of its own, and is to be
/// destroyed by the thread that made it. OpenBLAS has one setting for the process, which the last object
/// restores; other users of OpenBLAS see it meanwhile. Nothing happens with another BLAS. Exported for
/// loopwise-train: there must be one count of such objects in a process.
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
