// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The state machine of the batch replay and the online module.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/engine/events.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/prioritization/round_robin_queue.hpp>
#include <loopwise/registration/task.hpp>

namespace loopwise {

/// Relative pose with which a registration starts and is compared.
enum class GuessSource {
  kEstimate,  ///< The back end's estimate when the candidate is handed out.
  kOdometry,  ///< Odometry alone: the outcome of a pair then never depends on other closures.
};
[[nodiscard]] inline EnumNames<GuessSource> enum_names(GuessSource) {
  return {{GuessSource::kEstimate, "estimate"}, {GuessSource::kOdometry, "odometry"}};
}

/// The policies of an engine, with the options of the stages that it owns.
struct EngineOptions {
  ProximityOptions generation;  ///< Candidates by proximity.
  RadioOptions radio;           ///< Candidates by radio beacons.
  CandidatePoolOptions pool;    ///< Expiry of candidates.
  TaskOptions task;             ///< Scans and guesses of a registration.
  /// Source of the relative poses that registrations get as a guess: estimate or odometry.
  GuessSource guess = GuessSource::kEstimate;
  /// Propose pairs of near nodes. Off: candidates come only from outside and from radio.
  bool use_proximity = true;
  /// Optimise the graph after each batch with a closure. Off: estimates come from outside.
  bool use_back_end = true;
  /// Keep one candidate in this many, drawn by pair and seed. 1: all.
  std::int64_t thin = 1;
  /// Factors whose nodes are missing for longer than this are dropped and counted, s. 0: never.
  double max_factor_wait_s = 600.0;
  /// Seed of all random draws.
  std::uint64_t seed = 1;

  /// Calls visitor(name, section) for these options and those of the stages.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    visitor("engine", self);
    visitor("generation", self.generation);
    visitor("radio", self.radio);
    visitor("pool", self.pool);
    visitor("task", self.task);
  }

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("guess", self.guess, any_value());
    field("use_proximity", self.use_proximity, any_value());
    field("use_back_end", self.use_back_end, any_value());
    field("thin", self.thin, at_least(1));
    field("max_factor_wait_s", self.max_factor_wait_s, at_least(0.0));
    field("seed", self.seed, at_least(0));
  }
};

/// Whether options.thin keeps a candidate.
[[nodiscard]] LOOPWISE_EXPORT bool kept_by_thinning(const EngineOptions& options,
                                                    const LoopCandidate& candidate);

/// Makes all decisions of a mission: poses of nodes, candidates and their order, times of optimisation, and
/// the use of results and estimates. It takes events and returns effects, and uses neither threads, clocks
/// nor files. A driver provides the time and executes the effects. The same events give the same effects, to
/// the bit.
///
/// Duties of a driver: after each event, send event::Settle if wants_estimate() and neither optimizing() nor
/// computing(), and event::Choose if wants_batch(); send event::Tick about once a second. Answer an
/// effect::Compute, even without tasks, by a result for each task and one event::BatchDone, and an
/// effect::Optimize by one event::Optimized of the same graph. No batch is chosen while another is computed.
///
/// Not thread-safe. An invalid event throws and changes nothing. An exception of a prioritiser gives an
/// effect::Problem. std::bad_alloc is passed on. After it, the engine must not get further events, but it
/// stays readable; the graph may contain a part of the failed event.
class LOOPWISE_EXPORT Engine {
 public:
  /// `queue` has the prioritisers. Without prioritisers no candidate is proposed. \throws OptionError
  Engine(const Robots& robots, const EngineOptions& options, RoundRobinQueue queue);
  ~Engine();
  Engine(Engine&&) noexcept;
  Engine& operator=(Engine&&) noexcept;

  /// Handles one event. \returns its effects, in the order in which they happened
  /// \param event the event
  /// \param now_s mission time; a time before that of an earlier event counts as that
  /// \throws InputError on a known node, a factor that PoseGraph refuses, or a result of a candidate that is
  /// not in flight; UnknownKeyError if no robot owns a key
  [[nodiscard]] std::vector<Effect> handle(Event event, double now_s);

  /// Whether event::Choose is likely to give a batch.
  [[nodiscard]] bool wants_batch() const;
  /// Whether the graph needs a new estimate: event::Settle starts one, unless one is running.
  [[nodiscard]] bool wants_estimate() const;
  /// Whether a batch is being computed.
  [[nodiscard]] bool computing() const;
  /// Whether an estimate is being computed.
  [[nodiscard]] bool optimizing() const;
  /// Number of registrations without a result so far, also of finished batches.
  [[nodiscard]] std::size_t in_computation() const;

  /// All nodes, factors and verified closures, at the last estimate.
  [[nodiscard]] const PoseGraph& graph() const;
  /// Poses from odometry and full priors only (those that fix position and rotation), in the order of
  /// graph().nodes().
  [[nodiscard]] const std::vector<Eigen::Isometry3d>& odometry() const;
  /// The candidates and their states.
  [[nodiscard]] const CandidatePool& pool() const;
  /// Evaluations that each prioritiser used in the last event::Improve.
  [[nodiscard]] const std::vector<std::uint64_t>& evaluations() const;
  /// Mission time.
  [[nodiscard]] double now_s() const;
  /// Number of factors that wait for a node.
  [[nodiscard]] std::size_t factors_waiting() const;
  /// Number of factors that waited too long and were dropped.
  [[nodiscard]] std::size_t factors_dropped() const;
  /// Flaws of the radio data.
  [[nodiscard]] const Problems& radio_problems() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
