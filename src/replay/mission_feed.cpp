// SPDX-License-Identifier: BSD-3-Clause
#include "mission_feed.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <Eigen/LU>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/io/candidates.hpp>
#include <loopwise/io/decisions.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {
namespace {

/// Groups elements by their keys.
template <class Element>
using ByKey = std::unordered_map<Key, std::vector<Element>>;

template <class Element>
std::vector<Element> at(const ByKey<Element>& all, Key key) {
  const auto found = all.find(key);
  return found == all.end() ? std::vector<Element>() : found->second;
}

/// Groups factors by each of their two nodes.
template <class Factor>
ByKey<Factor> by_ends(const std::vector<Factor>& factors) {
  ByKey<Factor> out;
  for (const Factor& factor : factors) {
    out[factor.from].push_back(factor);
    out[factor.to].push_back(factor);
  }
  return out;
}

template <class Factor>
ByKey<Factor> by_node(const std::vector<Factor>& factors) {
  ByKey<Factor> out;
  for (const Factor& factor : factors) out[factor.key].push_back(factor);
  return out;
}

}  // namespace

std::vector<Edge> replay_edges(const Mission& mission, const ReplayOptions& options) {
  constexpr std::uint64_t kStream =
      0x6f646f6d65747279;  // a random stream that the seeds of registrations do not use
  std::vector<Edge> edges, sightings;
  for (Edge edge : mission.graph.edges()) {
    if (edge.kind == EdgeKind::kLandmark) sightings.push_back(edge);
    if (edge.kind != EdgeKind::kOdometry) continue;
    const double root = std::sqrt(edge.T_from_to.translation().norm());
    const double sigma_m = options.odometry_noise_m_per_m * root,
                 sigma_rad = options.odometry_noise_rad_per_m * root;
    if (sigma_m > 0.0 || sigma_rad > 0.0) {
      Rng rng(pair_seed(combine_seeds(options.engine.seed, kStream), edge.from, edge.to));
      Vector6d noise, variance;
      for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0.0, k < 3 ? sigma_m : sigma_rad);
      variance << Eigen::Vector3d::Constant(sigma_m * sigma_m),
          Eigen::Vector3d::Constant(sigma_rad * sigma_rad);
      edge.T_from_to = se3::normalized(edge.T_from_to * se3::exp(noise));
      // (Ω⁻¹ + N)⁻¹ without inverting Ω or N: both may be singular.
      const Matrix6d& omega = edge.information;
      const Matrix6d lowered =
          (Matrix6d::Identity() + omega * variance.asDiagonal()).partialPivLu().solve(omega);
      edge.information = 0.5 * (lowered + lowered.transpose());
    }
    edges.push_back(edge);
  }
  edges.insert(edges.end(), sightings.begin(), sightings.end());
  return edges;
}

std::vector<double> arrival_times(const Mission& mission) {
  const std::vector<Node>& nodes = mission.graph.nodes();
  std::vector<std::size_t> order(nodes.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return nodes[a].key < nodes[b].key; });
  std::vector<double> times(nodes.size(), 0.0), latest(mission.robots.size(), 0.0);
  for (const std::size_t i : order) {
    const std::size_t robot = mission.robots.of(nodes[i].key);
    double time = mission.time_s(nodes[i].stamp_ns);
    for (const CommunicationGap& gap :
         mission.gaps) {  // sorted by their beginnings: the end of one may be inside the next
      if (gap.robot == robot && time >= gap.begin_s && time < gap.end_s) time = gap.end_s;
    }
    times[i] = latest[robot] = std::max(time, latest[robot]);
  }
  return times;
}

namespace {

/// The pairs of options.candidates, grouped by the index in `order` of the later node, which becomes `from`.
std::unordered_map<std::size_t, std::vector<LoopCandidate>> given_candidates(
    const Mission& mission, const std::string& file, const std::vector<std::size_t>& order) {
  std::unordered_map<std::size_t, std::vector<LoopCandidate>> by_place;
  if (file.empty()) return by_place;
  std::unordered_map<Key, std::size_t> place_of;
  for (std::size_t i = 0; i < order.size(); ++i) place_of[mission.graph.nodes()[order[i]].key] = i;
  for (LoopCandidate candidate : read_candidates(file)) {
    for (const Key key : {candidate.from, candidate.to}) {
      if (place_of.count(key) != 0 && !mission.robots.is_landmark(key)) continue;
      throw InputError(file + ": " + key_name(key) + " is not a node of a robot in " + mission.path.string() +
                       ": give keys of this mission, as `loopwise info` names them");
    }
    if (place_of[candidate.from] < place_of[candidate.to]) swap_ends(candidate);
    by_place[place_of[candidate.from]].push_back(candidate);
  }
  return by_place;
}

}  // namespace

std::vector<Arrival> mission_feed(const Mission& mission, const ReplayOptions& options) {
  if (mission.graph.planar()) {
    throw InputError(mission.path.string() +
                     ": has a 2D graph, but candidates are found and registered in 3D: only optimize, "
                     "evaluate, info and convert support it");
  }
  const std::vector<Node>& nodes = mission.graph.nodes();
  const std::vector<double> times = arrival_times(mission);
  std::vector<std::size_t> order(nodes.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(times[a], nodes[a].key) < std::pair(times[b], nodes[b].key);
  });
  const ByKey<Edge> edges = by_ends(replay_edges(mission, options));
  const ByKey<RangeFactor> ranges = by_ends(mission.graph.ranges());
  const ByKey<PriorFactor> priors = by_node(mission.graph.priors());
  const ByKey<GravityFactor> gravities = by_node(mission.graph.gravities());
  ByKey<RadioReading> readings;
  ByKey<BeaconDrop> drops;
  if (uses_radio(options.prioritization.method)) {
    readings = by_node(mission.radio);
    for (const BeaconDrop& drop : mission.beacons) drops[drop.drop_key].push_back(drop);
  }

  auto candidates = given_candidates(mission, options.candidates, order);

  std::vector<Arrival> feed;
  feed.reserve(order.size());
  std::unordered_set<Key> arrived;
  for (const std::size_t i : order) {
    const Key key = nodes[i].key;
    const auto other_has_come = [&](const auto& factor) {
      return arrived.count(factor.from == key ? factor.to : factor.from) != 0;
    };
    Arrival arrival;
    arrival.time_s = times[i];
    arrival.frame.node = nodes[i];
    for (const Edge& edge : at(edges, key)) {
      if (!other_has_come(edge)) continue;  // the other node brings it
      auto& list = edge.kind == EdgeKind::kLandmark ? arrival.frame.landmarks : arrival.frame.odometry;
      list.push_back({edge.from, edge.to, edge.T_from_to, edge.information, edge.trusted});
    }
    for (const RangeFactor& range : at(ranges, key)) {
      if (other_has_come(range)) arrival.frame.ranges.push_back(range);
    }
    arrival.frame.priors = at(priors, key);
    arrival.frame.gravities = at(gravities, key);
    arrival.drops = at(drops, key);
    arrival.readings = at(readings, key);
    if (const auto given = candidates.find(feed.size()); given != candidates.end())
      arrival.candidates = std::move(given->second);
    arrived.insert(key);
    feed.push_back(std::move(arrival));
  }
  return feed;
}

void check_files(const Mission& mission, const ReplayOptions& options) {
  static_cast<void>(decisions_of(mission, options));
  std::vector<std::size_t> order(mission.graph.nodes().size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  static_cast<void>(given_candidates(mission, options.candidates, order));
}

std::vector<ClosureDecision> decisions_of(const Mission& mission, const ReplayOptions& options) {
  if (options.decisions.empty()) return {};
  std::vector<ClosureDecision> decisions = read_decisions(options.decisions);
  for (const ClosureDecision& decision : decisions) {
    for (const Key key : {decision.from, decision.to}) {
      if (mission.graph.contains(key)) continue;
      throw InputError(options.decisions + ": mission " + mission.path.string() + " has no node " +
                       key_name(key) + "; decisions apply only to the mission that they were made for");
    }
  }
  return decisions;
}

void report_missing(const std::vector<ClosureDecision>& decisions, const PoseGraph& graph,
                    Problems& problems) {
  std::set<std::pair<Key, Key>> closures;
  for (const Edge& edge : graph.edges()) {
    if (edge.kind == EdgeKind::kLoopClosure) closures.insert(std::minmax(edge.from, edge.to));
  }
  for (const ClosureDecision& decision : decisions) {
    if (!decision.accepted || closures.count(std::minmax(decision.from, decision.to)) != 0) continue;
    problems.add("accepted pair without a closure", key_name(decision.from) + " - " + key_name(decision.to) +
                                                        ": not computed, or refused by the registration");
  }
}

std::vector<Eigen::Isometry3d> odometry_of(const std::vector<Arrival>& feed, const Robots& robots) {
  EngineOptions options;
  options.use_back_end = options.use_proximity = false;
  Engine engine(robots, options, RoundRobinQueue({}));
  for (const Arrival& arrival : feed) static_cast<void>(engine.handle(arrival.frame, arrival.time_s));
  return engine.odometry();
}

}  // namespace loopwise
