// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/rank.hpp>

#include <algorithm>
#include <limits>
#include <numeric>
#include <set>
#include <unordered_map>

#include <loopwise/core/error.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/pipeline/replay.hpp>

namespace loopwise {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kFineProbes = 256;

/// All candidates as the nodes arrive, without pairs that the graph has an edge for.
std::vector<LoopCandidate> generate(const Mission& mission, const Config& config, bool with_radio) {
  const PoseGraph& graph = mission.graph;
  const std::vector<double> times = arrival_times(mission);
  std::vector<std::size_t> order(times.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return times[a] != times[b] ? times[a] < times[b] : graph.nodes()[a].key < graph.nodes()[b].key;
  });
  std::unordered_map<Key, std::vector<RadioReading>> readings;
  if (with_radio) {
    for (const RadioReading& reading : mission.radio) readings[reading.key].push_back(reading);
  }
  std::set<std::pair<Key, Key>> known;
  for (const Edge& edge : graph.edges())
    known.insert({std::min(edge.from, edge.to), std::max(edge.from, edge.to)});

  ProximityGenerator proximity(config.generation, mission.robots);
  RadioGenerator radio(config.radio, mission.robots);
  std::vector<LoopCandidate> out;
  const auto take = [&](const std::vector<LoopCandidate>& more) {
    for (LoopCandidate candidate : more) {
      const Key low = std::min(candidate.from, candidate.to), high = std::max(candidate.from, candidate.to);
      if (!known.insert({low, high}).second) continue;
      candidate.id = out.size();
      out.push_back(candidate);
    }
  };
  for (const std::size_t i : order) {
    const Key key = graph.nodes()[i].key;
    if (with_radio) {
      for (const BeaconDrop& drop : mission.beacons) {
        if (drop.drop_key == key) take(radio.on_drop(graph, drop, times[i]));
      }
      if (const auto found = readings.find(key); found != readings.end()) {
        take(radio.on_radio(graph, found->second, times[i]));
      }
    }
    take(proximity.on_node(graph, key, times[i]));
  }
  return out;
}

}  // namespace

Ranking rank_candidates(const Mission& mission, const Config& config, std::shared_ptr<FeatureCache> features,
                        const RankOptions& options, const ProgressCallback& progress, const StopToken& stop) {
  validate_config(config);
  const std::vector<std::string> parts = method_parts(config.replay.method);
  const bool with_radio = std::find(parts.begin(), parts.end(), "rssi") != parts.end();
  const std::vector<LoopCandidate> candidates = generate(mission, config, with_radio);

  const ObservabilityPrioritizer::Eigenvalue eigenvalue =
      features ? observability_of(*features, config.observability.variant)
               : [](const KeyedScan&) { return 0.0; };
  RoundRobinQueue queue = make_queue(config, mission.robots, eigenvalue);
  queue.on_graph(mission.graph);
  // A prioritiser of its own tells the scores, whatever the method.
  ObservabilityPrioritizer observability(config.observability, mission.robots, eigenvalue);
  std::set<Key> scanned;
  if (features) {
    std::set<Key> wanted;
    for (const LoopCandidate& c : candidates) wanted.insert({c.from, c.to});
    std::size_t done = 0;
    for (const Node& node : mission.graph.nodes()) {
      if (stop.stop_requested()) break;
      if (wanted.count(node.key) == 0) continue;
      if (progress) progress({"looking at scans", done++, wanted.size(), ""});
      KeyedScan scan;
      scan.key = node.key;
      scan.stamp_ns = node.stamp_ns;
      if (!features->get(node.key)) continue;
      observability.on_scan(scan);
      queue.on_scan(scan);
      scanned.insert(node.key);
    }
  }

  Ranking out;
  std::vector<CandidateScores> scores(candidates.size());
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const LoopCandidate& c = candidates[i];
    scores[i].candidate = c;
    scores[i].observability_from = scanned.count(c.from) != 0 ? observability.score(c.from) : kNaN;
    scores[i].observability_to = scanned.count(c.to) != 0 ? observability.score(c.to) : kNaN;
  }
  for (const Refusal& refusal : queue.add(candidates)) {
    scores[static_cast<std::size_t>(refusal.id)].refused = refusal.reason;
    ++out.refused[refusal.reason];
  }

  const auto batch = static_cast<std::size_t>(config.replay.batch);
  const std::size_t wanted = options.count > 0 ? options.count : batch;
  std::vector<LoopCandidate> ranked;
  while (ranked.size() < wanted && queue.size() > 0 && !stop.stop_requested()) {
    const std::size_t count = std::min(batch, wanted - ranked.size());
    queue.improve(count, stop, std::vector<std::uint64_t>(queue.prioritizers().size(), options.evaluations));
    const std::vector<LoopCandidate> next = queue.take(count);
    if (next.empty()) break;
    for (const LoopCandidate& c : next) {
      CandidateScores& s = scores[static_cast<std::size_t>(c.id)];
      ranked.push_back(c);
      s.rank = ranked.size();
    }
  }
  out.ranked = ranked.size();

  try {
    ClosureModelOptions closures = config.closure_model;
    closures.trace = TraceKind::kTranslation;
    CovarianceObjective of_ranked(mission.graph, ranked, closures);
    out.trace_m2 = of_ranked.value();
    std::vector<std::size_t> all(ranked.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    of_ranked.assign(all);
    out.trace_ranked_m2 = of_ranked.value();
    out.gains_exact = candidates.size() <= options.exact_up_to;
    std::vector<double> gains;
    if (out.gains_exact) {
      closures.holding = Holding::kColumns;
      CovarianceObjective objective(mission.graph, candidates, closures);
      gains = objective.add_changes();
      for (std::size_t i = 0; i < gains.size(); ++i) {
        gains[i] = gains[i] == 0.0 ? 0.0 : -gains[i];
        scores[i].connecting = objective.connecting(i);
      }
    } else {
      gains = sketched_gains(mission.graph, candidates, closures, closure_model(closures), kFineProbes,
                             config.replay.seed);
      for (std::size_t i = 0; i < gains.size(); ++i) scores[i].connecting = gains[i] == 0.0;
    }
    for (std::size_t i = 0; i < gains.size(); ++i) scores[i].gain_m2 = gains[i];
  } catch (const InputError& error) {
    out.problem = error.what();
    out.trace_m2 = out.trace_ranked_m2 = kNaN;
    for (CandidateScores& s : scores) s.gain_m2 = kNaN;
  }

  for (const LoopCandidate& c : ranked) out.candidates.push_back(scores[static_cast<std::size_t>(c.id)]);
  for (const CandidateScores& s : scores) {
    if (!s.rank) out.candidates.push_back(s);
  }
  return out;
}

}  // namespace loopwise
