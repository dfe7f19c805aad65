// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(json, bytes) {
  using namespace loopwise;
  const auto json = fuzz::attempt([&] { return parse_json(bytes, "fuzz.json"); });
  if (!json) return;
  const Json copy = *json;
  fuzz::expect(parse_json(copy.dump(), "again.json") == copy, "written and read again: the same");
}
