// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/statistics.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/kd_tree.hpp>
#include <loopwise/features/normals.hpp>
#include <loopwise/features/observability.hpp>

#include "../core/constants.hpp"

namespace loopwise {
namespace {

ScoreQuartiles quartiles(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const auto at = [&values](double share) {
    if (values.empty()) return kNan;
    return values[static_cast<std::size_t>(std::lround(share * static_cast<double>(values.size() - 1)))];
  };
  return {values.size(), at(0.25), at(0.5), at(0.75)};
}

}  // namespace

SensorStatistics sensor_statistics(const SimulatedMission& made, int threads) {
  SensorStatistics result;
  const auto& nodes = made.mission.graph.nodes();
  std::vector<double> score(nodes.size(), 0.0);
  ThreadPool pool(threads);
  pool.for_each(nodes.size(), [&](std::size_t i) {
    const auto cloud = made.mission.scans->load(nodes[i].key);
    if (!cloud || cloud->size() < 10) return;
    PointCloud with_normals{cloud->points, estimate_normals(cloud->points, KdTree(cloud->points), 10), {}};
    score[i] = observability(with_normals).min_eigenvalue;
  });
  const double largest = score.empty() ? 0.0 : *std::max_element(score.begin(), score.end());
  std::vector<double> corridors, elsewhere;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    (made.in_corridor[i] ? corridors : elsewhere).push_back(largest > 0.0 ? score[i] / largest : 0.0);
  }
  result.corridors = quartiles(std::move(corridors));
  result.elsewhere = quartiles(std::move(elsewhere));

  const std::array<double, 9> edges{0.0, 5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0};
  for (const bool walls : {false, true}) {
    for (std::size_t e = 1; e < edges.size(); ++e) {
      PowerBin bin;
      bin.from_m = edges[e - 1];
      bin.to_m = edges[e];
      bin.walls = walls;
      double sum = 0.0, squares = 0.0;
      for (std::size_t i = 0; i < made.readings.size(); ++i) {
        const ReadingTruth& truth = made.readings[i];
        if (truth.distance_m < bin.from_m || truth.distance_m >= bin.to_m || (truth.walls > 0) != walls)
          continue;
        const double power = made.mission.radio[i].receive_dbm;
        if (std::isnan(power)) {
          ++bin.missed;
          continue;
        }
        ++bin.heard;
        sum += power;
        squares += power * power;
      }
      const auto count = static_cast<double>(bin.heard);
      bin.mean_dbm = bin.heard > 0 ? sum / count : kNan;
      bin.sigma_db =
          bin.heard > 0 ? std::sqrt(std::max(0.0, squares / count - bin.mean_dbm * bin.mean_dbm)) : kNan;
      result.power.push_back(bin);
    }
  }
  return result;
}

}  // namespace loopwise
