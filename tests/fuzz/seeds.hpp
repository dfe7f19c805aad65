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

/// By target, always the same: of the readers in io.
[[nodiscard]] Seeds io_seeds();
/// Of those in the components that stand on it.
[[nodiscard]] Seeds replay_seeds();

/// The byte by which a target chooses, then what it chooses for.
[[nodiscard]] inline std::string with_choice(std::size_t choice, const std::string& bytes) {
  return static_cast<char>(choice) + bytes;
}

}  // namespace loopwise::fuzz
