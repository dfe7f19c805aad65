// SPDX-License-Identifier: BSD-3-Clause
// Data compressed by zlib.
#include "inflate.hpp"

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(inflate, bytes) {
  using namespace loopwise;
  constexpr std::size_t kMost = 1 << 16;
  const auto out = fuzz::attempt([&] { return inflate_zlib(bytes, kMost); });
  if (!out) return;
  fuzz::expect(out->size() <= kMost, "no more comes out than was allowed");
  if (out->empty()) return;
  fuzz::expect(!fuzz::attempt([&] { return inflate_zlib(bytes, out->size() - 1); }), "less is refused");
}
