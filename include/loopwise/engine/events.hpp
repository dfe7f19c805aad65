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

/// A node as a front end hands it over, all at once or with factors and scan following later.
struct KeyFrame {
  /// The pose counts for a robot's first node only, and where no odometry leads to the node. Odometry and
  /// full priors that come later move the node, together with the nodes that odometry has tied to it.
  /// Registrations between the moved and the other nodes that were rejected are then forgotten. Their pairs
  /// are proposed again if they are near, or if they came from radio or from outside.
  Node node;
  std::vector<BetweenFactor> odometry;   ///< From the robot's previous node, as a rule.
  std::vector<BetweenFactor> closures;   ///< Loop closures that the front end has found itself.
  std::vector<BetweenFactor> landmarks;  ///< Sightings of landmarks, which are nodes too.
  std::vector<PriorFactor> priors;  ///< Usually of a robot's first node: its alignment to the common frame.
  std::vector<RangeFactor> ranges;  ///< From or to it; the other node may follow.
  std::vector<GravityFactor> gravities;     ///< At it.
  std::shared_ptr<const PointCloud> cloud;  ///< Null: the scan follows later, or never.
};

/// Factors of nodes that have come or will come.
struct Factors {
  std::vector<BetweenFactor> odometry;   ///< From a robot's node to its next.
  std::vector<BetweenFactor> closures;   ///< Loop closures from elsewhere.
  std::vector<BetweenFactor> landmarks;  ///< Sightings of landmarks.
  std::vector<PriorFactor> priors;       ///< Of the pose or of the position alone.
  std::vector<RangeFactor> ranges;       ///< Measured distances.
  std::vector<GravityFactor> gravities;  ///< Measured directions of gravity.
};

/// Poses and, where known, marginal covariances from a back end other than ours.
struct ExternalEstimate {
  std::map<Key, Eigen::Isometry3d> poses;  ///< T_world_body by node, in the common frame of the priors.
  /// By node; of the right perturbation, order [translation, rotation], m² and rad². They are not looked at
  /// beyond being finite. GTSAM has rotation first: se3::swap_tangent_order() turns it round.
  std::map<Key, Matrix6d> covariances;
};

/// What the back end, ours or another, made of the graph. Shared: it never changes.
struct Estimate {
  PoseGraph graph;             ///< All nodes and factors known when the estimate was taken in.
  std::uint64_t revision = 0;  ///< Counts up from 1.
  std::size_t closures = 0;    ///< Of the edges, loop closures.
  std::size_t inliers = 0;     ///< Of these, with a weight above 0.5.
  bool continued = false;      ///< It only continues the one before (GncOptions::warm_start).
};

/// Events: what Engine::handle() takes. Those that are not listed here are KeyFrame, Factors,
/// BeaconDrop, RegistrationResult and ExternalEstimate.
namespace event {

/// The cloud of a node that has come or will come.
struct Scan {
  KeyedScan scan;  ///< Its stamp is taken from the node.
};
/// Radio readings, of any nodes.
struct Radio {
  std::vector<RadioReading> readings;  ///< Received powers.
};
/// Pairs from a place recognition outside.
struct Candidates {
  /// Ids and times are given by the engine, and the source is kUser unless it is kAppearance; the newer node
  /// by stamp becomes `from`. A pair that is pending already takes over what was recognised.
  std::vector<LoopCandidate> candidates;
};
/// The batch is done, but for registrations that have not come back and are no longer waited for.
struct BatchDone {
  std::vector<LoopCandidate> not_computed;  ///< They become pending again.
};
/// The back end is done with the last effect::Optimize.
struct Optimized {
  GncResult gnc;         ///< Empty if stopped or failed.
  bool stopped = false;  ///< It ended early, without an estimate.
  std::string failure;   ///< Why there is no estimate; empty if there is, or if it was stopped.
};
/// Takes out every closure between two nodes, and takes in none that is computed later.
struct Veto {
  Key from = 0;  ///< One of the nodes.
  Key to = 0;    ///< The other.
};
/// Time has passed: expires what is due.
struct Tick {};
/// The prioritisers improve their next set until they are done, stopped, or have used their evaluations.
struct Improve {
  std::size_t count = 0;  ///< Of the batch that will be asked for.
  StopToken stop;         ///< Ends it early.
  /// Bound by prioritiser, in the order of their turns; missing ones are not bound.
  std::vector<std::uint64_t> max_evaluations;
};
/// The computation is free: the next batch of up to `count` candidates.
struct Choose {
  std::size_t count = 0;  ///< Fewer if there are fewer, or if prioritisers hold some back.
};
/// Nothing else needs the back end now: an estimate that is wanted may be made.
struct Settle {
  /// This is the last: an estimate that only continues the one before (GncOptions::warm_start) is made again
  /// from scratch.
  bool last = false;
};
/// No more scans will come: candidates that wait for one expire.
struct NoMoreScans {};

}  // namespace event

/// One of the events.
using Event =
    std::variant<KeyFrame, Factors, event::Scan, event::Radio, BeaconDrop, event::Candidates,
                 RegistrationResult, event::BatchDone, event::Optimized, ExternalEstimate, event::Veto,
                 event::Tick, event::Improve, event::Choose, event::Settle, event::NoMoreScans>;

/// An event that an engine has handled. Holds during the call alone. Another engine that is fed the same
/// events, times and insights into scans comes to the same graph and closures, to the bit.
struct HandledEvent {
  const Event& event;  ///< An event::Improve has as `max_evaluations` what was used.
  double now_s = 0.0;  ///< By the driver's clock, s.
  /// Smallest eigenvalue of the observability matrix of the scan that came with the event, if the method
  /// asked for it.
  std::optional<double> observability = std::nullopt;
  /// Signature of that scan, if the method asked for it.
  std::optional<ScanSignature> signature = std::nullopt;
};

/// What can be told of an event by itself, before the engine has it: numbers, keys, information. Clouds are
/// not looked at. \throws InputError; UnknownKeyError if no robot owns a key
LOOPWISE_EXPORT void check_event(const Event& event, const Robots& robots);

/// Effects: what Engine::handle() returns, in the order in which they happened.
namespace effect {

/// To be registered. Answered by a RegistrationResult each, then event::BatchDone.
struct Compute {
  std::vector<RegistrationTask> tasks;  ///< In the order of the batch.
};
/// To be optimised robustly. Answered by event::Optimized.
struct Optimize {
  std::shared_ptr<const PoseGraph> graph;  ///< A snapshot, which does not change.
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
  std::shared_ptr<const Estimate> estimate;  ///< Shared: it never changes.
};
/// Something was left out or has failed.
struct Problem {
  std::string topic;         ///< Short and stable, for counting: "registration failed".
  std::string detail;        ///< Which nodes, and why.
  std::exception_ptr cause;  ///< Of a prioritiser that threw; else null.
};

}  // namespace effect

/// One of the effects.
using Effect = std::variant<effect::Compute, effect::Optimize, effect::Closure, effect::Computed,
                            effect::EstimateReady, effect::Problem>;

}  // namespace loopwise
