// SPDX-License-Identifier: BSD-3-Clause
#include "inflate.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr int kLongestCode = 15;

[[noreturn]] void damaged(const char* what) {
  throw InputError(std::string("data compressed by zlib are damaged: ") + what);
}

/// Bits of a stream, the lowest of each byte first.
class Bits {
 public:
  explicit Bits(std::string_view data) : data_(data) {}

  unsigned take(int count) {
    while (held_ < count) {
      if (at_ == data_.size()) damaged("they are cut short");
      bits_ |= static_cast<std::uint32_t>(static_cast<unsigned char>(data_[at_++])) << held_;
      held_ += 8;
    }
    const unsigned out = bits_ & ((1U << count) - 1U);
    bits_ >>= count;
    held_ -= count;
    return out;
  }
  /// Skips the rest of a byte.
  void align() {
    bits_ = 0;
    held_ = 0;
  }
  std::string_view bytes(std::size_t count) {
    if (count > data_.size() - at_) damaged("they are cut short");
    at_ += count;
    return data_.substr(at_ - count, count);
  }

 private:
  std::string_view data_;
  std::size_t at_ = 0;
  std::uint32_t bits_ = 0;
  int held_ = 0;
};

/// A prefix code that is defined by the lengths of its words. Decodes bit by bit.
class PrefixCode {
 public:
  PrefixCode(const std::uint8_t* lengths, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) ++of_length_[lengths[i]];
    of_length_[0] = 0;
    int room = 1;
    for (int length = 1; length <= kLongestCode; ++length) {
      room = room * 2 - of_length_[static_cast<std::size_t>(length)];
      if (room < 0) damaged("a prefix code has too many words");
    }
    std::array<std::uint16_t, kLongestCode + 2> begin{};
    for (std::size_t length = 1; length <= kLongestCode; ++length)
      begin[length + 1] = static_cast<std::uint16_t>(begin[length] + of_length_[length]);
    symbols_.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
      if (lengths[i] != 0) symbols_[begin[lengths[i]]++] = static_cast<std::uint16_t>(i);
    }
  }

  [[nodiscard]] unsigned decode(Bits& bits) const {
    int code = 0, first = 0, index = 0;
    for (std::size_t length = 1; length <= kLongestCode; ++length) {
      code |= static_cast<int>(bits.take(1));
      const int count = of_length_[length];
      if (code - first < count) return symbols_[static_cast<std::size_t>(index + code - first)];
      index += count;
      first = (first + count) * 2;
      code *= 2;
    }
    damaged("unknown code word");
  }

 private:
  std::array<std::uint16_t, kLongestCode + 1> of_length_{};
  std::vector<std::uint16_t> symbols_;
};

class Inflater {
 public:
  Inflater(std::string_view data, std::size_t most) : bits_(data), most_(most) {}

  std::string run() {
    bool last = false;
    while (!last) {
      last = bits_.take(1) != 0;
      switch (bits_.take(2)) {
        case 0:
          copy_stored();
          break;
        case 1:
          copy_fixed();
          break;
        case 2:
          copy_dynamic();
          break;
        default:
          damaged("a block of an unknown kind");
      }
    }
    bits_.align();
    return std::move(out_);
  }
  /// The four bytes after the blocks.
  std::uint32_t checksum() {
    std::uint32_t sum = 0;
    for (const char c : bits_.bytes(4)) sum = sum << 8 | static_cast<unsigned char>(c);
    return sum;
  }

 private:
  void need_room(std::size_t count) const {
    if (count > most_ - out_.size())
      throw InputError("compressed data hold more than the " + std::to_string(most_) +
                       " bytes that they may hold");
  }

  void copy_stored() {
    bits_.align();
    const std::string_view head = bits_.bytes(4);
    const auto byte = [&](std::size_t i) {
      return static_cast<unsigned>(static_cast<unsigned char>(head[i]));
    };
    const unsigned size = byte(0) | byte(1) << 8;
    if ((size ^ (byte(2) | byte(3) << 8)) != 0xffff) damaged("a length and its complement disagree");
    need_room(size);
    out_ += bits_.bytes(size);
  }

  void copy_fixed() {
    std::array<std::uint8_t, 288> lengths{};
    std::fill(lengths.begin(), lengths.begin() + 144, std::uint8_t{8});
    std::fill(lengths.begin() + 144, lengths.begin() + 256, std::uint8_t{9});
    std::fill(lengths.begin() + 256, lengths.begin() + 280, std::uint8_t{7});
    std::fill(lengths.begin() + 280, lengths.end(), std::uint8_t{8});
    std::array<std::uint8_t, 30> distances{};
    distances.fill(5);
    copy_words(PrefixCode(lengths.data(), lengths.size()), PrefixCode(distances.data(), distances.size()));
  }

  void copy_dynamic() {
    constexpr std::array<std::uint8_t, 19> kOrder = {16, 17, 18, 0, 8,  7, 9,  6, 10, 5,
                                                     11, 4,  12, 3, 13, 2, 14, 1, 15};
    const std::size_t literals = bits_.take(5) + 257, distances = bits_.take(5) + 1,
                      written = bits_.take(4) + 4;
    if (literals > 286 || distances > 30) damaged("a prefix code has too many words");
    std::array<std::uint8_t, 19> of_lengths{};
    for (std::size_t i = 0; i < written; ++i)
      of_lengths[kOrder[i]] = static_cast<std::uint8_t>(bits_.take(3));
    const PrefixCode code(of_lengths.data(), of_lengths.size());
    std::array<std::uint8_t, 286 + 30> lengths{};
    for (std::size_t i = 0; i < literals + distances;) {
      const unsigned word = code.decode(bits_);
      if (word < 16) {
        lengths[i++] = static_cast<std::uint8_t>(word);
        continue;
      }
      if (word == 16 && i == 0) damaged("a repeated length has no predecessor");
      const std::uint8_t value = word == 16 ? lengths[i - 1] : std::uint8_t{0};
      const std::size_t times = word == 16   ? 3 + bits_.take(2)
                                : word == 17 ? 3 + bits_.take(3)
                                             : 11 + bits_.take(7);
      if (times > literals + distances - i) damaged("too many lengths");
      std::fill_n(lengths.begin() + static_cast<std::ptrdiff_t>(i), times, value);
      i += times;
    }
    copy_words(PrefixCode(lengths.data(), literals), PrefixCode(lengths.data() + literals, distances));
  }

  void copy_words(const PrefixCode& words, const PrefixCode& distances) {
    constexpr std::array<std::uint16_t, 29> kLength = {3,  4,  5,  6,   7,   8,   9,   10,  11, 13,
                                                       15, 17, 19, 23,  27,  31,  35,  43,  51, 59,
                                                       67, 83, 99, 115, 131, 163, 195, 227, 258};
    constexpr std::array<std::uint8_t, 29> kLengthBits = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2,
                                                          2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0};
    constexpr std::array<std::uint16_t, 30> kDistance = {
        1,   2,   3,   4,   5,   7,    9,    13,   17,   25,   33,   49,   65,    97,    129,
        193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577};
    while (true) {
      const unsigned word = words.decode(bits_);
      if (word == 256) return;
      if (word < 256) {
        need_room(1);
        out_ += static_cast<char>(word);
        continue;
      }
      if (word - 257 >= kLength.size()) damaged("a length is out of range");
      const std::size_t length = kLength[word - 257] + bits_.take(kLengthBits[word - 257]);
      const unsigned far = distances.decode(bits_);
      if (far >= kDistance.size()) damaged("a distance is out of range");
      const std::size_t back = kDistance[far] + bits_.take(far < 2 ? 0 : static_cast<int>(far / 2 - 1));
      if (back > out_.size()) damaged("a distance points before the start of the data");
      need_room(length);
      for (std::size_t i = 0; i < length; ++i) out_ += out_[out_.size() - back];
    }
  }

  Bits bits_;
  std::size_t most_;
  std::string out_;
};

std::uint32_t adler32(std::string_view data) {
  constexpr std::uint32_t kPrime = 65521;
  constexpr std::size_t kSteps = 5552;  // the most steps before the sums exceed 32 bits
  std::uint32_t a = 1, b = 0;
  for (std::size_t at = 0; at < data.size(); at += kSteps) {
    for (const char c : data.substr(at, kSteps)) {
      a += static_cast<unsigned char>(c);
      b += a;
    }
    a %= kPrime;
    b %= kPrime;
  }
  return b << 16 | a;
}

}  // namespace

std::string inflate_zlib(std::string_view data, std::size_t most) {
  if (data.size() < 2) damaged("they are cut short");
  const unsigned method = static_cast<unsigned char>(data[0]), flags = static_cast<unsigned char>(data[1]);
  if ((method & 15U) != 8 || (method << 8 | flags) % 31 != 0) damaged("their zlib header is invalid");
  if ((flags & 32U) != 0) throw InputError("data compressed by zlib need a dictionary, which is missing");
  Inflater inflater(data.substr(2), most);
  std::string out = inflater.run();
  if (inflater.checksum() != adler32(out)) damaged("their checksum is wrong");
  return out;
}

}  // namespace loopwise
