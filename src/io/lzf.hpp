// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The LZF coding of PCD's binary_compressed data. A byte below 32 is followed by that many literals plus
/// one. Any other byte starts a copy: its top three bits are the length minus two (7: the next byte is
/// added), and its low five bits with the next byte are the distance minus one. Private to io.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace loopwise {

/// Fills `out`, whose size is the expected one. \returns false if the data are damaged or decode to another
/// size.
[[nodiscard]] bool lzf_decompress(std::string_view in, std::string& out);

/// Compresses the input. The output has at most 33/32 of its size plus one byte.
[[nodiscard]] std::string lzf_compress(std::string_view in);

/// The largest output of compressed data of this size: three bytes expand to at most 264.
[[nodiscard]] constexpr std::size_t lzf_largest_output(std::size_t compressed) {
  return compressed * 88;
}

}  // namespace loopwise
