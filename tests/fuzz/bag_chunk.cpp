// SPDX-License-Identifier: BSD-3-Clause
// A compressed chunk of a bag. The first byte chooses the compression, the next three are the size.
#include "bag_check.hpp"
#include "target.hpp"

LOOPWISE_FUZZ_TARGET(bag_chunk, bytes) {
  using namespace loopwise;
  constexpr const char* kCompressions[] = {"none", "bz2", "lz4", "zip"};
  const char* const compression = kCompressions[fuzz::take_choice(bytes, 4)];
  std::size_t size = 0;
  for (int i = 0; i < 3; ++i) size = size * 256 + fuzz::take_choice(bytes, 256);
  const auto contents = fuzz::attempt([&] { return bags::inflate_chunk(compression, bytes, size); });
  if (contents) fuzz::expect(contents->size() == size, "a chunk has the size that it claims");
}
