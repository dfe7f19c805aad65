// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Events that the engine handles, and effects that it returns: requests and reports.
#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/closure_decision.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/features/scan_signature.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// A node from a front end, with its factors and scan, which may also follow later.
struct KeyFrame {
  /// The pose is used for a robot's first node, and for nodes without odometry. Later odometry and full
  /// priors move the node, together with the nodes that odometry connects to it. Rejected registrations
  /// between the moved and the other nodes are then forgotten. Their pairs are proposed again if they are
  /// near, or if they came from radio or from outside.
  Node node;
  std::vector<BetweenFactor> odometry;   ///< Usually from the robot's previous node.
  std::vector<BetweenFactor> closures;   ///< Loop closures from the front end.
  std::vector<BetweenFactor> landmarks;  ///< Sightings of landmarks, which are nodes too.
  std::vector<PriorFactor> priors;  ///< Usually for a robot's first node: its alignment to the common frame.
  std::vector<RangeFactor> ranges;  ///< From or to the node; the other node may follow.
  std::vector<GravityFactor> gravities;     ///< At the node.
  std::shared_ptr<const PointCloud> cloud;  ///< Null: the scan follows later or is missing.
};

/// Factors of present or future nodes.
struct Factors {
  std::vector<BetweenFactor> odometry;   ///< From a robot's node to its next.
  std::vector<BetweenFactor> closures;   ///< Loop closures from other sources.
  std::vector<BetweenFactor> landmarks;  ///< Sightings of landmarks.
  std::vector<PriorFactor> priors;       ///< Of the pose, or of the position only.
  std::vector<RangeFactor> ranges;       ///< Measured distances.
  std::vector<GravityFactor> gravities;  ///< Measured directions of gravity.
};

/// Poses and, if known, marginal covariances from an external back end.
struct ExternalEstimate {
  std::map<Key, Eigen::Isometry3d> poses;  ///< T_world_body by node, in the common frame of the priors.
  /// By node; right perturbation, order [translation, rotation], m² and rad². Only finiteness is checked.
  /// GTSAM has rotation first: convert with se3::swap_tangent_order().
  std::map<Key, Matrix6d> covariances;
};

/// Result of the back end, internal or external. Shared and immutable.
struct Estimate {
  PoseGraph graph;             ///< All nodes and factors at the time of the estimate.
  std::uint64_t revision = 0;  ///< Counts up from 1.
  std::size_t closures = 0;    ///< Number of loop closures.
  std::size_t inliers = 0;     ///< Number of closures with a weight above 0.5.
  bool continued = false;      ///< It continues the previous estimate (GncOptions::warm_start).
};

/// Events of Engine::handle(). Further events are KeyFrame, Factors, BeaconDrop, RegistrationResult,
/// ExternalEstimate and ClosureDecision. A ClosureDecision applies to the closures of the graph and to later
/// ones, including those of the front end; the last one on a pair counts. A rejected pair is not proposed
/// again.
namespace event {

/// The cloud of a present or future node.
struct Scan {
  KeyedScan scan;  ///< Its stamp is taken from the node.
};
/// Radio readings, of any nodes.
struct Radio {
  std::vector<RadioReading> readings;  ///< Received powers.
};
/// Pairs from an external place recognition.
struct Candidates {
  /// The engine sets ids and times, and the source, which is kUser unless it is kAppearance; the newer node
  /// by stamp becomes `from`. A pending pair takes over the recognition.
  std::vector<LoopCandidate> candidates;
};
/// The batch is done, except for registrations that are overdue.
struct BatchDone {
  std::vector<LoopCandidate> not_computed;  ///< They become pending again.
};
/// The back end is done with the last effect::Optimize.
struct Optimized {
  GncResult gnc;         ///< Empty if stopped or failed.
  bool stopped = false;  ///< It stopped early, without an estimate.
  std::string failure;   ///< Why there is no estimate; empty with an estimate, or if it was stopped.
};
/// Time has passed: expires candidates and factors.
struct Tick {};
/// The prioritisers improve their next set until they are done, stopped, or have used their evaluations.
struct Improve {
  std::size_t count = 0;  ///< Size of the next batch.
  StopToken stop;         ///< Ends it early.
  /// Bound for each prioritiser, in the order of their turns. A missing entry means no bound.
  std::vector<std::uint64_t> max_evaluations;
};
/// The computation is free: the next batch of up to `count` candidates.
struct Choose {
  std::size_t count = 0;  ///< The batch may be smaller if candidates are few or held back.
};
/// The back end is free: a wanted estimate may be computed.
struct Settle {
  /// This is the last estimate: a continued one (GncOptions::warm_start) is computed again from scratch.
  bool last = false;
};
/// No more scans will come: candidates that wait for one expire.
struct NoMoreScans {};

}  // namespace event

/// One of the events.
using Event =
    std::variant<KeyFrame, Factors, event::Scan, event::Radio, BeaconDrop, event::Candidates,
                 RegistrationResult, event::BatchDone, event::Optimized, ExternalEstimate, ClosureDecision,
                 event::Tick, event::Improve, event::Choose, event::Settle, event::NoMoreScans>;

/// An event that an engine has handled. Valid only during the call. Another engine with the same events,
/// times and scan data reaches the same graph and closures, to the bit.
struct HandledEvent {
  const Event& event;  ///< `max_evaluations` of an event::Improve holds the used evaluations.
  double now_s = 0.0;  ///< By the driver's clock, s.
  /// Smallest eigenvalue of the observability matrix of the scan that came with the event, if the method
  /// uses it.
  std::optional<double> observability = std::nullopt;
  /// Signature of that scan, if the method uses it.
  std::optional<ScanSignature> signature = std::nullopt;
};

/// Checks an event without an engine: numbers, keys, information. Clouds are not checked. \throws InputError;
/// UnknownKeyError if no robot owns a key
LOOPWISE_EXPORT void check_event(const Event& event, const Robots& robots);

/// Effects of Engine::handle(), in the order of their occurrence.
namespace effect {

/// Tasks for registration. The answers are one RegistrationResult per task, then event::BatchDone.
struct Compute {
  std::vector<RegistrationTask> tasks;  ///< In the order of the batch.
};
/// A graph for robust optimisation. The answer is event::Optimized.
struct Optimize {
  std::shared_ptr<const PoseGraph> graph;  ///< An immutable snapshot.
  bool from_scratch = false;               ///< As if GncOptions::warm_growth were 0.
};
/// A verified closure has entered the graph.
struct Closure {
  LoopClosure closure;  ///< Not yet optimised.
};
/// A candidate was computed and counted.
struct Computed {
  RegistrationResult result;  ///< Verified or rejected.
};
/// A new estimate.
struct EstimateReady {
  std::shared_ptr<const Estimate> estimate;  ///< Shared and immutable.
};
/// Something was left out or has failed.
struct Problem {
  std::string topic;         ///< Short and stable, for counting: "registration failed".
  std::string detail;        ///< Which nodes, and why.
  std::exception_ptr cause;  ///< Exception of a prioritiser; else null.
};

}  // namespace effect

/// One of the effects.
using Effect = std::variant<effect::Compute, effect::Optimize, effect::Closure, effect::Computed,
                            effect::EstimateReady, effect::Problem>;

}  // namespace loopwise
