// SPDX-License-Identifier: BSD-3-Clause
#include "linalg/blas_threads.hpp"

#include <dlfcn.h>

#include <array>
#include <future>
#include <memory>
#include <thread>
#include <vector>

#include "testing.hpp"

namespace loopwise::blas_threads_test {
namespace {

template <class Function>
Function* find_symbol(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_DEFAULT, name));
}

/// OpenMP's settings of the calling thread, and that of OpenBLAS; constant where they are not loaded.
std::array<int, 3> settings() {
  std::array<int, 3> all{};
  std::size_t k = 0;
  for (const char* name : {"omp_get_max_active_levels", "omp_get_max_threads", "openblas_get_num_threads"}) {
    if (auto* const get = find_symbol<int()>(name)) all[k] = get();
    ++k;
  }
  return all;
}

void set(const char* name, int value) {
  if (auto* const function = find_symbol<void(int)>(name)) function(value);
}

}  // namespace

TEST_CASE("BLAS threads: each thread's settings are as found, whichever ends last", "[linalg][threads]") {
  constexpr std::size_t kThreads = 3;
  using Guards = std::vector<std::unique_ptr<detail::SingleThreadedBlas>>;
  // Threads begin in order and end in the order given.
  for (const std::array<std::size_t, kThreads>& ends :
       {std::array<std::size_t, kThreads>{0, 1, 2}, {2, 1, 0}, {1, 2, 0}}) {
    const std::array<int, 3> here = settings();
    std::array<std::promise<void>, kThreads> begin, begun, end, ended;
    std::array<std::array<int, 3>, kThreads> before{}, within{}, after{};
    std::vector<std::thread> threads;
    for (std::size_t k = 0; k < kThreads; ++k) {
      threads.emplace_back([&, k] {
        begin[k].get_future().wait();
        set("omp_set_max_active_levels", 2 + static_cast<int>(k));
        set("omp_set_num_threads", 4 + static_cast<int>(k));
        before[k] = settings();
        Guards guards(2);
        for (auto& guard : guards) guard = std::make_unique<detail::SingleThreadedBlas>();
        within[k] = settings();
        begun[k].set_value();
        end[k].get_future().wait();
        for (auto& guard : guards) guard.reset();
        after[k] = settings();
        ended[k].set_value();
      });
    }
    for (std::size_t k = 0; k < kThreads; ++k) {
      begin[k].set_value();
      begun[k].get_future().wait();
    }
    for (const std::size_t k : ends) {
      end[k].set_value();
      ended[k].get_future().wait();
    }
    for (std::thread& thread : threads) thread.join();
    for (std::size_t k = 0; k < kThreads; ++k) {
      CAPTURE(k);
      REQUIRE(after[k][0] == before[k][0]);
      REQUIRE(after[k][1] == before[k][1]);
      REQUIRE(within[k][0] == 0);
      REQUIRE(within[k][1] <= 1);
      REQUIRE(within[k][2] <= 1);
    }
    REQUIRE(settings() == here);
  }
}

}  // namespace loopwise::blas_threads_test
