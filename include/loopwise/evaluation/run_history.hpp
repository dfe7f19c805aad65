// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// History of a replay: candidates, closures and errors over mission time (the paper's Figs. 5 and 6).
#pragma once

#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/evaluation/closure_statistics.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// A run at one moment of mission time. Counts are since the start.
struct HistoryRow {
  double mission_time_s = 0.0;    ///< When the row was taken.
  std::size_t key_frames = 0;     ///< Arrived.
  std::size_t generated = 0;      ///< Candidates proposed.
  std::size_t queued = 0;         ///< Candidates that were not pruned.
  std::size_t computed = 0;       ///< Candidates with a result.
  std::size_t verified = 0;       ///< Candidates that became closures.
  std::size_t gnc_inliers = 0;    ///< Verified, and kept by the last optimisation.
  std::size_t true_inliers = 0;   ///< Verified, and within the bounds of the truth.
  std::size_t right_inliers = 0;  ///< GNC inliers that are true inliers.
  /// Mean error of the positions of all nodes that have arrived, common frame, no alignment, m: by the
  /// estimate, and by odometry alone. NaN without ground truth in that frame.
  double ate_m = std::numeric_limits<double>::quiet_NaN();
  double odometry_ate_m = std::numeric_limits<double>::quiet_NaN();  ///< The same by odometry.
};

/// Collects the rows: one after each batch, and every 10 s of mission time without the end of a batch. Call
/// add() from ReplayHooks::moment.
class LOOPWISE_EXPORT RunHistory {
 public:
  /// `mission` must outlive it. \throws OptionError
  explicit RunHistory(const Mission& mission, const ClosureClassOptions& options = {});
  RunHistory(const Mission&&, const ClosureClassOptions& = {}) = delete;

  /// Adds a moment; moments between two rows cost little.
  void add(const ReplayMoment& moment);

  /// In order of time, at most one for each time.
  [[nodiscard]] const std::vector<HistoryRow>& rows() const { return rows_; }

 private:
  struct Verified {
    std::size_t computed;  ///< Place in ReplayMoment::computed.
    bool right;
  };

  const Mission& mission_;
  ClosureClassOptions options_;
  std::vector<HistoryRow> rows_;
  std::vector<Verified> verified_;
  std::size_t judged_ = 0;  ///< Of ReplayMoment::computed.
};

/// The header and rows of history.csv.
[[nodiscard]] LOOPWISE_EXPORT std::string history_csv(const std::vector<HistoryRow>& rows);

}  // namespace loopwise
