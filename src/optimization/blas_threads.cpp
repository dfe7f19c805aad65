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

struct Shared {
  std::mutex mutex;
  int users = 0;
  int saved_threads = 1;
  int saved_levels = 1;
  void (*const set_threads)(int) = find_symbol<void(int)>("openblas_set_num_threads");
  int (*const get_threads)() = find_symbol<int()>("openblas_get_num_threads");
  void (*const set_levels)(int) = find_symbol<void(int)>("omp_set_max_active_levels");
  int (*const get_levels)() = find_symbol<int()>("omp_get_max_active_levels");
};

// The setting that this guards belongs to the process, so its bookkeeping has to as well.
Shared& shared() {
  static Shared instance;
  return instance;
}

}  // namespace

SingleThreadedBlas::SingleThreadedBlas() {
  Shared& s = shared();
  const std::lock_guard<std::mutex> lock(s.mutex);
  if (s.users++ > 0) return;
  if (s.set_threads != nullptr && s.get_threads != nullptr) {
    s.saved_threads = s.get_threads();
    if (s.saved_threads != 1) s.set_threads(1);
  }
  if (s.set_levels != nullptr && s.get_levels != nullptr) {
    s.saved_levels = s.get_levels();
    s.set_levels(0);
  }
}

SingleThreadedBlas::~SingleThreadedBlas() {
  Shared& s = shared();
  const std::lock_guard<std::mutex> lock(s.mutex);
  if (--s.users > 0) return;
  if (s.set_threads != nullptr && s.get_threads != nullptr && s.saved_threads != 1)
    s.set_threads(s.saved_threads);
  if (s.set_levels != nullptr && s.get_levels != nullptr) s.set_levels(s.saved_levels);
}

}  // namespace loopwise::detail
