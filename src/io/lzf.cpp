// SPDX-License-Identifier: BSD-3-Clause
#include "lzf.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

namespace loopwise {
namespace {

constexpr std::size_t kMaxLiterals = 32;
constexpr std::size_t kMaxDistance = std::size_t{1} << 13;
constexpr std::size_t kMinCopy = 3;
constexpr std::size_t kMaxCopy = 264;
constexpr int kHashBits = 15;

std::size_t byte(std::string_view in, std::size_t i) {
  return static_cast<unsigned char>(in[i]);
}

}  // namespace

bool lzf_decompress(std::string_view in, std::string& out) {
  std::size_t read = 0, written = 0;
  while (read < in.size()) {
    const std::size_t control = byte(in, read++);
    if (control < kMaxLiterals) {
      const std::size_t count = control + 1;
      if (count > in.size() - read || count > out.size() - written) return false;
      std::memcpy(&out[written], &in[read], count);
      read += count;
      written += count;
      continue;
    }
    std::size_t length = (control >> 5) + 2;
    if (length == 9) {
      if (read == in.size()) return false;
      length += byte(in, read++);
    }
    if (read == in.size()) return false;
    const std::size_t distance = ((control & 31) << 8) + byte(in, read++) + 1;
    if (distance > written || length > out.size() - written) return false;
    // If source and target overlap, copying byte by byte repeats the pattern, as intended.
    if (distance >= length) {
      std::memcpy(&out[written], &out[written - distance], length);
    } else {
      for (std::size_t i = 0; i < length; ++i) out[written + i] = out[written + i - distance];
    }
    written += length;
  }
  return written == out.size();
}

std::string lzf_compress(std::string_view in) {
  constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::vector<std::uint32_t> last(std::size_t{1} << kHashBits,
                                  kNone);  // last position of each hash of three bytes
  std::string out;
  out.reserve(in.size() + in.size() / kMaxLiterals + 1);
  std::size_t literals = 0;  // start of the bytes that are not written yet
  const auto flush = [&](std::size_t end) {
    while (literals < end) {
      const std::size_t count = std::min(end - literals, kMaxLiterals);
      out += static_cast<char>(count - 1);
      out.append(in, literals, count);
      literals += count;
    }
  };

  std::size_t at = 0;
  while (at + kMinCopy <= in.size()) {
    const std::size_t three = byte(in, at) << 16 | byte(in, at + 1) << 8 | byte(in, at + 2);
    std::uint32_t& slot = last[static_cast<std::uint32_t>(three * 2654435761u) >> (32 - kHashBits)];
    const std::size_t match = slot;
    slot = static_cast<std::uint32_t>(at);
    if (match == kNone || at - match > kMaxDistance || in.compare(match, kMinCopy, in, at, kMinCopy) != 0) {
      ++at;
      continue;
    }
    const std::size_t longest = std::min(in.size() - at, kMaxCopy);
    std::size_t length = kMinCopy;
    while (length < longest && in[match + length] == in[at + length]) ++length;
    flush(at);
    const std::size_t distance = at - match - 1, code = length - 2;
    out += static_cast<char>(std::min<std::size_t>(code, 7) << 5 | distance >> 8);
    if (code >= 7) out += static_cast<char>(code - 7);
    out += static_cast<char>(distance & 255);
    at += length;
    literals = at;
  }
  flush(in.size());
  return out;
}

}  // namespace loopwise
