// SPDX-License-Identifier: BSD-3-Clause
#include "decompress.hpp"

#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <new>

#include <loopwise/core/error.hpp>

#include "raw_file.hpp"

namespace loopwise::bags {
namespace {

constexpr const char* kDamaged = "compressed data are damaged";
constexpr std::size_t kStep = std::size_t{1} << 20;
constexpr int kLargestWindow = 26;  // 64 MiB

struct ZstdStream {
  struct Free {
    void operator()(ZSTD_DCtx* freed) const { ZSTD_freeDCtx(freed); }
  };
  std::unique_ptr<ZSTD_DCtx, Free> context{ZSTD_createDCtx()};
  std::size_t hint = 1;  // 0 at the end of a frame

  ZstdStream() {
    if (!context) throw std::bad_alloc();
    ZSTD_DCtx_setParameter(context.get(), ZSTD_d_windowLogMax, kLargestWindow);
  }
  void run(ZSTD_outBuffer& out, ZSTD_inBuffer& in) {
    hint = ZSTD_decompressStream(context.get(), &out, &in);
    if (ZSTD_isError(hint)) throw InputError(std::string(kDamaged) + ": " + ZSTD_getErrorName(hint));
  }
};

/// Calls `step(room, size)` until the data end. It fills at most `size` bytes and returns how many, and
/// whether the data end.
template <class Step>
std::string grow(std::size_t most, Step&& step) {
  std::string out;
  while (true) {
    const std::size_t filled = out.size();
    // The space doubles, up to one byte more than `most`, so that too much data is detected.
    const std::size_t room = std::min(most + 1 - filled, std::max(filled, kStep));
    out.resize(filled + room);
    const auto [added, ended] = step(out.data() + filled, room);
    out.resize(filled + added);
    if (out.size() > most)
      throw InputError("unpacks to more than the allowed " + std::to_string(most) + " bytes");
    if (ended) return out;
  }
}

}  // namespace

bool is_zstd(std::string_view bytes) {
  return bytes.substr(0, 4) == "\x28\xb5\x2f\xfd";
}

std::string inflate_zstd(std::string_view data, std::size_t most) {
  ZstdStream stream;
  ZSTD_inBuffer in{data.data(), data.size(), 0};
  return grow(most, [&](char* room, std::size_t size) {
    ZSTD_outBuffer out{room, size, 0};
    stream.run(out, in);
    const bool read_all = in.pos == in.size;
    if (read_all && stream.hint != 0 && out.pos < out.size) throw InputError("compressed data are cut short");
    return std::make_pair(out.pos, read_all && stream.hint == 0);
  });
}

std::string inflate_lz4(std::string_view data, std::size_t most) {
  LZ4F_dctx* made = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&made, LZ4F_VERSION))) throw std::bad_alloc();
  const std::unique_ptr<LZ4F_dctx, LZ4F_errorCode_t (*)(LZ4F_dctx*)> context(made,
                                                                             LZ4F_freeDecompressionContext);
  return grow(most, [&](char* room, std::size_t size) {
    std::size_t filled = 0, hint = 1;
    while (filled < size && hint != 0 && !data.empty()) {
      std::size_t out = size - filled, in = data.size();
      hint = LZ4F_decompress(context.get(), room + filled, &out, data.data(), &in, nullptr);
      if (LZ4F_isError(hint)) throw InputError(std::string(kDamaged) + ": " + LZ4F_getErrorName(hint));
      if (in == 0 && out == 0) break;
      filled += out;
      data.remove_prefix(in);
    }
    if (hint == 0 && !data.empty()) throw InputError(kDamaged);
    if (hint != 0 && data.empty() && filled < size) throw InputError("compressed data are cut short");
    return std::make_pair(filled, hint == 0);
  });
}

void inflate_zstd_file(const std::filesystem::path& from, const std::string& name,
                       const std::filesystem::path& to, const StopToken& stop) {
  constexpr std::uint64_t kLargestGrowth = 1000;
  const RawFile file(from);
  std::ofstream target(to, std::ios::binary);
  ZstdStream stream;
  std::string piece, unpacked(kStep, '\0');
  std::uint64_t written = 0;
  for (std::uint64_t at = 0; at < file.size(); at += piece.size()) {
    if (stop.stop_requested()) throw StoppedError("unpacking " + name + " was stopped");
    file.read(at, static_cast<std::size_t>(std::min<std::uint64_t>(kStep, file.size() - at)), piece);
    ZSTD_inBuffer in{piece.data(), piece.size(), 0};
    for (bool full = false; in.pos < in.size || full;) {
      ZSTD_outBuffer out{unpacked.data(), unpacked.size(), 0};
      try {
        stream.run(out, in);
      } catch (const InputError& error) {
        throw InputError(name + ": byte " + std::to_string(at + in.pos) + ": " + error.what());
      }
      full = out.pos == out.size;
      written += out.pos;
      if (written > kLargestGrowth * file.size() + kStep) {
        throw InputError(name + ": unpacks to more than " + std::to_string(kLargestGrowth) +
                         " times its size, which no recording does: the file is damaged");
      }
      if (std::filesystem::space(to.parent_path()).available < out.pos) {
        throw InputError(name + ": the unpacked file is larger than the free space in " +
                         to.parent_path().string() +
                         ": set TMPDIR to a larger disk, or unpack it there with zstd -d");
      }
      target.write(unpacked.data(), static_cast<std::streamsize>(out.pos));
      if (!target) throw IoError(to.string(), "cannot be written");
    }
  }
  if (stream.hint != 0) throw InputError(name + ": compressed data are cut short");
  target.close();
  if (!target) throw IoError(to.string(), "cannot be written");
}

}  // namespace loopwise::bags
