// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <map>

#include <loopwise/core/random.hpp>

#include "place_pairs.hpp"
#include "testing.hpp"

namespace loopwise::place_pairs_test {

TEST_CASE("expected: pairs of places have one number, whichever comes first", "[prioritization][expected]") {
  detail::PlacePairs pairs;
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> numbers;
  Rng rng(9);
  for (int i = 0; i < 20000; ++i) {
    const auto a = static_cast<std::uint32_t>(rng.below(80)), b = static_cast<std::uint32_t>(rng.below(80));
    const std::pair<std::uint32_t, std::uint32_t> key = std::minmax(a, b);
    const auto known = numbers.find(key);
    const std::uint32_t* const found = pairs.find(a, b);
    REQUIRE((found != nullptr) == (known != numbers.end()));
    if (found != nullptr) REQUIRE(*found == known->second);
    numbers.emplace(key, static_cast<std::uint32_t>(numbers.size()));
    REQUIRE(pairs.number_of(b, a) == numbers.at(key));
    REQUIRE(pairs.size() == numbers.size());
  }
}

}  // namespace loopwise::place_pairs_test
