// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise::content_hash_test {
namespace {

std::string hash_of(const std::string& bytes) {
  return to_string(ContentHasher().bytes(bytes.data(), bytes.size()).finish());
}

}  // namespace

TEST_CASE("content hash: the published values", "[core][hash]") {
  REQUIRE(hash_of("") == "00000000000000000000000000000000");
  REQUIRE(hash_of("hello") == "cbd8a7b341bd9b025b1e906a48ae1d19");
  REQUIRE(hash_of("The quick brown fox jumps over the lazy dog") == "e34bbc7bbc071b6c7a433ca9c49a9347");
}

TEST_CASE("content hash: does not depend on the division of the content", "[core][hash][property]") {
  Rng rng(5);
  std::string content;
  for (int i = 0; i < 200; ++i) content += static_cast<char>(rng.below(256));
  const std::string whole = hash_of(content);
  for (int trial = 0; trial < 200; ++trial) {
    ContentHasher hasher;
    for (std::size_t at = 0; at < content.size();) {
      const std::size_t size = std::min<std::size_t>(content.size() - at, rng.below(40));
      hasher.bytes(content.data() + at, size);
      at += size;
    }
    REQUIRE(to_string(hasher.finish()) == whole);
  }
}

TEST_CASE("content hash: empty pieces at any address change nothing", "[core][hash]") {
  for (const std::string before : {"", "abc", "0123456789abcdef"}) {
    const ContentHash expected = ContentHasher().bytes(before.data(), before.size()).finish();
    REQUIRE(ContentHasher().bytes(before.data(), before.size()).bytes(nullptr, 0).finish() == expected);
  }
}

TEST_CASE("content hash: every bit and every border counts", "[core][hash][property]") {
  std::string content(47, 'x');
  const std::string whole = hash_of(content);
  for (std::size_t bit = 0; bit < 8 * content.size(); ++bit) {
    std::string changed = content;
    changed[bit / 8] = static_cast<char>(changed[bit / 8] ^ (1 << (bit % 8)));
    REQUIRE(hash_of(changed) != whole);
  }
  REQUIRE(hash_of(content + '\0') != whole);
  REQUIRE(ContentHasher().text("ab").text("c").finish() != ContentHasher().text("a").text("bc").finish());
  REQUIRE(ContentHasher().number(0.0).finish() != ContentHasher().number(-0.0).finish());
}

}  // namespace loopwise::content_hash_test
