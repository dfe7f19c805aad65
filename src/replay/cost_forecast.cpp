// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/cost_forecast.hpp>

#include <algorithm>
#include <cstdio>
#include <set>
#include <utility>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/optimization/odometry_covariances.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/task.hpp>

#include "mission_feed.hpp"

namespace loopwise {
namespace {

/// A uniform sample of a stream (Vitter's algorithm R).
class Sample {
 public:
  explicit Sample(std::size_t size) : size_(size) {}
  void see(const LoopCandidate& candidate) {
    ++seen_;
    if (kept_.size() < size_) {
      kept_.push_back(candidate);
    } else if (const std::uint64_t at = rng_.below(seen_); at < size_) {
      kept_[at] = candidate;
    }
  }
  [[nodiscard]] std::size_t seen() const { return seen_; }
  [[nodiscard]] const std::vector<LoopCandidate>& kept() const { return kept_; }

 private:
  std::size_t size_, seen_ = 0;
  std::vector<LoopCandidate> kept_;
  Rng rng_{0xf0eca57};
};

std::string fixed1(double value) {
  char text[64];
  return {text, static_cast<std::size_t>(std::snprintf(text, sizeof text, "%.1f", value))};
}

/// Short times in seconds, as "0.0 min" says nothing.
std::string duration(double seconds) {
  return seconds < 60.0 ? fixed1(seconds) + " s" : fixed1(seconds / 60.0) + " min";
}

}  // namespace

CostForecast forecast_cost(const Mission& mission, const ReplayOptions& options, std::size_t sample,
                           const StopToken& stop) {
  validate_replay(options);
  const std::vector<Arrival> feed = mission_feed(mission, options);
  const std::vector<Eigen::Isometry3d> odometry = odometry_of(feed, mission.robots);
  ProximityGenerator generator(options.engine.generation, mission.robots);
  PoseGraph graph;
  Sample chosen(sample);
  const auto has_scan = [&](Key key) { return mission.scans->has(key); };
  for (std::size_t i = 0; i < feed.size() && !stop.stop_requested(); ++i) {
    Node node = feed[i].frame.node;
    node.pose = odometry[i];
    graph.add_node(node);
    if (mission.robots.is_landmark(node.key) || !options.engine.use_proximity) continue;
    for (const LoopCandidate& candidate : generator.on_node(graph, node.key, feed[i].time_s)) {
      if (has_scan(candidate.from) && has_scan(candidate.to) && kept_by_thinning(options.engine, candidate))
        chosen.see(candidate);
    }
  }
  for (const Edge& edge : replay_edges(mission, options)) {
    if (graph.contains(edge.from) && graph.contains(edge.to)) graph.add_edge(edge);
  }

  for (const Arrival& arrival : feed) {
    for (const PriorFactor& prior : arrival.frame.priors) {
      if (graph.contains(prior.key)) graph.add_prior(prior);
    }
  }

  CostForecast forecast;
  forecast.candidates = chosen.seen();
  forecast.mission_s = feed.empty() ? 0.0 : feed.back().time_s;
  const Registration registration = make_registration(options.registration, mission.scans->loader());
  forecast.scans = mission.scans->size();
  // Each registration is computed twice: first with the preparation of new scans, then without.
  std::set<Key> prepared;
  double cold_s = 0.0, warm_s = 0.0;
  OdometryCovariances covariances;
  covariances.update(graph);
  for (const LoopCandidate& candidate : chosen.kept()) {
    if (stop.stop_requested()) break;
    RegistrationTask task =
        make_task(graph, mission.robots, candidate, options.engine.task, options.engine.seed, has_scan);
    if (task.guess_from_to) {
      task.guess_covariance =
          covariances.between(graph.index_of(candidate.from), graph.index_of(candidate.to));
    }
    for (const auto* members : {&task.source, &task.target}) {
      for (const SubmapMember& member : *members) prepared.insert(member.key);
    }
    cold_s += compute_or_fail(*registration.registrar, task).seconds();
    warm_s += compute_or_fail(*registration.registrar, task).seconds();
    ++forecast.measured;
  }
  if (forecast.measured == 0) return forecast;
  forecast.registration_s = warm_s / static_cast<double>(forecast.measured);
  forecast.preparation_s = std::max(0.0, cold_s - warm_s) / static_cast<double>(prepared.size());
  return forecast;
}

CostForecast forecast_cost(const ReplayResult& result) {
  CostForecast forecast;
  const auto without_scan = result.expired.find("missing_scan");
  forecast.candidates =
      result.accounting.queued() - (without_scan == result.expired.end() ? 0 : without_scan->second);
  forecast.mission_s = result.mission_end_s;
  double sum_s = 0.0;
  for (const ComputedCandidate& computed : result.computed) {
    const double seconds = computed.result.seconds();
    if (!(seconds > 0.0)) continue;  // the outcome was already known
    sum_s += seconds;
    ++forecast.measured;
  }
  if (forecast.measured > 0) forecast.registration_s = sum_s / static_cast<double>(forecast.measured);
  return forecast;
}

std::string forecast_text(const CostForecast& forecast, int threads) {
  if (forecast.measured == 0 || forecast.candidates == 0) return {};
  return std::to_string(forecast.candidates) + " candidates take " + duration(forecast.all_s(threads)) +
         " on " + std::to_string(threads) + (threads == 1 ? " thread" : " threads") +
         " of this machine (by " + std::to_string(forecast.measured) + " registrations), the mission lasts " +
         fixed1(forecast.mission_s / 60.0) + " min: " +
         (forecast.all_in_time(threads) ? "a live run computes them all, and the method hardly matters"
                                        : "a live run computes a part, and the method decides which");
}

}  // namespace loopwise
