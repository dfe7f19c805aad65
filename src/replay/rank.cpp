// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/rank.hpp>

#include <algorithm>
#include <exception>
#include <limits>
#include <numeric>
#include <set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/engine/scan_insight.hpp>
#include <loopwise/io/csv.hpp>

#include "mission_feed.hpp"

namespace loopwise {
namespace {

using KeyPair = std::pair<Key, Key>;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kFineProbes = 256;

/// Collects the candidates that the engine proposes.
class Collector final : public Prioritizer {
 public:
  explicit Collector(std::vector<LoopCandidate>& all) : all_(all) {}
  [[nodiscard]] std::string_view name() const override { return "collector"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    all_.insert(all_.end(), candidates.begin(), candidates.end());
    return {};
  }
  void remove(const std::vector<CandidateId>& /*ids*/) override {}
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t /*count*/) override { return {}; }
  [[nodiscard]] std::size_t size() const override { return 0; }

 private:
  std::vector<LoopCandidate>& all_;
};

KeyPair pair_of(Key a, Key b) {
  return std::minmax(a, b);
}

}  // namespace

std::vector<LoopCandidate> all_candidates(const Mission& mission, const ReplayOptions& options) {
  EngineOptions without_limits = options.engine;
  without_limits.pool = CandidatePoolOptions();
  without_limits.use_back_end = false;
  std::vector<LoopCandidate> all;
  std::vector<std::unique_ptr<Prioritizer>> collector;
  collector.push_back(std::make_unique<Collector>(all));
  Engine engine(mission.robots, without_limits, RoundRobinQueue(std::move(collector)));
  const auto feed = [&engine](Event event, double time_s) {
    for (const Effect& effect : engine.handle(std::move(event), time_s)) {
      const auto* problem = std::get_if<effect::Problem>(&effect);
      if (problem != nullptr && problem->cause) std::rethrow_exception(problem->cause);
    }
  };
  const auto any_cloud = std::make_shared<const PointCloud>();
  for (const ClosureDecision& decision : decisions_of(mission, options)) feed(decision, 0.0);
  for (const Arrival& arrival : mission_feed(mission, options)) {
    for (const BeaconDrop& drop : arrival.drops) feed(drop, arrival.time_s);
    if (!arrival.readings.empty()) feed(event::Radio{arrival.readings}, arrival.time_s);
    KeyFrame without_odometry;  // without its odometry, which would move it
    without_odometry.node = arrival.frame.node;
    if (!arrival.candidates.empty()) feed(event::Candidates{arrival.candidates}, arrival.time_s);
    feed(without_odometry, arrival.time_s);
    feed(event::Scan{{arrival.frame.node.key, arrival.frame.node.stamp_ns, any_cloud}}, arrival.time_s);
  }
  std::set<KeyPair> known;
  for (const Edge& edge : mission.graph.edges()) known.insert(pair_of(edge.from, edge.to));
  all.erase(std::remove_if(all.begin(), all.end(),
                           [&](const LoopCandidate& c) { return known.count(pair_of(c.from, c.to)) != 0; }),
            all.end());
  std::sort(all.begin(), all.end(),
            [](const LoopCandidate& a, const LoopCandidate& b) { return a.id < b.id; });
  for (std::size_t i = 0; i < all.size(); ++i) all[i].id = i;
  return all;
}

namespace {

using Queue = RoundRobinQueue;

/// Announces the scans of the candidates' nodes to the prioritisers. \returns the nodes that have a scan
std::set<Key> announce_scans(const Mission& mission, const std::vector<LoopCandidate>& candidates,
                             FeatureCache& features, ObservabilityPrioritizer& observability, Queue& queue,
                             const ProgressCallback& progress, const StopToken& stop) {
  std::set<Key> wanted, scanned;
  for (const LoopCandidate& c : candidates) wanted.insert({c.from, c.to});
  std::size_t done = 0;
  for (const Node& node : mission.graph.nodes()) {
    if (stop.stop_requested()) break;
    if (wanted.count(node.key) == 0) continue;
    if (progress) progress({"reading scans", done++, wanted.size(), ""});
    if (!features.get(node.key)) continue;
    const KeyedScan scan{node.key, node.stamp_ns, nullptr};
    observability.on_scan(scan);
    queue.on_scan(scan);
    scanned.insert(node.key);
  }
  return scanned;
}

/// The order in which a replay would take the candidates, batch by batch.
std::vector<LoopCandidate> order_of(Queue& queue, std::size_t batch, const RankOptions& options,
                                    const StopToken& stop) {
  const std::size_t wanted = options.count > 0 ? options.count : batch;
  const std::vector<std::uint64_t> bounds(queue.prioritizers().size(), options.evaluations);
  std::vector<LoopCandidate> ranked;
  while (ranked.size() < wanted && queue.size() > 0 && !stop.stop_requested()) {
    const std::size_t count = std::min(batch, wanted - ranked.size());
    std::vector<std::uint64_t> used;
    queue.improve(count, stop, bounds, used);
    const std::vector<LoopCandidate> next = queue.take(count);
    if (next.empty()) break;
    ranked.insert(ranked.end(), next.begin(), next.end());
  }
  return ranked;
}

/// Computes the trace of the covariance, and the decrease by each candidate's closure alone. \throws
/// InputError if the graph leaves a pose undetermined
void judge(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
           const std::vector<LoopCandidate>& ranked, ClosureModelOptions closures, std::size_t exact_up_to,
           std::uint64_t seed, Ranking& out, std::vector<CandidateScores>& scores) {
  closures.trace = TraceKind::kTranslation;
  CovarianceObjective of_ranked(graph, ranked, closures);
  out.trace_m2 = of_ranked.value();
  std::vector<std::size_t> all(ranked.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  of_ranked.assign(all);
  out.trace_ranked_m2 = of_ranked.value();
  out.gains_exact = candidates.size() <= exact_up_to;
  std::vector<double> gains;
  if (out.gains_exact) {
    closures.storage = BlockStorage::kColumns;
    CovarianceObjective objective(graph, candidates, closures);
    gains = objective.add_changes();
    for (std::size_t i = 0; i < gains.size(); ++i) {
      gains[i] = gains[i] == 0.0 ? 0.0 : -gains[i];
      scores[i].connecting = objective.connecting(i);
    }
  } else {
    gains = sketched_gains(graph, candidates, closures, closure_model(closures), kFineProbes, seed);
    for (std::size_t i = 0; i < gains.size(); ++i) scores[i].connecting = gains[i] == 0.0;
  }
  for (std::size_t i = 0; i < gains.size(); ++i) scores[i].gain_m2 = gains[i];
}

}  // namespace

Ranking rank_candidates(const Mission& mission, const ReplayOptions& replay,
                        std::shared_ptr<FeatureCache> features, const RankOptions& options,
                        const ProgressCallback& progress, const StopToken& stop) {
  validate_replay(replay);
  const std::vector<LoopCandidate> candidates = all_candidates(mission, replay);
  const PrioritizationOptions& order = replay.prioritization;
  ScanInsight insight;
  if (features) {
    insight = scan_insight(*features, order.observability.variant);
  } else {
    insight.eigenvalue = [](const KeyedScan&) { return 0.0; };
  }
  Queue queue(make_prioritizers(order, replay.engine.seed, mission.robots, insight));
  queue.on_graph(mission.graph);
  // The scores come from a separate prioritiser, so that they exist for every method.
  ObservabilityPrioritizer observability(order.observability, mission.robots, insight.eigenvalue);
  std::set<Key> scanned;
  if (features) {
    scanned = announce_scans(mission, candidates, *features, observability, queue, progress, stop);
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
  const std::vector<LoopCandidate> ranked = order_of(queue, batch_size(replay), options, stop);
  out.ranked = ranked.size();
  for (std::size_t i = 0; i < ranked.size(); ++i) scores[static_cast<std::size_t>(ranked[i].id)].rank = i + 1;
  try {
    judge(mission.graph, candidates, ranked, order.closure_model, options.exact_up_to, replay.engine.seed,
          out, scores);
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

std::string ranking_csv(const Ranking& ranking) {
  CsvText csv({"rank", "from", "to", "source", "distance_m", "observability_from", "observability_to",
               "gain_m2", "connecting", "refused"});
  for (const CandidateScores& s : ranking.candidates) {
    csv.row(s.rank ? std::to_string(*s.rank) : "", s.candidate.from, s.candidate.to,
            enum_name(s.candidate.source), s.candidate.distance_m, s.observability_from, s.observability_to,
            s.gain_m2, s.connecting ? 1 : 0, s.refused);
  }
  return csv.text();
}

}  // namespace loopwise
