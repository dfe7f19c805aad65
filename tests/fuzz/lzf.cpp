// SPDX-License-Identifier: BSD-3-Clause
// The first two bytes are the claimed size of the uncompressed rest.
#include "lzf.hpp"

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(lzf, bytes) {
  using namespace loopwise;
  const std::string packed = lzf_compress(bytes);
  fuzz::expect(packed.size() <= bytes.size() + bytes.size() / 32 + 1, "compressed data are not much longer");
  fuzz::expect(bytes.size() <= lzf_largest_output(packed.size()), "and not too short to be true");
  std::string again(bytes.size(), '\0');
  fuzz::expect(lzf_decompress(packed, again) && again == bytes, "compressed and expanded again: the same");

  if (bytes.size() < 2) return;
  const std::size_t size = static_cast<unsigned char>(bytes[0]) * 256u + static_cast<unsigned char>(bytes[1]);
  std::string out(size, '\0');
  if (lzf_decompress(bytes.substr(2), out)) {
    fuzz::expect(size <= lzf_largest_output(bytes.size() - 2), "no more comes out than the bound says");
  }
}
