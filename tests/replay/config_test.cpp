// SPDX-License-Identifier: BSD-3-Clause
#include <map>
#include <string>

#include <loopwise/replay/config.hpp>

#include "testing.hpp"

namespace loopwise::config_test {
namespace {

TEST_CASE("config: every option has a text, that of its own section", "[config]") {
  std::map<std::string, std::string> texts;
  for (const ConfigEntry& entry : describe_config(Config())) {
    CAPTURE(entry.name);
    CHECK_FALSE(entry.doc.empty());
    texts[entry.name] = entry.doc;
  }
  CHECK(texts.at("generation.n_closest") ==
        "Maximum number of candidates of each new node, nearest first. 0: no bound.");
  // Fields of one name in several structs.
  CHECK(texts.at("engine.seed") == "Seed of all random draws.");
  CHECK(texts.at("graph_information.seed") == "Seed of annealing and probes.");
  CHECK(texts.at("fast_registrar.measured_points") == texts.at("pcl_registrar.measured_points"));
}

}  // namespace
}  // namespace loopwise::config_test
