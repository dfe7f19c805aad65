// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Robots and sessions without a common frame: their relative poses, found from the scans alone.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Requirements for two components to become one.
struct JoinOptions {
  /// Maximum number of pairs of key frames that are registered between two components to find closures.
  std::int64_t max_pairs = 1000;
  /// Minimum number of pairs that are registered before two components are joined, if there are as many.
  /// Rivals of the best frame show only in pairs that were registered.
  std::int64_t min_pairs = 200;
  /// Number of key frames of each other component that place recognition proposes for a key frame.
  std::int64_t proposals = 5;
  /// Number of scans before and after each of the two key frames that are merged with its scan while a submap
  /// has few points.
  std::int64_t neighbours = 2;
  /// Minimum number of closures that agree with each other over both odometries.
  std::int64_t min_closures = 8;
  /// Minimum number of places from which these closures come. Places are place_m apart at both ends.
  std::int64_t min_places = 2;
  /// Key frames closer than this belong to one place, m.
  double place_m = 4.0;
  /// Pairs of key frames are registered to confirm the frame if it puts them closer than this, or closer than
  /// the median length of its closures, m.
  double near_m = 3.0;
  /// Maximum distance along both paths from a closure to a pair that may confirm the frame, m.
  double reach_m = 30.0;
  /// Minimum share of the pairs that are registered to confirm the frame, without a guess, whose result
  /// agrees with it. It is doubled if the closures come from fewer than four places.
  double min_confirmed = 0.35;
  /// The components stay apart if a second frame, which contradicts the first, has more than this share of
  /// the closures or of the confirmed pairs of the first.
  double max_rival = 0.4;
  /// Two closures agree if the error of their loop is below this quantile of chi-squared with 6 degrees of
  /// freedom.
  double inlier_probability = 0.999;
  /// Factor by which the standard deviations of odometry may be larger than stated.
  double odometry_margin = 3.0;
  /// Additional drift of odometry: standard deviation of each axis after a path of 50 m, m. It grows with the
  /// square root of the path.
  double drift_m = 0.5;
  /// Additional drift of odometry: standard deviation of the rotation after a path of 50 m, rad. It grows
  /// with the square root of the path.
  double drift_rad = 0.025;
  /// Maximum standard deviation of the relative position that results from the closures, m. Closures in a
  /// straight corridor alone leave the position along the corridor undetermined.
  double max_sigma_m = 0.5;
  /// Maximum standard deviation of the relative rotation that results from the closures, rad.
  double max_sigma_rad = 0.05;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_pairs", self.max_pairs, at_least(1.0));
    field("min_pairs", self.min_pairs, at_least(0.0));
    field("proposals", self.proposals, at_least(0.0));
    field("neighbours", self.neighbours, between(0.0, 100.0));
    field("min_closures", self.min_closures, at_least(2.0));
    field("min_places", self.min_places, at_least(2.0));
    field("place_m", self.place_m, above(0.0));
    field("near_m", self.near_m, above(0.0));
    field("reach_m", self.reach_m, above(0.0));
    field("min_confirmed", self.min_confirmed, between(0.0, 1.0));
    field("max_rival", self.max_rival, between(0.0, 1.0));
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 0.999999, true});
    field("odometry_margin", self.odometry_margin, at_least(1.0));
    field("drift_m", self.drift_m, at_least(0.0));
    field("drift_rad", self.drift_rad, at_least(0.0));
    field("max_sigma_m", self.max_sigma_m, above(0.0));
    field("max_sigma_rad", self.max_sigma_rad, above(0.0));
  }
};

/// Key frames of one frame: a robot, a session, or a map of several robots whose frames are known.
struct JoinComponent {
  std::string name;       ///< For people.
  std::vector<Key> keys;  ///< Key frames with scans, in the order of the paths.
};

/// Two key frames of different components that may have seen the same place, in any order.
struct ProposedPair {
  Key from = 0;             ///< One of the two.
  Key to = 0;               ///< The other.
  double similarity = 0.0;  ///< Higher is more likely. Only the order counts.
};

/// The result between two components.
struct Tie {
  std::size_t a = 0;               ///< Number of the first component, a < b.
  std::size_t b = 0;               ///< Number of the second.
  bool joined = false;             ///< Whether the evidence suffices.
  std::string reason;              ///< For people: why not, or figures of the evidence.
  std::size_t computed = 0;        ///< Pairs that were registered.
  std::size_t verified = 0;        ///< Of these, verified by the registration alone.
  std::size_t places = 0;          ///< Places that `closures` come from.
  std::size_t tested = 0;          ///< Pairs that the frame puts close together, registered without guess.
  std::size_t confirmed = 0;       ///< Of these, those that came to the same frame.
  std::size_t rival_closures = 0;  ///< Closures that agree on the second-best frame.
  double rival_confirmed = 0.0;    ///< Share of the pairs close together in that frame that confirm it.
  double best_overlap = 0.0;       ///< Largest overlap of a pair that was registered, refused ones included.
  double sigma_m = 0.0;            ///< Largest standard deviation of the relative position, m.
  double sigma_rad = 0.0;          ///< The same of the rotation, rad.
  /// Pose of b's frame in a's; absent if no two closures agree.
  std::optional<Eigen::Isometry3d> T_a_b;
  std::vector<LoopClosure> closures;  ///< Those that agree, `from` in b and `to` in a.
};

/// The frame of a component.
struct ComponentFrame {
  std::size_t group = 0;  ///< Components of one group are joined. Groups count from 0, the largest first.
  /// Pose of the component's frame in that of the first component of its group; identity for that one.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  /// Covariance of the pose of the component's first key frame in that frame: right perturbation, m and rad.
  /// Zero for the first component.
  Matrix6d covariance = Matrix6d::Zero();
  std::string reason;  ///< For people: how it was joined, or why it was not.
};

/// The result of find_frames().
struct JoinResult {
  std::vector<ComponentFrame> frames;  ///< One per component.
  std::vector<Tie> ties;               ///< Of each pair of components, by number.
  std::size_t groups = 0;              ///< 1 if all are joined.
  std::size_t computed = 0;            ///< Pairs that were registered.
  bool stopped = false;                ///< A stop was requested. Components without a tie so far stay apart.
};

/// "2 of 3 joined; c is not joined: 214 pairs computed, best overlap 0.21", with `components` naming them.
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const JoinResult& result,
                                                    const std::vector<JoinComponent>& components);

/// Finds the relative frames of components from their own poses, odometry and scans alone. Pairs of key
/// frames of every two components are registered without a guess: proposed pairs first, by similarity, then
/// pairs that are spread over both paths. Components become one only if
///
/// - enough closures, from several places, agree with each other over both odometries,
/// - pairs that this frame puts close together give the same frame when they are registered without a guess,
/// - no second frame has comparable support, and
/// - the closures determine the frame in all directions.
///
/// The frames around a cycle of components must agree. If a cycle does not close, only its ties with by far
/// the best support are kept: a false tie does more harm than a missing one. The result does not depend on
/// the number of threads.
/// \param graph poses of the components in their own frames, and odometry
/// \param robots own the nodes
/// \param components to join; their keys are nodes with scans
/// \param proposals of a place recognition; may be empty
/// \param registrar computes pairs
/// \param threads that register pairs
/// \param options bounds of the work and requirements of a tie
/// \param progress is called with the pairs registered so far
/// \param stop ends the search early; components without a tie so far stay apart
/// \throws OptionError; UnknownKeyError; InputError on a planar graph or a key in two components
[[nodiscard]] LOOPWISE_EXPORT JoinResult find_frames(
    const PoseGraph& graph, const Robots& robots, const std::vector<JoinComponent>& components,
    const std::vector<ProposedPair>& proposals, const Registrar& registrar, ThreadPool& threads,
    const JoinOptions& options = {}, const ProgressCallback& progress = {}, const StopToken& stop = {});

}  // namespace loopwise
