// SPDX-License-Identifier: BSD-3-Clause
#include "blas_threads.hpp"

#include <dlfcn.h>

#include <mutex>

namespace loopwise::detail {
namespace {

template <class Function>
Function* find_symbol(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

struct OpenMp {
  void (*const set_levels)(int) = find_symbol<void(int)>("omp_set_max_active_levels");
  int (*const get_levels)() = find_symbol<int()>("omp_get_max_active_levels");
  void (*const set_threads)(int) = find_symbol<void(int)>("omp_set_num_threads");
  int (*const get_threads)() = find_symbol<int()>("omp_get_max_threads");
  const bool found =
      set_levels != nullptr && get_levels != nullptr && set_threads != nullptr && get_threads != nullptr;
};

const OpenMp& open_mp() {
  static const OpenMp instance;
  return instance;
}

struct OpenBlas {
  std::mutex mutex;
  int users = 0;
  int saved_threads = 1;
  void (*const set_threads)(int) = find_symbol<void(int)>("openblas_set_num_threads");
  int (*const get_threads)() = find_symbol<int()>("openblas_get_num_threads");
  const bool found = set_threads != nullptr && get_threads != nullptr;
};

// The setting is one per process, so its bookkeeping is too.
OpenBlas& open_blas() {
  static OpenBlas instance;
  return instance;
}

/// An OpenBLAS built with OpenMP also changes the calling thread's number of OpenMP threads; this restores
/// it.
void set_threads_of(const OpenBlas& blas, int count) {
  const OpenMp& omp = open_mp();
  const int own = omp.found ? omp.get_threads() : 0;
  blas.set_threads(count);
  if (omp.found && omp.get_threads() != own) omp.set_threads(own);
}

}  // namespace

SingleThreadedBlas::SingleThreadedBlas() {
  OpenBlas& blas = open_blas();
  if (blas.found) {
    const std::lock_guard<std::mutex> lock(blas.mutex);
    if (blas.users++ == 0) {
      blas.saved_threads = blas.get_threads();
      if (blas.saved_threads != 1) set_threads_of(blas, 1);
    }
  }
  // CHOLMOD sets a number of threads at each of its loops; only the number of active levels overrides it. A
  // thread that finds 0 levels does not set them, here and in the destructor: before GCC 11 libgomp has one
  // number of levels for the whole process, and the thread that changed it restores it.
  const OpenMp& omp = open_mp();
  if (!omp.found) return;
  levels_ = omp.get_levels();
  threads_ = omp.get_threads();
  if (levels_ > 0) omp.set_levels(0);
  if (threads_ > 1) omp.set_threads(1);
}

SingleThreadedBlas::~SingleThreadedBlas() {
  OpenBlas& blas = open_blas();
  if (blas.found) {
    const std::lock_guard<std::mutex> lock(blas.mutex);
    if (--blas.users == 0 && blas.saved_threads != 1) set_threads_of(blas, blas.saved_threads);
  }
  const OpenMp& omp = open_mp();
  if (levels_ > 0) omp.set_levels(levels_);
  if (threads_ > 1) omp.set_threads(threads_);
}

}  // namespace loopwise::detail
