// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/json_options.hpp>

#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include <loopwise/io/mission.hpp>

#include "testing.hpp"

namespace loopwise::json_options_test {
namespace {

enum class Colour { kRed, kGreen };
EnumNames<Colour> enum_names(Colour) {
  return {{Colour::kRed, "red"}, {Colour::kGreen, "green"}};
}

struct Everything {
  bool flag = false;
  int count = 3;
  std::uint64_t seed = 1;
  double rate_m = 0.2;
  double limit_m = std::numeric_limits<double>::infinity();
  std::string label = "a \"b\"";
  Colour colour = Colour::kRed;
  std::vector<double> sigmas = {0.1, 0.2};

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("flag", self.flag, any_value(), "A flag.");
    field("count", self.count, at_least(1), "A count.");
    field("seed", self.seed, any_value(), "A seed.");
    field("rate_m", self.rate_m, above(0.0), "A rate, m.");
    field("limit_m", self.limit_m, above(0.0), "A limit, m.");
    field("label", self.label, any_value(), "A label.");
    field("colour", self.colour, any_value(), "A colour.");
    field("sigmas", self.sigmas, above(0.0), "Sigmas.");
  }
};

/// As another project writes it: texts are given to visit(), and a part of this library has its own.
struct StationOptions {
  double reach_m = 5.0;
  int retries = 0;
  MissionOptions mission;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("reach_m", self.reach_m, above(0.0), "Reach of the radio, m.");
    field("retries", self.retries, at_least(0));
    visit_part(self.mission, field);
  }
};

namespace other {
struct MissionOptions {
  double scan_cache_mb = 1.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("scan_cache_mb", self.scan_cache_mb, any_value());
  }
};
}  // namespace other

template <class Options>
std::string text_of(const std::string& field) {
  for (const OptionDescription& option : describe(Options())) {
    if (option.name == field) return option.doc;
  }
  return "no such field";
}

Everything apply(const std::string& text) {
  Everything options;
  apply_json(parse_json(text, "c.json"), "all", options);
  return options;
}

TEST_CASE("options: JSON gives back every kind of field", "[io][options]") {
  Everything options;
  options.flag = true;
  options.count = -0 + 7;
  options.seed = ~std::uint64_t{0};
  options.rate_m = 0.1 + 0.2;
  options.colour = Colour::kGreen;
  options.sigmas = {1e-300, 2};
  Everything back;
  apply_json(parse_json(to_json(options).dump(), "c.json"), "all", back);
  CHECK(back.flag);
  CHECK(back.count == 7);
  CHECK(back.seed == options.seed);
  CHECK(back.rate_m == options.rate_m);
  CHECK(std::isinf(back.limit_m));
  CHECK(back.label == options.label);
  CHECK(back.colour == Colour::kGreen);
  CHECK(back.sigmas == options.sigmas);
  CHECK(to_json(options).begin().key() == "flag");  // the order of declaration
}

TEST_CASE("options: missing fields keep their values", "[io][options]") {
  const Everything options = apply("{\"rate_m\": 2, // whole numbers are numbers\n \"sigmas\": []}");
  CHECK(options.rate_m == 2.0);
  CHECK(options.count == 3);
  CHECK(options.sigmas.empty());
}

TEST_CASE("options: errors name section and key, and change nothing", "[io][options][error]") {
  struct Bad {
    std::string text;
    std::string message;
  };
  const Bad bad = GENERATE(values<Bad>({
      {"{\"rate\": 1}",
       "unknown option all.rate, did you mean all.rate_m? Known: all.flag, all.count, all.seed"},
      {"{\"zzzzzzzz\": 1}", "unknown option all.zzzzzzzz; known: all.flag"},
      {"{\"rate_m\": \"fast\"}", "all.rate_m = \"fast\", must be a number"},
      {"{\"rate_m\": 0}", "all.rate_m = 0, must be > 0"},
      {"{\"rate_m\": \"nan\"}", "all.rate_m = nan, must be a number"},
      {"{\"rate_m\": null}", "all.rate_m = null, must be a number"},
      {"{\"count\": 0}", "all.count = 0, must be >= 1"},
      {"{\"count\": 1.5}", "all.count = 1.5, must be a whole number in [-2147483648, 2147483647]"},
      {"{\"count\": 3000000000}", "all.count = 3000000000, must be a whole number"},
      {"{\"count\": 18446744073709551615}", "must be a whole number"},
      {"{\"count\": true}", "all.count = true, must be a whole number"},
      {"{\"seed\": -1}", "all.seed = -1, must be a whole number in [0, 18446744073709551615]"},
      {"{\"flag\": 1}", "all.flag = 1, must be true or false"},
      {"{\"label\": 1}", "all.label = 1, must be text in quotes"},
      {"{\"colour\": \"blue\"}", "all.colour = \"blue\", must be one of: red, green"},
      {"{\"sigmas\": 1}", "all.sigmas = 1, must be a list of numbers"},
      {"{\"sigmas\": [1, \"x\"]}", "all.sigmas = \"x\", must be a number"},
      {"{\"sigmas\": [1, -1]}", "all.sigmas = -1, must be > 0"},
      {"[1]", "all = [1], must be an object"},
  }));
  CAPTURE(bad.text);
  Everything options;
  CHECK_THROWS_AS(apply_json(parse_json(bad.text, "c"), "all", options), OptionError);
  CHECK_THROWS_WITH(apply_json(parse_json(bad.text, "c"), "all", options), Contains(bad.message));
  CHECK_THROWS_AS(apply_json(parse_json("{\"flag\": true, \"count\": 0}", "c"), "all", options), OptionError);
  CHECK_FALSE(options.flag);
}

TEST_CASE("options: set from a command line", "[io][options]") {
  Everything options;
  set_option("all", "flag", "true", options);
  set_option("all", "count", "12", options);
  set_option("all", "seed", "18446744073709551615", options);
  set_option("all", "rate_m", "3e-1", options);
  set_option("all", "label", "x, y", options);
  set_option("all", "colour", "green", options);
  set_option("all", "sigmas", "1, 2,3", options);
  CHECK(options.flag);
  CHECK(options.count == 12);
  CHECK(options.seed == ~std::uint64_t{0});
  CHECK(options.rate_m == 0.3);
  CHECK(options.label == "x, y");
  CHECK(options.colour == Colour::kGreen);
  CHECK(options.sigmas == std::vector<double>{1, 2, 3});
  CHECK_THROWS_WITH(set_option("all", "rate", "1", options), Contains("did you mean all.rate_m?"));
  CHECK_THROWS_WITH(set_option("all", "rate_m", "-1", options), "all.rate_m = -1, must be > 0");
  CHECK_THROWS_WITH(set_option("all", "rate_m", "1x", options), "all.rate_m = \"1x\", must be a number");
  CHECK_THROWS_WITH(set_option("all", "count", "1.5", options), Contains("must be a whole number"));
  CHECK_THROWS_WITH(set_option("all", "flag", "yes", options), Contains("must be true or false"));
  CHECK(options.rate_m == 0.3);
}

TEST_CASE("options: described for people", "[io][options]") {
  const auto all = describe(Everything{});
  REQUIRE(all.size() == 8);
  CHECK(all[1].name == "count");
  CHECK(all[1].type == "integer");
  CHECK(all[1].default_value == "3");
  CHECK(all[1].bounds == ">= 1");
  CHECK(all[1].doc == "A count.");
  CHECK(all[0].bounds.empty());
  CHECK(all[4].default_value == "\"inf\"");
  CHECK(all[5].type == "text");
  CHECK(all[6].bounds == "one of: red, green");
  CHECK(all[6].default_value == "\"red\"");
  CHECK(all[7].default_value == "[0.1,0.2]");
}

TEST_CASE("options: texts are the comments above the fields", "[io][options]") {
  CHECK(text_of<MissionOptions>("scan_cache_mb") == "Memory for scans that are kept after use, MB.");
  // A comment of several lines, with quotes.
  CHECK_THAT(text_of<MissionOptions>("robots"),
             Contains("Robots and their keys, such as \"0-624,625-1249\" or") &&
                 Contains(" one robot per character of the keys."));
  for (const OptionDescription& option : describe(MissionOptions())) {
    CAPTURE(option.name);
    CHECK_FALSE(option.doc.empty());
  }
}

TEST_CASE("options: structs of other projects", "[io][options]") {
  CHECK(text_of<StationOptions>("reach_m") == "Reach of the radio, m.");
  CHECK(text_of<StationOptions>("retries").empty());
  CHECK(text_of<StationOptions>("scan_cache_mb") == text_of<MissionOptions>("scan_cache_mb"));
  CHECK(text_of<other::MissionOptions>("scan_cache_mb").empty());  // another struct of the same name

  StationOptions options;
  apply_json(parse_json("{\"retries\": 2, \"scan_cache_mb\": 7}", "c"), "station", options);
  set_option("station", "node_interval_s", "3", options);
  CHECK(options.retries == 2);
  CHECK(options.mission.scan_cache_mb == 7.0);
  CHECK(options.mission.node_interval_s == 3.0);
  CHECK_THROWS_WITH(set_option("station", "scan_cache_mb", "-1", options),
                    "station.scan_cache_mb = -1, must be >= 0");
  options.mission.node_interval_s = 0.0;
  CHECK_THROWS_WITH(validate(options), "node_interval_s = 0, must be > 0");
}

TEST_CASE("json: errors name the line", "[io][options][error]") {
  CHECK_THROWS_WITH(parse_json("{\n\"a\": 1,\n\"b\" 2}", "c.json"), Contains("c.json:3: "));
  CHECK_THROWS_WITH(parse_json("", "c.json"), Contains("c.json:1: "));
  CHECK_THROWS_WITH(parse_json("{\"a\": {\"b\": 1,\n\"c\": 2,\n\"b\": 3}}", "c.json"),
                    Contains("c.json:3: key \"b\" is repeated"));
  CHECK_NOTHROW(
      parse_json("{\"a\": {\"b\": 1}, \"b\": {\"a\": 1}, \"c\": [{\"a\": 1}, {\"a\": 2}]}", "c.json"));
  const testing::TemporaryFolder folder;
  testing::write_text(folder / "x.json", "{\"a\":");
  CHECK_THROWS_WITH(read_json_file(folder / "x.json"), Contains("x.json:1: "));
  CHECK_THROWS_AS(read_json_file(folder / "none.json"), IoError);
}

}  // namespace
}  // namespace loopwise::json_options_test
