// SPDX-License-Identifier: BSD-3-Clause
// Readers of texts in memory, and what fuzzing them has shown.
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include "testing.hpp"

namespace loopwise {
namespace {

TEST_CASE("parse: texts in memory are read as files are, under the name given", "[io][parse]") {
  CHECK(parse_g2o("VERTEX_SE3:QUAT 7 1 2 3 0 0 0 1\n", "memory").graph.keys() == std::vector<Key>{7});
  CHECK_THROWS_WITH(parse_g2o("FIX\n", "memory"), Contains("memory:1"));
  CHECK(parse_trajectory("1.5 1 2 3 0 0 0 1\n", "memory").stamps_ns == std::vector<std::int64_t>{1500000000});
  CHECK(parse_trajectory("1 0 0 4 0 1 0 5 0 0 1 6\n", "memory").poses[0].translation() ==
        Eigen::Vector3d(4, 5, 6));
  CHECK_THROWS_WITH(parse_trajectory("1 2 3\n", "memory", TrajectoryFormat::kTum), Contains("memory:1"));
  CHECK(parse_transform("1 2 3 0 0 0 1\n", "memory").translation() == Eigen::Vector3d(1, 2, 3));
  CHECK_THROWS_WITH(parse_transform("1 2\n", "memory"), Contains("memory"));
  const CsvTable table = CsvTable::parse("a,b\n1,2\n", "memory", {"a", "b"});
  CHECK(table.integer(0, 1) == 2);
  CHECK_THROWS_WITH(table.fail(0, 1, "why"), Contains("memory:2: column \"b\""));
}

TEST_CASE("parse: quoted CSV values keep blanks at the ends of their lines", "[io][parse]") {
  const std::string value = "first \t\nsecond\r\n third ", empty;
  CsvText csv({"a", "b"});
  csv.row(value, value);
  const CsvTable table = CsvTable::parse(csv.text(), "memory", {"a", "b"});
  REQUIRE(table.size() == 1);
  CHECK(table.text(0, 0) == value);
  CHECK(table.text(0, 1) == value);
  CHECK(CsvTable::parse(CsvText({"a"}).row(empty).text(), "memory", {"a"}).size() == 1);
}

TEST_CASE("parse: stamps with exponents of any length", "[io][parse]") {
  const auto stamp = [](const std::string& word) {
    return parse_trajectory(word + " 0 0 0 0 0 0 1\n", "memory", TrajectoryFormat::kTum).stamps_ns[0];
  };
  CHECK(stamp("5e-99999999999") == 0);
  CHECK(stamp("0." + std::string(500, '0') + "1e501") == 1'000'000'000);
  CHECK(stamp("16e8") == 1'600'000'000'000'000'000);
  CHECK_THROWS_AS(stamp("1" + std::string(400, '0') + "e-10"), ParseError);
}

TEST_CASE("parse: stamps at both ends of time are not near", "[io][parse]") {
  const Trajectory early = parse_trajectory("-9.2e9 0 0 0 0 0 0 1\n", "a"),
                   late = parse_trajectory("9.2e9 0 0 0 0 0 0 1\n", "b");
  CHECK_THROWS_AS(associate(early, late, 1e9), InputError);
  CHECK(associate(early, early, 0.0).keys.size() == 1);
  CHECK(associate(late, late, 1e9).keys.size() == 1);
}

TEST_CASE("parse: JSON numbers out of range and values nested too deep", "[io][parse]") {
  CHECK_THROWS_WITH(parse_json("{\n\"a\": 1e999}", "memory"), "memory:2: number \"1e999\" is out of range");
  CHECK_NOTHROW(parse_json(std::string(200, '[') + std::string(200, ']'), "memory"));
  CHECK_NOTHROW(parse_json(std::string(200, '[') + "1, 2" + std::string(200, ']'), "memory"));
  for (const std::size_t levels : {std::size_t{201}, std::size_t{5000}}) {
    CHECK_THROWS_WITH(parse_json(std::string(levels, '[') + std::string(levels, ']'), "memory"),
                      "memory: nested more than 200 deep");
  }
}

}  // namespace
}  // namespace loopwise
