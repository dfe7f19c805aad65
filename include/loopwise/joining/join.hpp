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
  std::int64_t max_pairs = 1000;
  std::int64_t min_pairs = 200;
  std::int64_t proposals = 5;
  std::int64_t neighbours = 2;
  std::int64_t min_closures = 8;
  std::int64_t min_places = 2;
  double place_m = 4.0;
  double near_m = 3.0;
  double reach_m = 30.0;
  double min_confirmed = 0.35;
  double max_rival = 0.4;
  double inlier_probability = 0.999;
  double odometry_margin = 3.0;
  double drift_m = 0.5;
  double drift_rad = 0.025;
  double max_sigma_m = 0.5;
  double max_sigma_rad = 0.05;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_pairs", self.max_pairs, at_least(1.0),
          "Bound on the pairs of key frames that are registered between two components to find closures.");
    field("min_pairs", self.min_pairs, at_least(0.0),
          "Pairs that are registered, if there are as many, before two components are joined: rivals of the "
          "best frame show only in pairs that were looked at.");
    field("proposals", self.proposals, at_least(0.0),
          "Key frames of each other component that place recognition proposes for a key frame.");
    field("neighbours", self.neighbours, between(0.0, 100.0),
          "Scans before and after each of the two key frames that are merged with its scan while a submap "
          "has few points.");
    field("min_closures", self.min_closures, at_least(2.0),
          "Closures that must agree with each other over both odometries.");
    field("min_places", self.min_places, at_least(2.0),
          "Places that these must come from: at both ends place_m apart.");
    field("place_m", self.place_m, above(0.0), "Key frames closer than this are of one place, m.");
    field("near_m", self.near_m, above(0.0),
          "Key frames that the frame puts closer than this, or than half of its closures are long, are "
          "registered to confirm it, m.");
    field("reach_m", self.reach_m, above(0.0),
          "How far along both paths from a closure the frame is trusted to choose such pairs, m.");
    field("min_confirmed", self.min_confirmed, between(0.0, 1.0),
          "Share of these pairs, registered without a guess, that must come to the same frame; twice as many "
          "where the closures come from fewer than four places.");
    field("max_rival", self.max_rival, between(0.0, 1.0),
          "The components stay apart if a second frame, which contradicts the first, has more than this "
          "share of its closures or of its confirmed pairs.");
    field("inlier_probability", self.inlier_probability, Bounds{0.0, 1.0 - 1e-12, true},
          "Two closures agree if the error of their loop lies below this quantile of chi-squared with 6 "
          "degrees of freedom.");
    field("odometry_margin", self.odometry_margin, at_least(1.0),
          "How many times larger than stated odometry's deviations may be.");
    field("drift_m", self.drift_m, at_least(0.0),
          "Drift that odometry may have on top: standard deviation of each axis after 50 m, m; it grows with "
          "the root of the path.");
    field("drift_rad", self.drift_rad, at_least(0.0), "The same for the rotation, rad.");
    field("max_sigma_m", self.max_sigma_m, above(0.0),
          "Largest standard deviation of the relative position that the closures may leave, m: closures in a "
          "straight corridor alone do not tell how far along it.");
    field("max_sigma_rad", self.max_sigma_rad, above(0.0), "The same for the rotation, rad.");
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
  double rival_confirmed = 0.0;    ///< Share of the pairs that it puts close together and that confirm it.
  double best_overlap = 0.0;       ///< Largest overlap of a pair that was registered, refused ones included.
  double sigma_m = 0.0;            ///< Largest standard deviation of the relative position, m.
  double sigma_rad = 0.0;          ///< The same of the rotation, rad.
  /// Pose of b's frame in a's; absent if no two closures agree.
  std::optional<Eigen::Isometry3d> T_a_b;
  std::vector<LoopClosure> closures;  ///< Those that agree, `from` in b and `to` in a.
};

/// Where a component stands.
struct ComponentFrame {
  std::size_t group = 0;  ///< Components of one group are joined. Groups count from 0, the largest first.
  /// Pose of the component's frame in that of the first component of its group; identity for that one.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  /// Of the pose of the component's first key frame in that frame, right perturbation, m and rad; zero for
  /// the first component.
  Matrix6d covariance = Matrix6d::Zero();
  std::string reason;  ///< For people: what joins it, or why it stands apart.
};

/// The result of find_frames().
struct JoinResult {
  std::vector<ComponentFrame> frames;  ///< One per component.
  std::vector<Tie> ties;               ///< Of each pair of components, by number.
  std::size_t groups = 0;              ///< 1 if all are joined.
  std::size_t computed = 0;            ///< Pairs that were registered.
  bool stopped = false;                ///< A stop was requested: what was not looked at stays apart.
};

/// "2 of 3 joined; c is apart: 214 pairs computed, best overlap 0.21", with `components` naming them.
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const JoinResult& result,
                                                    const std::vector<JoinComponent>& components);

/// Finds the frames of components of which nothing is known but their own poses, odometry and scans. Pairs
/// of key frames of every two components are registered without any guess, proposed ones first by their
/// similarity, then such as spread over both paths. Components become one only if
///
/// - closures enough, from several places, agree with each other over both odometries,
/// - pairs that their frame puts close together come to the same frame by themselves,
/// - no second frame has comparable support, and
/// - the closures determine the frame in all directions.
///
/// Frames around a cycle of components must agree; the ties of a cycle that does not close and are not by far
/// the best supported ones are given up. A missed tie is the lesser evil. The result does not depend on the
/// number of threads.
/// \param graph poses of the components in their own frames, and odometry
/// \param robots own the nodes
/// \param components whose frames are sought; their keys are nodes with scans
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
