// SPDX-License-Identifier: BSD-3-Clause
// Readers of texts in memory, and the findings of fuzzing them.
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include <loopwise/core/random.hpp>

#include "testing.hpp"
#include "text.hpp"

namespace loopwise::parse_test {
namespace {

TEST_CASE("parse: texts in memory are read like files, under the given name", "[io][parse]") {
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

TEST_CASE("parse: the smallest and the largest stamp are not near", "[io][parse]") {
  const Trajectory early = parse_trajectory("-9.2e9 0 0 0 0 0 0 1\n", "a"),
                   late = parse_trajectory("9.2e9 0 0 0 0 0 0 1\n", "b");
  CHECK_THROWS_AS(associate(early, late, 1e9), InputError);
  CHECK(associate(early, early, 0.0).keys.size() == 1);
  CHECK(associate(late, late, 1e9).keys.size() == 1);
}

TEST_CASE("parse: bytes that are not UTF-8 become legible, other text stays", "[io][parse]") {
  const auto same = [](const std::string& text) {
    CHECK(text::is_utf8(text) == (text::legible(text) == text));
    return text::is_utf8(text);
  };
  CHECK(same(""));
  CHECK(same("plain \x01 %41"));
  CHECK(same("K\xc3\xb6ln \xe2\x82\xac \xf0\x9f\xa4\x96 \xed\x9f\xbf \xf4\x8f\xbf\xbf"));
  CHECK_FALSE(same("K\xf6ln"));
  CHECK_FALSE(same("cut\xe2\x82"));
  CHECK(text::legible("K\xf6ln") == "K%F6ln");
  CHECK(text::legible("\xc3") == "%C3");
  CHECK(text::legible("\xe2\x82x") == "%E2%82x");
  CHECK(text::legible("\xc0\xaf") == "%C0%AF");  // longer than need be
  CHECK(text::legible("\xe0\x80\xaf") == "%E0%80%AF");
  CHECK(text::legible("\xed\xa0\x80") == "%ED%A0%80");         // half of a pair
  CHECK(text::legible("\xf4\x90\x80\x80") == "%F4%90%80%80");  // beyond the last character
  // Held against the JSON library's judgement.
  Rng rng(5);
  for (int i = 0; i < 20000; ++i) {
    std::string text;
    for (std::size_t n = rng.below(6); n > 0; --n) {
      constexpr unsigned char kBytes[] = {0x41, 0x7f, 0x80, 0x8f, 0x90, 0x9f, 0xa0, 0xbf,
                                          0xc0, 0xc1, 0xc2, 0xdf, 0xe0, 0xe1, 0xec, 0xed,
                                          0xee, 0xef, 0xf0, 0xf1, 0xf3, 0xf4, 0xf5};
      text += static_cast<char>(kBytes[rng.below(sizeof kBytes)]);
    }
    bool valid = true;
    try {
      static_cast<void>(Json(text).dump());
    } catch (const Json::type_error&) {
      valid = false;
    }
    CAPTURE(i, text::legible(text));
    REQUIRE(same(text) == valid);
    REQUIRE_NOTHROW(Json(text::legible(text)).dump());
  }
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
}  // namespace loopwise::parse_test
