// SPDX-License-Identifier: BSD-3-Clause
// Lists of edges by their ends.
#include "key_pairs.hpp"

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(key_pairs, bytes) {
  using namespace loopwise;
  const auto pairs = fuzz::attempt([&] { return parts::parse_key_pairs(std::string(bytes), "pairs"); });
  if (!pairs) return;
  std::string text;
  for (const auto& [from, to] : *pairs) text += std::to_string(from) + "," + std::to_string(to) + "\n";
  fuzz::expect(parts::parse_key_pairs(text, "again") == *pairs, "written and read again: the same");
}
