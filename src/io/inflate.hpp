// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Data that zlib compressed (RFC 1950 and 1951). Private to io.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace loopwise {

/// Decompresses the stream. Memory grows with the output, not with the stated size.
/// \throws InputError if it is damaged or cut short, needs a preset dictionary, or holds more than `most`
/// bytes
[[nodiscard]] std::string inflate_zlib(std::string_view data, std::size_t most);

}  // namespace loopwise
