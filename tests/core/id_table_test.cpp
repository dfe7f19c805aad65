// SPDX-License-Identifier: BSD-3-Clause
#include <map>

#include <loopwise/core/id_table.hpp>
#include <loopwise/core/random.hpp>

#include "testing.hpp"

namespace loopwise::id_table_test {

TEST_CASE("id table: as a map, through random work", "[core][property]") {
  for (const std::uint64_t spread : {50, 5000, 50000}) {
    CAPTURE(spread);
    Rng rng(spread);
    IdTable<int> table;
    std::map<std::uint64_t, int> map;
    for (int step = 0; step < 20000; ++step) {
      const std::uint64_t id = rng.below(spread) + (rng.below(20) == 0 ? std::uint64_t{1} << 60 : 0);
      const int value = static_cast<int>(rng.below(1000));
      if (rng.below(2) == 0) {
        REQUIRE(table.set(id, value) == map.insert_or_assign(id, value).second);
      } else {
        REQUIRE(table.erase(id) == (map.erase(id) != 0));
      }
      const std::uint64_t other = rng.below(spread);
      const int* found = table.find(other);
      REQUIRE((found != nullptr) == (map.count(other) != 0));
      if (found != nullptr) REQUIRE(*found == map.at(other));
      REQUIRE(table.size() == map.size());
    }
    auto expected = map.begin();
    table.visit([&](std::uint64_t id, int value) {
      REQUIRE(expected != map.end());
      REQUIRE(id == expected->first);
      REQUIRE(value == expected->second);
      ++expected;
      return true;
    });
    REQUIRE(expected == map.end());
    std::size_t visited = 0;
    table.visit([&](std::uint64_t, int) { return ++visited < 3; });
    REQUIRE(visited == std::min<std::size_t>(3, map.size()));

    IdTable<int> moved = std::move(table);
    REQUIRE(moved.size() == map.size());
    moved.clear();
    REQUIRE(moved.empty());
    REQUIRE(moved.set(7, 1));
    REQUIRE(moved.size() == 1);
  }
}

}  // namespace loopwise::id_table_test
