// SPDX-License-Identifier: BSD-3-Clause
// The file `data` of a key frame that hdl_graph_slam saved.
#include "checks.hpp"
#include "hdl_graph_slam.hpp"
#include "target.hpp"

LOOPWISE_FUZZ_TARGET(key_frame, bytes) {
  using namespace loopwise;
  Problems problems;
  const auto data = fuzz::attempt([&] { return parse_key_frame_data("data", bytes, problems); });
  if (!data) return;
  fuzz::check_problems(problems);
  fuzz::expect(problems.all().size() <= 5, "problems are of few kinds");
  if (data->stamp_ns) fuzz::expect(parts::stamp_in_range(*data->stamp_ns), "stamps are in range");
}
