// SPDX-License-Identifier: BSD-3-Clause
#include "lzf.hpp"

#include <string>

#include "testing.hpp"

namespace loopwise::lzf_test {
namespace {

std::string random_bytes(Rng& rng, std::size_t count) {
  std::string bytes(count, '\0');
  for (char& byte : bytes) byte = static_cast<char>(rng.below(256));
  return bytes;
}

void check_round_trip(const std::string& bytes) {
  const std::string compressed = lzf_compress(bytes);
  std::string back(bytes.size(), '\0');
  REQUIRE(lzf_decompress(compressed, back));
  REQUIRE((back == bytes));  // in one piece: the bytes are not for printing
  REQUIRE(compressed.size() <= bytes.size() + bytes.size() / 32 + 1);
  REQUIRE(bytes.size() <= lzf_largest_output(compressed.size()));
}

TEST_CASE("lzf: round trip for repeats of every distance and length near the coding's limits", "[io][lzf]") {
  Rng rng(1);
  check_round_trip("");
  const std::string pattern = random_bytes(rng, 600);
  for (const std::size_t gap : {0u, 1u, 30u, 8189u, 8190u, 8191u, 8192u, 8193u, 8194u}) {
    for (const std::size_t length : {1u, 2u, 3u, 4u, 8u, 9u, 10u, 31u, 32u, 33u, 263u, 264u, 265u, 600u}) {
      CAPTURE(gap, length);
      const std::string start = pattern.substr(0, length);
      const std::string between = random_bytes(rng, gap > length ? gap - length : 0);
      check_round_trip(start + between + start + "x");
    }
  }
  check_round_trip(std::string(100000, 'a'));
}

TEST_CASE("lzf: damaged data are refused or decode, within their bounds", "[io][lzf][property]") {
  Rng rng(2);
  for (int i = 0; i < 2000; ++i) {
    std::string out(rng.below(500), '\0');
    static_cast<void>(lzf_decompress(random_bytes(rng, rng.below(60)), out));
  }
  std::string out(3, '\0');
  CHECK_FALSE(lzf_decompress("", out));                        // too little
  CHECK_FALSE(lzf_decompress(std::string("\x20\0", 2), out));  // copies from before the start
  CHECK_FALSE(
      lzf_decompress("\x03"
                     "abcd",
                     out));  // too much
  CHECK(
      lzf_decompress("\x02"
                     "abc",
                     out));
  CHECK(out == "abc");
}

}  // namespace
}  // namespace loopwise::lzf_test
