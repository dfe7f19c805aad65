// SPDX-License-Identifier: BSD-3-Clause
#include "allocations.hpp"

#include <cstdlib>
#include <new>

namespace loopwise::fuzz {

std::atomic<std::size_t> largest_allocation{0};
std::atomic<long> allocations_until_none{0};

namespace {

void note(std::size_t size) {
  std::size_t before = largest_allocation;
  while (before < size && !largest_allocation.compare_exchange_weak(before, size)) {
  }
}

}  // namespace
}  // namespace loopwise::fuzz

// Every request for memory of this program passes here. Not inlined: gcc would take free() for a mistake.
[[gnu::noinline]] void* operator new(std::size_t size) {
  using namespace loopwise::fuzz;
  note(size);
  const bool none = allocations_until_none > 0 && --allocations_until_none == 0;
  if (void* const memory = none ? nullptr : std::malloc(size > 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
// Sanitizers bring this one themselves, and what it gives would then be freed by ours.
[[gnu::noinline]] void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  loopwise::fuzz::note(size);
  return std::malloc(size > 0 ? size : 1);
}
[[gnu::noinline]] void operator delete(void* memory) noexcept {
  std::free(memory);
}
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept {
  std::free(memory);
}
