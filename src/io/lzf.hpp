// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The LZF coding of PCD's binary_compressed data: a byte below 32 announces that many literals plus one;
/// else its top three bits are a copy's length minus two (7: one more byte to add) and the low five with the
/// next byte its distance minus one. Private to io.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace loopwise {

/// Fills `out`, whose size is the expected one. \returns false if the data are damaged or decode to another
/// size.
[[nodiscard]] bool lzf_decompress(std::string_view in, std::string& out);

/// Never longer than 33/32 of the input plus one.
[[nodiscard]] std::string lzf_compress(std::string_view in);

/// The most bytes that compressed data of this size can hold: three bytes stand for up to 264.
[[nodiscard]] constexpr std::size_t lzf_largest_output(std::size_t compressed) {
  return compressed * 88;
}

}  // namespace loopwise
