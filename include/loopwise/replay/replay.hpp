// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/engine/events.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/acceptance.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/registration/registrar.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise {

/// Known outcomes by (from, to), which a replay uses instead of computing them. If the task_hash differs from
/// that of the current task, the outcome is computed again, because earlier closures change the guess. A
/// task_hash of 0 matches every task.
using KnownOutcomes = std::map<std::pair<Key, Key>, RegistrationResult>;

/// A computed candidate, its time, and its weight in the back end.
struct ComputedCandidate {
  RegistrationResult result;    ///< Result of the registration.
  double mission_time_s = 0.0;  ///< Time of the result.
  double weight = 0.0;          ///< Last weight of the robust optimisation; 0 if rejected.
};

/// A run at one moment of mission time. The references are valid only during the call.
struct ReplayMoment {
  /// The last event of the run.
  enum class Kind {
    kKeyFrame,    ///< Key frames have arrived.
    kBatch,       ///< A batch is done, and the graph is optimised if there is a new closure.
    kMissionEnd,  ///< The last key frame has arrived.
    kEnd,         ///< The run is over.
  };
  Kind kind = Kind::kKeyFrame;                     ///< The last event.
  double mission_time_s = 0.0;                     ///< Mission time of the event.
  const PoseGraph& graph;                          ///< The arrived nodes, at the last estimate.
  const std::vector<Eigen::Isometry3d>& odometry;  ///< In the order of graph.nodes().
  const std::vector<ComputedCandidate>& computed;  ///< In the order of their results.
  const CandidateAccounting& accounting;           ///< State of every candidate.
};

/// Computes the tasks of a batch outside of this process, like compute_batch(). Results have the order of the
/// tasks. Tasks that did not start before a stop request have no result. `on_result` is called for each
/// result, one at a time.
using BatchComputer = std::function<std::vector<std::optional<RegistrationResult>>(
    const std::vector<RegistrationTask>& tasks, const StopToken& stop, const ProgressCallback& progress,
    const std::function<void(const RegistrationResult&)>& on_result)>;

/// Callbacks of a running replay. Any may be empty.
struct ReplayHooks {
  /// Gets one line of JSON, without its line end, per event: in the order of mission time, and the same in
  /// every run.
  std::function<void(const std::string& line)> journal;
  using OutcomeSink = std::function<void(const RegistrationResult& result)>;  ///< See `outcome`.
  /// Gets every registration when it is computed, in any order, one at a time from any thread.
  OutcomeSink outcome;
  /// Gets the run after key frames and batches, in the order of mission time, and the same in every run.
  std::function<void(const ReplayMoment& moment)> moment;
  ProgressCallback progress;  ///< Gets the progress of the run.
  StopToken stop;             ///< Ends the run early; it then returns the results so far.
  /// If set, computes the registrations instead of the registrar and the threads.
  BatchComputer compute;
  /// For a replay on a real clock: called with each event that the engine has handled, like
  /// ModuleParts::on_event. A TraceWriter records them.
  std::function<void(const HandledEvent& handled)> event;
};

/// The result of a run.
struct ReplayResult {
  PoseGraph graph;  ///< Last estimate: priors, odometry, verified closures with weights.
  std::vector<Eigen::Isometry3d>
      odometry;  ///< From odometry and full priors only, in the order of graph.nodes().
  std::vector<ComputedCandidate> computed;  ///< In the order of their results.
  CandidateAccounting
      accounting;  ///< After a run on the virtual clock, no candidate is waiting or in flight.
  std::map<std::string, std::size_t> pruned;                    ///< By reason.
  std::map<std::string, std::size_t> expired;                   ///< By reason.
  std::vector<std::pair<std::string, std::size_t>> handed_out;  ///< By prioritiser.
  /// For prioritisers with probabilities: predictions and outcomes, by name.
  std::vector<std::pair<std::string, Calibration>> calibration;
  double mission_time_s = 0.0;              ///< Time at which the run ended.
  double mission_end_s = 0.0;               ///< Time at which the last key frame arrives.
  std::size_t batches = 0;                  ///< Handed to the computation.
  std::size_t optimizations = 0;            ///< Estimates of the back end.
  std::size_t continued_optimizations = 0;  ///< Estimates that continued the previous one.
  bool interrupted = false;                 ///< A stop was requested; the result has the data until then.
  Problems problems;                        ///< Flaws of the mission in this run.
  double registration_s = 0.0;              ///< Wall time by stage. For reports only.
  double optimization_s = 0.0;              ///< Of the back end.
  double decision_s = 0.0;                  ///< Of the engine: candidates and their order.
  double total_s = 0.0;                     ///< Of the whole run.
};

/// Makes the prioritisers of one run, in the order of their turns.
using PrioritizerFactory = std::function<std::vector<std::unique_ptr<Prioritizer>>()>;

/// Replays a recorded mission on a virtual clock (paper §IV): key frames arrive at their stamps or, after a
/// communication gap, at its end; candidates are generated and prioritised on arrival; an idle computation
/// takes the next batch, and each registration occupies one of `workers` for `registration_time_s` of mission
/// time; after each batch with a new closure (or landmark, range or gravity) the graph is optimised robustly.
/// Events are ordered by (time, kind, key): neither the wall clock nor the number of threads changes the
/// outcome.
class LOOPWISE_EXPORT MissionReplay {
 public:
  /// \param mission must outlive the replay
  /// \param options of the run; `options.registration` is not used, see `registration`
  /// \param registration computes the candidates; its features serve the observability score
  /// \param prioritizers replace those of the method, if given
  /// \throws OptionError naming the option; InputError on a null pointer
  MissionReplay(const Mission& mission, const ReplayOptions& options, Registration registration,
                PrioritizerFactory prioritizers = {});
  MissionReplay(const Mission&&, const ReplayOptions&, Registration, PrioritizerFactory = {}) = delete;

  /// Runs until the last key frame has arrived (or, by option, until no candidate is pending) or a stop is
  /// requested. `threads` compute the registrations except those in `known`.
  [[nodiscard]] ReplayResult run(ThreadPool& threads, const ReplayHooks& hooks = {},
                                 const KnownOutcomes& known = {}) const;

 private:
  const Mission& mission_;
  ReplayOptions options_;
  Registration registration_;
  PrioritizerFactory prioritizers_;
};

/// Replays a mission with all parts made from the options, see MissionReplay.
/// \param mission with its scans
/// \param options of everything
/// \param hooks to watch the run, or to stop it
/// \param threads that compute registrations; 0: one per processor
/// \throws OptionError naming the option; InputError if the graph cannot be optimised; exceptions of hooks
/// and prioritisers. An unreadable scan is a problem of the result instead.
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay(const Mission& mission, const ReplayOptions& options = {},
                                                  const ReplayHooks& hooks = {}, int threads = 0);

/// Reads the files that the options name (candidates, decisions) and checks them against the mission, as a
/// replay does when it starts. For callers that would replace former results first.
/// \throws InputError, ParseError or IoError naming the file
LOOPWISE_EXPORT void check_files(const Mission& mission, const ReplayOptions& options);

/// The initial edges of a replay. First the odometry of the mission with the noise `options.odometry_noise_*`
/// (a random walk whose steps depend only on (seed, from, to)) and correspondingly lower information, then
/// the sightings of landmarks. Closures in the mission's files are left out.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Edge> replay_edges(const Mission& mission,
                                                             const ReplayOptions& options);

/// Mission time at which each node of the graph arrives at the base station, in graph order: its stamp, or
/// the end of its communication gap, and never before an earlier node of its robot.
[[nodiscard]] LOOPWISE_EXPORT std::vector<double> arrival_times(const Mission& mission);

/// A registration as one line of JSON, including timings. \throws InputError
[[nodiscard]] LOOPWISE_EXPORT std::string outcome_line(const RegistrationResult& result);
/// Reads a line of outcome_line(). \throws InputError
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult parse_outcome_line(const std::string& line);

}  // namespace loopwise
