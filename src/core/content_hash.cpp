// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/content_hash.hpp>

#include <algorithm>
#include <cstring>

namespace loopwise {
namespace {

constexpr std::uint64_t kFirst = 0x87c37b91114253d5ULL, kSecond = 0x4cf5ad432745937fULL;

std::uint64_t rotated(std::uint64_t x, int by) {
  return (x << by) | (x >> (64 - by));
}

std::uint64_t first_word(std::uint64_t word) {
  return rotated(word * kFirst, 31) * kSecond;
}
std::uint64_t second_word(std::uint64_t word) {
  return rotated(word * kSecond, 33) * kFirst;
}

std::uint64_t finished(std::uint64_t x) {
  x = (x ^ (x >> 33)) * 0xff51afd7ed558ccdULL;
  x = (x ^ (x >> 33)) * 0xc4ceb9fe1a85ec53ULL;
  return x ^ (x >> 33);
}

std::uint64_t word_at(const unsigned char* bytes) {
  std::uint64_t word;
  std::memcpy(&word, bytes, sizeof word);
  return word;
}

}  // namespace

std::string to_string(const ContentHash& hash) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string text;
  for (const std::uint64_t half : {hash.high, hash.low}) {
    for (int shift = 60; shift >= 0; shift -= 4) text += kDigits[(half >> shift) & 15U];
  }
  return text;
}

void ContentHasher::mix_block(const unsigned char* block) {
  high_ ^= first_word(word_at(block));
  high_ = (rotated(high_, 27) + low_) * 5 + 0x52dce729;
  low_ ^= second_word(word_at(block + 8));
  low_ = (rotated(low_, 31) + high_) * 5 + 0x38495ab5;
}

ContentHasher& ContentHasher::bytes(const void* data, std::size_t size) {
  if (size == 0) return *this;  // data() of an empty vector may be null, and memcpy does not allow null
  const auto* from = static_cast<const unsigned char*>(data);
  const std::size_t waiting = size_ % sizeof tail_;
  size_ += size;
  if (waiting > 0) {
    const std::size_t taken = std::min(size, sizeof tail_ - waiting);
    std::memcpy(tail_ + waiting, from, taken);
    from += taken;
    size -= taken;
    if (waiting + taken < sizeof tail_) return *this;
    mix_block(tail_);
  }
  for (; size >= sizeof tail_; size -= sizeof tail_, from += sizeof tail_) mix_block(from);
  if (size > 0) std::memcpy(tail_, from, size);
  return *this;
}

ContentHasher& ContentHasher::text(std::string_view value) {
  integer(value.size());
  return bytes(value.data(), value.size());
}

ContentHash ContentHasher::finish() const {
  std::uint64_t high = high_, low = low_;
  unsigned char rest[16] = {};
  std::memcpy(rest, tail_, size_ % sizeof rest);
  low ^= second_word(word_at(rest + 8));
  high ^= first_word(word_at(rest));
  high ^= size_;
  low ^= size_;
  high += low;
  low += high;
  high = finished(high);
  low = finished(low);
  high += low;
  low += high;
  return {high, low};
}

}  // namespace loopwise
