// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/error.hpp>
#include <loopwise/io/decisions.hpp>

#include "testing.hpp"

namespace loopwise::decisions_test {

using Catch::Matchers::Contains;

TEST_CASE("decisions.csv: written rows are read back", "[io][decisions]") {
  const testing::TemporaryFolder folder;
  const std::vector<ClosureDecision> decisions{{1, 5, true}, {make_key('a', 7), make_key('b', 2), false}};
  testing::write_text(folder / "decisions.csv", decisions_csv(decisions) + "\na3, b4 ,reject\n5,1,accept\n");
  const std::vector<ClosureDecision> read = read_decisions(folder / "decisions.csv");
  REQUIRE(read.size() == 3);  // the last line repeats the first
  for (std::size_t i = 0; i < 2; ++i) {
    REQUIRE(read[i].from == decisions[i].from);
    REQUIRE(read[i].to == decisions[i].to);
    REQUIRE(read[i].accepted == decisions[i].accepted);
  }
  REQUIRE((read[2].from == make_key('a', 3) && read[2].to == make_key('b', 4) && !read[2].accepted));
}

TEST_CASE("decisions.csv: errors name the line", "[io][decisions][error]") {
  const testing::TemporaryFolder folder;
  const auto read = [&](const std::string& rows) {
    testing::write_text(folder / "decisions.csv", "from,to,decision\n" + rows);
    return read_decisions(folder / "decisions.csv");
  };
  REQUIRE_THROWS_WITH(read("1,2,accept\n1,3,maybe\n"),
                      Contains("decisions.csv:3") && Contains("\"maybe\" is neither accept nor reject"));
  REQUIRE_THROWS_WITH(read("1,2,accept\n3,4,reject\n2,1,reject\n"),
                      Contains("decisions.csv:4") && Contains("line 2 has the opposite decision"));
  REQUIRE_THROWS_WITH(read("1,?,accept\n"), Contains("decisions.csv:2"));
  REQUIRE_THROWS_AS(read("1,2\n"), ParseError);
  REQUIRE_THROWS_AS(read_decisions(folder / "missing.csv"), IoError);
}

}  // namespace loopwise::decisions_test
