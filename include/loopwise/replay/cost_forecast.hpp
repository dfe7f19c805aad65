// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Computing time of all candidates of a mission on this machine, before or after a run.
#pragma once

#include <cstddef>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Computing time of all candidates, estimated from measured registrations.
struct CostForecast {
  std::size_t candidates = 0;   ///< With a scan at both ends.
  std::size_t measured = 0;     ///< Number of measured registrations.
  double registration_s = 0.0;  ///< Mean of one registration, one thread, s.
  std::size_t scans = 0;        ///< Scans that need preparation, once each.
  double preparation_s = 0.0;   ///< Mean of the preparation of a scan (normals, features), one thread, s.
  double mission_s = 0.0;       ///< Length of the mission.

  /// Time of all candidates on this number of threads, s.
  [[nodiscard]] double all_s(int threads) const {
    return (registration_s * static_cast<double>(candidates) + preparation_s * static_cast<double>(scans)) /
           threads;
  }
  /// Whether all candidates are computed by the end of the mission. Their order then does not matter.
  [[nodiscard]] bool all_in_time(int threads) const { return all_s(threads) <= mission_s; }
};

/// Forecast before a run. Uses candidates by proximity along the mission's odometry, thinned by the options
/// of the engine, and computes a random sample of them on one thread. Odometry drifts, so a run with closures
/// generates slightly different candidates. Candidates by radio are not counted.
/// \param mission with its scans
/// \param options of the run
/// \param sample number of candidates to compute
/// \param stop ends the measurement early; the forecast then uses the registrations done so far
/// \throws OptionError; InputError
[[nodiscard]] LOOPWISE_EXPORT CostForecast forecast_cost(const Mission& mission, const ReplayOptions& options,
                                                         std::size_t sample, const StopToken& stop = {});

/// Forecast after a run, from its candidates with scans and its registrations. Registrations from a store
/// count with the stored time. The mean includes the preparation of scans during these registrations.
[[nodiscard]] LOOPWISE_EXPORT CostForecast forecast_cost(const ReplayResult& result);

/// A sentence for users: "12 500 candidates: 1.9 min on 2 threads, …". Empty if nothing was measured.
[[nodiscard]] LOOPWISE_EXPORT std::string forecast_text(const CostForecast& forecast, int threads);

}  // namespace loopwise
