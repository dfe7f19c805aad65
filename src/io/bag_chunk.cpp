// SPDX-License-Identifier: BSD-3-Clause
#include <bzlib.h>
#include <roslz4/lz4s.h>

#include <algorithm>
#include <cstring>

#include <loopwise/core/error.hpp>

#include "bag_check.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

constexpr const char* kDamagedChunk = "compressed data are damaged";

std::uint32_t little_endian(std::string_view bytes) {
  std::uint32_t value = 0;
  for (int i = 3; i >= 0; --i)
    value = value << 8 | static_cast<unsigned char>(bytes[static_cast<std::size_t>(i)]);
  return value;
}

std::string inflate_bz2_chunk(std::string_view data, std::size_t size) {
  bz_stream stream{};
  if (BZ2_bzDecompressInit(&stream, 0, 0) != BZ_OK) throw InputError("bz2 data cannot be decompressed");
  struct End {
    bz_stream* stream;
    ~End() { BZ2_bzDecompressEnd(stream); }
  } const end{&stream};
  // The library does not write to its input; its declaration only lacks const.
  stream.next_in = const_cast<char*>(data.data());
  stream.avail_in = static_cast<unsigned>(data.size());
  std::string out;
  while (true) {
    const std::size_t filled = out.size();
    // The space doubles, up to one byte more than `size`, so that a wrong size is detected.
    const std::size_t room = std::min(size + 1 - filled, std::max<std::size_t>(filled, 1 << 20));
    out.resize(filled + room);
    stream.next_out = out.data() + filled;
    stream.avail_out = static_cast<unsigned>(room);
    const int result = BZ2_bzDecompress(&stream);
    out.resize(filled + room - stream.avail_out);
    if (result == BZ_STREAM_END) break;
    if (result != BZ_OK || out.size() > size || (stream.avail_in == 0 && stream.avail_out > 0)) {
      throw InputError(kDamagedChunk);
    }
  }
  if (out.size() != size || stream.avail_in != 0) throw InputError(kDamagedChunk);
  return out;
}

/// The decoder copies a block into a buffer of the size in the frame's header without a comparison of the
/// two, so the frame is checked here first.
void check_lz4_frame(std::string_view data) {
  constexpr std::size_t kHeader = 7, kSize = 4, kChecksum = 4;
  if (data.size() < kHeader + kSize + kChecksum) throw InputError(kDamagedChunk);
  const auto largest_id = static_cast<unsigned char>(data[5]) >> 4 & 7;
  if (little_endian(data) != 0x184D2204 || largest_id < 4) throw InputError(kDamagedChunk);
  const std::size_t largest = std::size_t{1} << (8 + 2 * largest_id);  // 4: 64 kB, 7: 4 MB
  std::string_view rest = data.substr(kHeader);
  while (true) {
    if (rest.size() < kSize) throw InputError(kDamagedChunk);
    const std::size_t block = little_endian(rest) & 0x7FFFFFFF;
    rest.remove_prefix(kSize);
    if (block == 0) break;
    if (block > largest || block > rest.size()) throw InputError(kDamagedChunk);
    rest.remove_prefix(block);
  }
  if (rest.size() != kChecksum) throw InputError(kDamagedChunk);
}

std::string inflate_lz4_chunk(std::string_view data, std::size_t size) {
  check_lz4_frame(data);
  // One byte of lz4 expands to at most 255 bytes.
  if (size / 255 > data.size()) throw InputError(kDamagedChunk);
  std::string in(data), out(size, '\0');
  char none = 0;
  auto filled = static_cast<unsigned>(size);
  const int result = roslz4_buffToBuffDecompress(in.data(), static_cast<unsigned>(in.size()),
                                                 size > 0 ? out.data() : &none, &filled);
  if (result != ROSLZ4_OK || filled != size) throw InputError(kDamagedChunk);
  return out;
}

}  // namespace

std::string inflate_chunk(std::string_view compression, std::string_view data, std::size_t size) {
  if (compression == "none") {
    if (data.size() != size) {
      throw InputError(std::to_string(data.size()) + " bytes, its header says " + std::to_string(size));
    }
    return std::string(data);
  }
  if (compression == "bz2") return inflate_bz2_chunk(data, size);
  if (compression == "lz4") return inflate_lz4_chunk(data, size);
  throw InputError("unknown compression " + text::quoted(compression) + ", expected none, bz2 or lz4");
}

}  // namespace loopwise::bags
