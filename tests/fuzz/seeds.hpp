// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Seeds of fuzzing: small inputs of every target, made by the library's own writers.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace loopwise::fuzz {

/// Name and bytes.
using Seed = std::pair<std::string, std::string>;

using Seeds = std::map<std::string, std::vector<Seed>>;

/// Seeds by target for the readers in io, always the same.
[[nodiscard]] Seeds io_seeds();
/// Seeds for the readers in the components above io.
[[nodiscard]] Seeds replay_seeds();

/// A seed for a target that chooses by its first byte: this byte, then the other bytes.
[[nodiscard]] inline std::string with_choice(std::size_t choice, const std::string& bytes) {
  return static_cast<char>(choice) + bytes;
}

}  // namespace loopwise::fuzz
