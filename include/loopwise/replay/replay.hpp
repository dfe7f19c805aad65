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

/// Outcomes by (from, to) that a replay takes instead of computing them. One whose task_hash differs from the
/// present task's is computed again, since with other closures before it the guess is another; 0 matches
/// every task.
using KnownOutcomes = std::map<std::pair<Key, Key>, RegistrationResult>;

/// A candidate that was computed, when, and what the back end made of it.
struct ComputedCandidate {
  RegistrationResult result;    ///< What the registration came to.
  double mission_time_s = 0.0;  ///< When the result came.
  double weight = 0.0;          ///< Last weight of the robust optimisation; 0 if rejected.
};

/// A run at one moment of mission time. The references hold during the call alone.
struct ReplayMoment {
  /// What has just happened.
  enum class Kind {
    kKeyFrame,    ///< Key frames have arrived.
    kBatch,       ///< A batch is done, and the graph optimised if it brought a closure.
    kMissionEnd,  ///< The last key frame has arrived.
    kEnd,         ///< The run is over.
  };
  Kind kind = Kind::kKeyFrame;                     ///< What has just happened.
  double mission_time_s = 0.0;                     ///< When.
  const PoseGraph& graph;                          ///< Of the nodes that have arrived, at the last estimate.
  const std::vector<Eigen::Isometry3d>& odometry;  ///< In the order of graph.nodes().
  const std::vector<ComputedCandidate>& computed;  ///< In the order of their results.
  const CandidateAccounting& accounting;           ///< Where every candidate is.
};

/// Computes the tasks of a batch elsewhere than on a pool of this process, as compute_batch() does: results
/// in the order of the tasks, none for those not begun after a stop request, `on_result` told of each, one at
/// a time.
using BatchComputer = std::function<std::vector<std::optional<RegistrationResult>>(
    const std::vector<RegistrationTask>& tasks, const StopToken& stop, const ProgressCallback& progress,
    const std::function<void(const RegistrationResult&)>& on_result)>;

/// What a run tells while it goes on. Any may be empty.
struct ReplayHooks {
  /// Takes one line of JSON, without its line end, per event: in the order of mission time, the same in every
  /// run.
  std::function<void(const std::string& line)> journal;
  using OutcomeSink = std::function<void(const RegistrationResult& result)>;  ///< See `outcome`.
  /// Takes every registration as soon as it is computed, in any order, one at a time from any thread.
  OutcomeSink outcome;
  /// Is shown the run after key frames and batches, in the order of mission time, the same in every run.
  std::function<void(const ReplayMoment& moment)> moment;
  ProgressCallback progress;  ///< Is told how far the run is.
  StopToken stop;             ///< Ends the run early; it then returns what there is.
  /// Where given, computes the registrations in place of the registrar and the threads.
  BatchComputer compute;
  /// Of a replay on a real clock: is called with each event that the engine has handled, as
  /// ModuleParts::on_event. A TraceWriter records them.
  std::function<void(const HandledEvent& handled)> event;
};

/// What a run came to.
struct ReplayResult {
  PoseGraph graph;  ///< Last estimate: priors, odometry, verified closures with weights.
  std::vector<Eigen::Isometry3d> odometry;  ///< By odometry and full priors alone, as graph.nodes().
  std::vector<ComputedCandidate> computed;  ///< In the order of their results.
  CandidateAccounting accounting;  ///< After a run on the virtual clock nothing waits or is in flight.
  std::map<std::string, std::size_t> pruned;                    ///< By reason.
  std::map<std::string, std::size_t> expired;                   ///< By reason.
  std::vector<std::pair<std::string, std::size_t>> handed_out;  ///< By prioritiser.
  /// Of the prioritisers that say chances: what was said against what came, by name.
  std::vector<std::pair<std::string, Calibration>> calibration;
  double mission_time_s = 0.0;              ///< When the run ended.
  double mission_end_s = 0.0;               ///< When the last key frame arrives.
  std::size_t batches = 0;                  ///< Handed to the computation.
  std::size_t optimizations = 0;            ///< Estimates made by the back end.
  std::size_t continued_optimizations = 0;  ///< Those of them that only continued the one before.
  bool interrupted = false;     ///< A stop was requested: the result is what there was until then.
  Problems problems;            ///< Flaws of the mission that the run met.
  double registration_s = 0.0;  ///< Wall time by stage. For reports only.
  double optimization_s = 0.0;  ///< Of the back end.
  double decision_s = 0.0;      ///< Of the engine: which candidates there are, and their order.
  double total_s = 0.0;         ///< Of the whole run.
};

/// Makes the prioritisers of one run, in the order of their turns.
using PrioritizerFactory = std::function<std::vector<std::unique_ptr<Prioritizer>>()>;

/// Replays a recorded mission on a virtual clock (paper §IV): key frames arrive at their stamps or, after a
/// communication gap, at its end; candidates are generated and prioritised as they come; whenever the
/// computation runs dry it takes the next batch, and each registration occupies one of `workers` for
/// `registration_time_s` of mission time; after each batch with a new closure (or landmark, range or gravity)
/// the graph is optimised robustly. Events are ordered by (time, kind, key): neither the wall clock nor the
/// number of threads changes the outcome.
class LOOPWISE_EXPORT MissionReplay {
 public:
  /// \param mission must outlive the replay
  /// \param options of the run; `options.registration` is not used, see `registration`
  /// \param registration computes the candidates; its features serve the observability score
  /// \param prioritizers where given, take the place of those of the method
  /// \throws OptionError naming the option; InputError on a null pointer
  MissionReplay(const Mission& mission, const ReplayOptions& options, Registration registration,
                PrioritizerFactory prioritizers = {});
  MissionReplay(const Mission&&, const ReplayOptions&, Registration, PrioritizerFactory = {}) = delete;

  /// Runs until the last key frame has come (or, by option, until nothing is pending) or a stop is requested.
  /// `threads` compute the registrations, but for those in `known`.
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
/// \throws OptionError naming the option; InputError if the graph cannot be optimised; what a hook or a
/// prioritiser throws. A scan that cannot be read is a problem of the result instead.
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay(const Mission& mission, const ReplayOptions& options = {},
                                                  const ReplayHooks& hooks = {}, int threads = 0);

/// The edges that a replay begins with: the odometry of the mission, made worse by `options.odometry_noise_*`
/// (a random walk whose steps depend on (seed, from, to) alone), its information lowered accordingly; then
/// the sightings of landmarks. Closures that the mission's files hold are left out.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Edge> replay_edges(const Mission& mission,
                                                             const ReplayOptions& options);

/// Mission time at which each node of the graph arrives at the base station, in graph order: its stamp, or
/// the end of the communication gap that it lies in, and never before an earlier node of its robot.
[[nodiscard]] LOOPWISE_EXPORT std::vector<double> arrival_times(const Mission& mission);

/// A registration as one line of JSON, timings included, and back. \throws InputError
[[nodiscard]] LOOPWISE_EXPORT std::string outcome_line(const RegistrationResult& result);
/// Reads what outcome_line() wrote. \throws InputError
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult parse_outcome_line(const std::string& line);

}  // namespace loopwise
