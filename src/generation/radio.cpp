// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/radio.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

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
  const auto robot = robots_.find(drop.drop_key);
  if (!robot) {
    problems_.add("beacon dropped at a node of no robot", "beacon " + drop.beacon);
    return {};
  }
  Beacon beacon;
  beacon.drop = drop;
  beacon.drop.robot = *robot;  // taken from the node's key, not from the record
  beacon.departed_index = robots_.node_index(drop.drop_key);
  const auto [found, fresh] = beacons_.emplace(drop.beacon, std::move(beacon));
  if (!fresh) {
    problems_.add("beacon dropped twice", "beacon " + drop.beacon);
    return {};
  }
  try {
    process_detections(graph, waiting_at(drop.beacon), time_s);
  } catch (...) {  // its detections are still waiting
    beacons_.erase(found);
    throw;
  }
  return std::exchange(proposals_, {});
}

std::vector<LoopCandidate> RadioGenerator::on_radio(const PoseGraph& graph,
                                                    const std::vector<RadioReading>& readings,
                                                    double time_s) {
  std::map<std::pair<Key, std::string>, std::vector<RadioReading>> groups;
  for (const RadioReading& reading : readings) {
    if (robots_.find(reading.key)) {
      groups[{reading.key, reading.beacon}].push_back(reading);
    } else {
      problems_.add("radio reading at a node of no robot", "node " + key_name(reading.key));
    }
  }
  std::vector<Detection> detections;
  for (const auto& [which, group] : groups) {
    const double loss = mean_path_loss_db(group);
    if (!(loss > 0.0)) {
      problems_.add(std::isnan(loss) ? "radio reading without power" : "radio loss not positive",
                    "node " + key_name(which.first) + ", beacon " + which.second);
      continue;
    }
    if (!(loss < options_.max_loss_db)) continue;
    detections.push_back(which);
    waiting_nodes_[which.second].insert(which.first);
    waiting_by_arrival_.emplace(arrivals_, which);
    if (waiting_.emplace(which, arrivals_).second) {
      ++arrivals_;
    } else {
      waiting_by_arrival_.erase(arrivals_);
    }
  }
  process_detections(graph, std::move(detections), time_s);
  while (waiting_.size() > static_cast<std::size_t>(options_.max_waiting)) drop_oldest();
  return std::exchange(proposals_, {});
}

std::vector<LoopCandidate> RadioGenerator::on_node(const PoseGraph& graph, Key key, double time_s) {
  (void)graph.index_of(key);  // throws on an unknown one
  std::vector<Detection> detections;
  for (const auto& [name, beacon] : beacons_) {
    if (beacon.drop.drop_key != key) continue;
    const std::vector<Detection> here = waiting_at(name);
    detections.insert(detections.end(), here.begin(), here.end());
  }
  for (auto i = waiting_.lower_bound({key, ""}); i != waiting_.end() && i->first.first == key; ++i)
    detections.push_back(i->first);
  process_detections(graph, std::move(detections), time_s);
  return std::exchange(proposals_, {});
}

std::vector<RadioGenerator::Detection> RadioGenerator::waiting_at(const std::string& beacon) const {
  std::vector<Detection> detections;
  const auto nodes = waiting_nodes_.find(beacon);
  if (nodes == waiting_nodes_.end()) return detections;
  for (const Key key : nodes->second) detections.emplace_back(key, beacon);
  return detections;
}

void RadioGenerator::drop_oldest() {
  const auto oldest = waiting_by_arrival_.begin();
  const auto& [key, beacon] = oldest->second;
  problems_.add("radio reading of a node or beacon that did not arrive",
                "node " + key_name(key) + ", beacon " + beacon);
  waiting_nodes_.at(beacon).erase(key);
  waiting_.erase(oldest->second);
  waiting_by_arrival_.erase(oldest);
}

void RadioGenerator::process_detections(const PoseGraph& graph, std::vector<Detection> detections,
                                        double time_s) {
  std::vector<std::pair<std::int64_t, Detection>> known;  // by the nodes' stamps
  for (Detection& detection : detections) {
    const auto beacon = beacons_.find(detection.second);
    if (beacon == beacons_.end() || !graph.contains(beacon->second.drop.drop_key)) continue;
    const auto node = graph.find(detection.first);
    if (node) known.emplace_back(graph.nodes()[*node].stamp_ns, std::move(detection));
  }
  std::sort(known.begin(), known.end());
  known.erase(std::unique(known.begin(), known.end()), known.end());
  for (const auto& [stamp, detection] : known)
    process_detection(graph, beacons_.at(detection.second), detection.first, time_s);
  // Detections stop waiting only here, after all calls of process_detection(). If one throws, the caller can
  // repeat them all. Nothing below allocates.
  for (const auto& [stamp, detection] : known) {
    const auto waiting = waiting_.find(detection);
    if (waiting == waiting_.end()) continue;
    waiting_nodes_.at(detection.second).erase(detection.first);
    waiting_by_arrival_.erase(waiting->second);
    waiting_.erase(waiting);
  }
}

void RadioGenerator::process_detection(const PoseGraph& graph, Beacon& beacon, Key key, double time_s) {
  if (key == beacon.drop.drop_key || beacon.seen.count(key) != 0) return;
  const std::size_t robot = robots_.of(key);
  const std::uint64_t index = robots_.node_index(key);
  const auto max_gap = static_cast<std::uint64_t>(options_.max_gap_nodes);
  if (robot == beacon.drop.robot) {
    if (index < robots_.node_index(beacon.drop.drop_key)) return;
    if (beacon.departing) {
      if (index <= beacon.departed_index + max_gap) {
        beacon.departed_index = std::max(beacon.departed_index, index);
        beacon.seen.insert(key);
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
    // If the next line throws, an empty fly-by remains, which has no effect.
    beacon.fly_bys.push_back({robot, index, {}});
    beacon.current[robot] = own;
  }
  FlyBy& fly_by = beacon.fly_bys[own];
  if (fly_by.nodes.empty() || fly_by.nodes.back() != key) fly_by.nodes.push_back(key);
  fly_by.last_index = std::max(fly_by.last_index, index);

  const Eigen::Vector3d position = graph.node(key).pose.translation();
  const auto propose = [&](Key other) {
    const auto [proposed, is_new] = proposed_.insert({std::min(key, other), std::max(key, other)});
    if (!is_new) return;
    LoopCandidate candidate;
    candidate.from = key;
    candidate.to = other;
    candidate.source = CandidateSource::kRadio;
    candidate.time_s = time_s;
    candidate.distance_m = (graph.node(other).pose.translation() - position).norm();
    try {
      proposals_.push_back(candidate);
    } catch (...) {
      proposed_.erase(proposed);
      throw;
    }
  };
  propose(beacon.drop.drop_key);
  for (std::size_t f = 0; f < beacon.fly_bys.size(); ++f) {
    if (f == own) continue;
    for (const Key other : beacon.fly_bys[f].nodes) propose(other);
  }
  beacon.seen.insert(key);  // last, so that a detection that threw is repeated
}

}  // namespace loopwise
