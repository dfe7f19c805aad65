// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/statistics.hpp>

#include "testing.hpp"

namespace loopwise::statistics_test {

TEST_CASE("worlds: corridors constrain motion less than junctions, walls weaken the radio",
          "[simulation][property]") {
  SimulationOptions options;
  options.world = WorldKind::kTunnel;
  options.length_m = 400.0;
  options.scan_points = 400;
  const SensorStatistics s = sensor_statistics(simulate(options, 3));
  REQUIRE(s.corridors.count + s.elsewhere.count == 202);
  REQUIRE(s.corridors.median < 0.7 * s.elsewhere.median);  // 0.40 was measured
  for (std::size_t i = 0; i + 1 < s.power.size(); ++i) {
    const PowerBin &near = s.power[i], &far = s.power[i + 1];
    if (near.walls == far.walls && near.heard > 50 && far.heard > 50) REQUIRE(near.mean_dbm > far.mean_dbm);
  }
}

}  // namespace loopwise::statistics_test
