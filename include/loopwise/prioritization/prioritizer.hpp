// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise {

class Calibration;

/// A candidate that a prioritiser refuses.
struct Refusal {
  CandidateId id = 0;  ///< The candidate.
  std::string reason;  ///< Short and stable, for example "low_observability".
};

/// Orders pending candidates: the interface for user-defined methods. Called from one thread at a time. Scans
/// of a candidate are announced before the candidate itself, nodes before improve() and take().
class LOOPWISE_EXPORT Prioritizer {
 public:
  virtual ~Prioritizer() = default;

  /// Short and stable, for options, tables and journals.
  [[nodiscard]] virtual std::string_view name() const = 0;

  /// Adds new candidates, in order of generation; known candidates are ignored. \returns candidates that it
  /// will never hand out.
  virtual std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) = 0;

  /// Removes candidates that another prioritiser handed out, or that expired or were withdrawn. Unknown ids
  /// are ignored.
  virtual void remove(const std::vector<CandidateId>& ids) = 0;

  virtual void on_graph(const PoseGraph& /*graph*/) {}             ///< New estimate from the back end.
  virtual void on_scan(const KeyedScan& /*scan*/) {}               ///< A new keyed scan arrived.
  virtual void on_result(const RegistrationResult& /*result*/) {}  ///< A candidate was computed.

  /// Prepares the best set of `count` until it is done, a stop is requested, or the bound on evaluations is
  /// reached. take() works without it. \returns the evaluations used: another call with that bound and
  /// without a stop request must reach the same state, so that a recorded run can be repeated.
  virtual std::uint64_t improve(
      std::size_t /*count*/, const StopToken& /*stop*/,
      std::uint64_t /*max_evaluations*/ = std::numeric_limits<std::uint64_t>::max()) {
    return 0;
  }

  /// Removes and returns up to `count` candidates, most valuable first; fewer only if it holds fewer, or
  /// holds back candidates with unknown nodes.
  [[nodiscard]] virtual std::vector<LoopCandidate> take(std::size_t count) = 0;

  /// Removes and returns candidates that it has held back too long at mission time `now_s`.
  [[nodiscard]] virtual std::vector<Refusal> give_up(double /*now_s*/) { return {}; }

  /// Its predictions for computed candidates and their outcomes; null without predictions.
  [[nodiscard]] virtual const Calibration* calibration() const { return nullptr; }

  /// Number of candidates that it holds.
  [[nodiscard]] virtual std::size_t size() const = 0;
};

}  // namespace loopwise
