// SPDX-License-Identifier: BSD-3-Clause
// The first byte chooses: a configuration file, the text of --set, or a list of robots.
#include <loopwise/core/robots.hpp>
#include <loopwise/replay/config.hpp>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(config, bytes) {
  using namespace loopwise;
  const std::size_t choice = fuzz::take_choice(bytes, 3);
  if (choice == 2) {
    const auto robots = fuzz::attempt([&] { return parse_robots(bytes); });
    for (std::size_t r = 0; robots && r < robots->size(); ++r) {
      fuzz::expect((*robots)[r].first <= (*robots)[r].last, "keys of a robot ascend");
      fuzz::expect(robots->of((*robots)[r].first) == r, "a robot owns its keys");
    }
    return;
  }
  static const std::string before = config_json(Config());
  Config config;
  const auto read = fuzz::attempt([&] {
    if (choice == 0) parse_config(bytes, "fuzz.json", config);
    if (choice == 1) set_config_option(std::string(bytes), config);
    return true;
  });
  if (!read) {
    if (fuzz::one_in(16, bytes)) {
      fuzz::expect(config_json(config) == before, "an error leaves the configuration as it was");
    }
    return;
  }
  if (choice == 1 && !fuzz::attempt([&] {
        validate_config(config);
        return true;
      })) {
    return;  // relations between options are checked once all are set
  }
  const std::string text = config_json(config);
  Config again;
  parse_config(text, "again.json", again);
  fuzz::expect(config_json(again) == text, "written and read again: the same");
  fuzz::expect(!describe_config(config).empty(), "every option can be described");
}
