// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Sensor statistics of a simulated mission: observability of its scans, and received power by distance.
#pragma once

#include <cstddef>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/simulation/simulate.hpp>

namespace loopwise {

/// Quartiles of a sample; NaN if it is empty.
struct ScoreQuartiles {
  std::size_t count = 0;  ///< Scans.
  double low = 0.0;       ///< A quarter lies below.
  double median = 0.0;    ///< Half lies below.
  double high = 0.0;      ///< Three quarters lie below.
};

/// Received power within a range of distances, with or without walls on the way.
struct PowerBin {
  double from_m = 0.0;     ///< Least distance, m.
  double to_m = 0.0;       ///< Largest distance, m.
  bool walls = false;      ///< Whether there are walls between beacon and robot.
  std::size_t heard = 0;   ///< Readings with a received power.
  std::size_t missed = 0;  ///< Readings without.
  double mean_dbm = 0.0;   ///< Mean of the received readings; NaN without readings.
  double sigma_db = 0.0;   ///< Standard deviation of the received readings.
};

/// Sensor statistics of a mission.
struct SensorStatistics {
  /// Observability as in prioritisation: λ_min of Σ HᵀH over the scan with normals from 10 neighbours (paper
  /// §III-C), divided by the mission's largest.
  ScoreQuartiles corridors;
  ScoreQuartiles elsewhere;     ///< Junctions, ends, rooms, halls.
  std::vector<PowerBin> power;  ///< By rising distance, free lines of sight first.
};

/// \throws exceptions of reading the scans.
[[nodiscard]] LOOPWISE_EXPORT SensorStatistics sensor_statistics(const SimulatedMission& made,
                                                                 int threads = 0);

}  // namespace loopwise
