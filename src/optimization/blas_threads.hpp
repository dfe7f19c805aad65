// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>

namespace loopwise::detail {

/// Keeps OpenBLAS and the OpenMP loops of CHOLMOD to the calling thread while any such object lives, and
/// restores the former settings with the last one: the sums of a multi-threaded BLAS depend on its number of
/// threads, and its spinning workers fight a pool for the processors. The settings are the process's own, so
/// other users of OpenBLAS see them meanwhile. Nothing happens with another BLAS. Exported for
/// loopwise-train: there must be one count of such objects in a process.
class LOOPWISE_EXPORT SingleThreadedBlas {
 public:
  SingleThreadedBlas();
  ~SingleThreadedBlas();
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;
};

}  // namespace loopwise::detail
