// SPDX-License-Identifier: BSD-3-Clause
#include "mission_feed.hpp"

#include <algorithm>
#include <numeric>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <loopwise/engine/engine.hpp>
#include <loopwise/pipeline/replay.hpp>

namespace loopwise {
namespace {

/// Elements by the keys that they belong to.
template <class Element>
using ByKey = std::unordered_map<Key, std::vector<Element>>;

template <class Element>
std::vector<Element> at(const ByKey<Element>& all, Key key) {
  const auto found = all.find(key);
  return found == all.end() ? std::vector<Element>() : found->second;
}

/// Factors between two nodes.
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

std::vector<Arrival> mission_feed(const Mission& mission, const Config& config) {
  const std::vector<Node>& nodes = mission.graph.nodes();
  const std::vector<double> times = arrival_times(mission);
  std::vector<std::size_t> order(nodes.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(times[a], nodes[a].key) < std::pair(times[b], nodes[b].key);
  });
  const ByKey<Edge> edges = by_ends(replay_edges(mission, config.replay));
  const ByKey<RangeFactor> ranges = by_ends(mission.graph.ranges());
  const ByKey<PriorFactor> priors = by_node(mission.graph.priors());
  const ByKey<GravityFactor> gravities = by_node(mission.graph.gravities());
  ByKey<RadioReading> readings;
  ByKey<BeaconDrop> drops;
  if (uses_radio(config.replay.method)) {
    readings = by_node(mission.radio);
    for (const BeaconDrop& drop : mission.beacons) drops[drop.drop_key].push_back(drop);
  }

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
      if (other_has_come(edge)) arrival.frame.factors.push_back(edge);  // else it comes with that node
    }
    for (const RangeFactor& range : at(ranges, key)) {
      if (other_has_come(range)) arrival.frame.ranges.push_back(range);
    }
    arrival.frame.priors = at(priors, key);
    arrival.frame.gravities = at(gravities, key);
    arrival.drops = at(drops, key);
    arrival.readings = at(readings, key);
    arrived.insert(key);
    feed.push_back(std::move(arrival));
  }
  return feed;
}

std::vector<Eigen::Isometry3d> odometry_of(const std::vector<Arrival>& feed, const Robots& robots) {
  EngineOptions options;
  options.back_end = options.proximity = false;
  Engine engine(robots, options, RoundRobinQueue({}));
  for (const Arrival& arrival : feed) static_cast<void>(engine.handle(arrival.frame, arrival.time_s));
  return engine.odometry();
}

}  // namespace loopwise
