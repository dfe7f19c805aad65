// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/radio.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace loopwise {

double mean_path_loss_db(const std::vector<RadioReading>& readings) {
  double sum = 0.0;
  int count = 0;
  for (const RadioReading& reading : readings) {
    const double loss = reading.transmit_dbm - reading.receive_dbm;
    if (!std::isfinite(loss)) continue;
    sum += loss;
    ++count;
  }
  return count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
}

RadioGenerator::RadioGenerator(const RadioOptions& options, Robots robots)
    : options_(options), robots_(std::move(robots)) {
  validate(options_);
}

std::vector<LoopCandidate> RadioGenerator::on_drop(const PoseGraph& graph, const BeaconDrop& drop,
                                                   double time_s) {
  std::vector<LoopCandidate> out;
  const auto robot = robots_.find(drop.drop_key);
  if (!robot) {
    problems_.add("beacon dropped at no robot's node", "beacon " + drop.beacon);
    return out;
  }
  const auto [found, fresh] = beacons_.emplace(drop.beacon, Beacon{});
  if (!fresh) {
    problems_.add("beacon dropped twice", "beacon " + drop.beacon);
    return out;
  }
  Beacon& beacon = found->second;
  beacon.drop = drop;
  beacon.drop.robot = *robot;  // the node's owner decides
  beacon.departed_index = robots_.node_index(drop.drop_key);
  take_up(graph, time_s, out);
  return out;
}

std::vector<LoopCandidate> RadioGenerator::on_radio(const PoseGraph& graph,
                                                    const std::vector<RadioReading>& readings,
                                                    double time_s) {
  std::vector<LoopCandidate> out;
  std::map<std::pair<Key, std::string>, std::vector<RadioReading>> groups;
  for (const RadioReading& reading : readings) {
    if (robots_.find(reading.key)) {
      groups[{reading.key, reading.beacon}].push_back(reading);
    } else {
      problems_.add("radio reading of no robot's node", "node " + key_name(reading.key));
    }
  }
  for (const auto& [which, group] : groups) {
    const double loss = mean_path_loss_db(group);
    if (!(loss > 0.0)) {
      problems_.add(std::isnan(loss) ? "radio reading without power" : "radio loss not positive",
                    "node " + key_name(which.first) + ", beacon " + which.second);
      continue;
    }
    if (loss < options_.max_loss_db) waiting_.emplace(which, arrivals_++);
  }
  take_up(graph, time_s, out);
  while (waiting_.size() > static_cast<std::size_t>(options_.max_waiting)) {
    const auto oldest = std::min_element(waiting_.begin(), waiting_.end(),
                                         [](const auto& a, const auto& b) { return a.second < b.second; });
    problems_.add("radio reading of a node or beacon that never came",
                  "node " + key_name(oldest->first.first) + ", beacon " + oldest->first.second);
    waiting_.erase(oldest);
  }
  return out;
}

std::vector<LoopCandidate> RadioGenerator::on_node(const PoseGraph& graph, Key key, double time_s) {
  (void)graph.index_of(key);  // throws on an unknown one
  std::vector<LoopCandidate> out;
  if (!waiting_.empty() || !beacons_.empty()) take_up(graph, time_s, out);
  return out;
}

void RadioGenerator::take_up(const PoseGraph& graph, double time_s, std::vector<LoopCandidate>& out) {
  // What has become known, in the order of the nodes' stamps.
  std::vector<std::tuple<std::int64_t, Key, std::string>> known;
  for (const auto& [which, arrival] : waiting_) {
    const auto beacon = beacons_.find(which.second);
    if (beacon == beacons_.end() || !graph.contains(beacon->second.drop.drop_key)) continue;
    const auto node = graph.find(which.first);
    if (node) known.emplace_back(graph.nodes()[*node].stamp_ns, which.first, which.second);
  }
  std::sort(known.begin(), known.end());
  for (const auto& [stamp, key, name] : known) {
    waiting_.erase({key, name});
    pass(graph, beacons_.at(name), key, time_s, out);
  }
}

void RadioGenerator::pass(const PoseGraph& graph, Beacon& beacon, Key key, double time_s,
                          std::vector<LoopCandidate>& out) {
  if (key == beacon.drop.drop_key || !beacon.seen.insert(key).second) return;
  const std::size_t robot = robots_.of(key);
  const std::uint64_t index = robots_.node_index(key);
  const auto max_gap = static_cast<std::uint64_t>(options_.max_gap_nodes);
  if (robot == beacon.drop.robot) {
    if (index < robots_.node_index(beacon.drop.drop_key)) return;
    if (beacon.departing) {
      if (index <= beacon.departed_index + max_gap) {
        beacon.departed_index = std::max(beacon.departed_index, index);
        return;
      }
      beacon.departing = false;
    }
  } else if (graph.node(key).stamp_ns < beacon.drop.stamp_ns) {
    return;
  }

  const auto current = beacon.current.find(robot);
  std::size_t own = beacon.fly_bys.size();
  if (current != beacon.current.end() && index <= beacon.fly_bys[current->second].last_index + max_gap) {
    own = current->second;
  } else {
    beacon.fly_bys.push_back(
        {robot, index, {}});  // first: who has no memory for the next line has one too many
    beacon.current[robot] = own;
  }
  beacon.fly_bys[own].nodes.push_back(key);
  beacon.fly_bys[own].last_index = std::max(beacon.fly_bys[own].last_index, index);

  const Eigen::Vector3d position = graph.node(key).pose.translation();
  const auto propose = [&](Key other) {
    if (!proposed_.insert({std::min(key, other), std::max(key, other)}).second) return;
    LoopCandidate candidate;
    candidate.from = key;
    candidate.to = other;
    candidate.source = CandidateSource::kRadio;
    candidate.time_s = time_s;
    candidate.distance_m = (graph.node(other).pose.translation() - position).norm();
    out.push_back(candidate);
  };
  propose(beacon.drop.drop_key);
  for (std::size_t f = 0; f < beacon.fly_bys.size(); ++f) {
    if (f == own) continue;
    for (const Key other : beacon.fly_bys[f].nodes) propose(other);
  }
}

}  // namespace loopwise
