// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/selection.hpp>

#include <algorithm>
#include <cmath>
#include <queue>
#include <utility>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

void check_midpoints(const GraphObjective& objective, const std::vector<Eigen::Vector3d>& midpoints) {
  if (midpoints.size() == objective.size()) return;
  throw InputError(std::to_string(midpoints.size()) + " midpoints, expected one for each of " +
                   std::to_string(objective.size()) + " candidates");
}

/// Fills the set up to `count`: by descending gain if gains are known, otherwise by index.
void fill(GraphObjective& objective, std::size_t count, const std::vector<double>& changes,
          std::vector<std::size_t>& set) {
  std::vector<std::size_t> rest;
  for (std::size_t i = 0; i < objective.size(); ++i) {
    if (!objective.contains(i)) rest.push_back(i);
  }
  if (!changes.empty()) {
    std::stable_sort(rest.begin(), rest.end(),
                     [&](std::size_t a, std::size_t b) { return changes[a] < changes[b]; });
  }
  for (const std::size_t i : rest) {
    if (set.size() >= count) break;
    set.push_back(i);
  }
  objective.assign(set);
}

}  // namespace

std::vector<std::size_t> farthest_points(const std::vector<Eigen::Vector3d>& points, std::size_t count) {
  count = std::min(count, points.size());
  std::vector<std::size_t> out;
  if (count == 0) return out;
  out.reserve(count);
  Eigen::Vector3d centroid = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) centroid += p / static_cast<double>(points.size());
  std::vector<double> nearest(points.size());  // squared distance to the chosen points; negative if chosen
  for (std::size_t i = 0; i < points.size(); ++i) nearest[i] = (points[i] - centroid).squaredNorm();
  for (bool first = true; out.size() < count; first = false) {
    const auto next =
        static_cast<std::size_t>(std::max_element(nearest.begin(), nearest.end()) - nearest.begin());
    out.push_back(next);
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (nearest[i] < 0.0) continue;
      const double d = (points[i] - points[next]).squaredNorm();
      nearest[i] = first ? d : std::min(nearest[i], d);
    }
    nearest[next] = -1.0;
  }
  return out;
}

std::vector<std::size_t> largest_covariance(const PoseGraph& graph,
                                            const std::vector<LoopCandidate>& candidates,
                                            const std::vector<Matrix6d>& covariances, std::size_t count) {
  if (covariances.size() != graph.nodes().size()) {
    throw InputError(std::to_string(covariances.size()) + " covariances, expected one for each of " +
                     std::to_string(graph.nodes().size()) + " nodes");
  }
  std::vector<double> score;
  for (const LoopCandidate& c : candidates) {
    const double sum = covariances[graph.index_of(c.from)].topLeftCorner<3, 3>().trace() +
                       covariances[graph.index_of(c.to)].topLeftCorner<3, 3>().trace();
    score.push_back(std::isfinite(sum) ? sum : 0.0);
  }
  std::vector<std::size_t> order(candidates.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return score[a] > score[b]; });
  order.resize(std::min(count, order.size()));
  return order;
}

Selection greedy(GraphObjective& objective, const std::vector<Eigen::Vector3d>& midpoints, std::size_t count,
                 const GreedyOptions& options, const StopToken& stop) {
  validate(options);
  check_midpoints(objective, midpoints);
  count = std::min(count, objective.size());
  objective.assign({});
  Selection out;

  std::vector<std::size_t> connecting;
  std::vector<Eigen::Vector3d> connecting_midpoints;
  for (std::size_t i = 0; i < objective.size(); ++i) {
    if (!objective.connecting(i)) continue;
    connecting.push_back(i);
    connecting_midpoints.push_back(midpoints[i]);
  }
  const std::size_t others = objective.size() - connecting.size();
  const auto share =
      static_cast<std::size_t>(std::ceil(options.connecting_share * static_cast<double>(count)));
  const std::size_t ties = std::max(share, count - std::min(count, others));
  for (const std::size_t k : farthest_points(connecting_midpoints, std::min(ties, count))) {
    objective.add(connecting[k]);
    out.set.push_back(connecting[k]);
  }

  std::vector<double> changes;
  if (options.lazy && !stop.stop_requested() && out.set.size() < count) {
    changes = objective.add_changes();
    out.evaluations += changes.size();
    using Entry = std::pair<double, std::size_t>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
    for (std::size_t i = 0; i < changes.size(); ++i) {
      if (!objective.contains(i) && !objective.connecting(i)) queue.emplace(changes[i], i);
    }
    while (out.set.size() < count && !queue.empty() && !stop.stop_requested()) {
      const std::size_t i = queue.top().second;
      queue.pop();
      changes[i] = objective.add_change(i);
      ++out.evaluations;
      if (!queue.empty() && Entry(changes[i], i) > queue.top()) {
        queue.emplace(changes[i], i);
        continue;
      }
      objective.add(i);
      out.set.push_back(i);
    }
  }
  while (!options.lazy && out.set.size() < count && !stop.stop_requested()) {
    changes = objective.add_changes();
    out.evaluations += changes.size() - out.set.size();
    std::size_t best = changes.size();
    for (std::size_t i = 0; i < changes.size(); ++i) {
      if (objective.contains(i) || objective.connecting(i)) continue;
      if (best == changes.size() || changes[i] < changes[best]) best = i;
    }
    if (best == changes.size()) break;
    objective.add(best);
    out.set.push_back(best);
  }
  if (out.set.size() < count) {
    out.stopped = stop.stop_requested();
    if (changes.empty()) {  // stopped before the first evaluation
      for (const std::size_t i : farthest_points(midpoints, midpoints.size())) {
        if (out.set.size() >= count) break;
        if (!objective.contains(i)) out.set.push_back(i);
      }
      objective.assign(out.set);
    } else {
      fill(objective, count, changes, out.set);
    }
  }
  out.value = objective.value();
  return out;
}

AnnealingOptions annealing_preset(std::string_view name) {
  AnnealingOptions options;
  if (name == "default") return options;
  if (name == "lamp") {
    options.temperature_max = 3.0;
    options.absolute = true;
    options.distance_floor_m = 1e-7;
    return options;
  }
  throw OptionError("preset = \"" + std::string(name) + "\", must be one of: default, lamp");
}

SimulatedAnnealing::SimulatedAnnealing(GraphObjective& objective, std::vector<Eigen::Vector3d> midpoints,
                                       std::size_t count, const AnnealingOptions& options, std::uint64_t seed,
                                       const std::vector<std::size_t>& initial)
    : objective_(objective), midpoints_(std::move(midpoints)), options_(options), rng_(seed) {
  validate(options_);
  check_midpoints(objective_, midpoints_);
  count = std::min(count, objective_.size());
  if (!initial.empty() && initial.size() != count) {
    throw InputError(std::to_string(initial.size()) + " initial members, expected " + std::to_string(count));
  }
  start_ = initial.empty() ? farthest_points(midpoints_, count) : initial;
  objective_.assign(start_);
  for (std::size_t i = 0; i < objective_.size(); ++i) {
    if (!objective_.contains(i)) outside_.push_back(i);
  }
  best_ = start_;
  value_ = start_value_ = best_value_ = objective_.value();
  first_temperature_ = options_.temperature_max * (initial.empty() ? 1.0 : options_.seeded_share);
  scaled_ = options_.absolute;
  scale_ = 1.0;
}

std::size_t SimulatedAnnealing::choose_partner(std::size_t out) {
  const auto most = static_cast<std::size_t>(options_.partners);
  drawn_.clear();
  if (outside_.size() <= most) {
    for (std::size_t k = 0; k < outside_.size(); ++k) drawn_.push_back(k);
  } else {
    for (std::size_t k = 0; k < most; ++k)
      drawn_.push_back(static_cast<std::size_t>(rng_.below(outside_.size())));
  }
  odds_.resize(drawn_.size());
  double sum = 0.0;
  for (std::size_t k = 0; k < drawn_.size(); ++k) {
    const double distance = (midpoints_[outside_[drawn_[k]]] - midpoints_[out]).norm();
    sum += odds_[k] = 1.0 / std::max(distance, options_.distance_floor_m);
  }
  double pick = rng_.uniform() * sum;
  std::size_t k = 0;
  while (k + 1 < drawn_.size() && pick >= odds_[k]) pick -= odds_[k++];
  return drawn_[k];
}

void SimulatedAnnealing::find_scale(std::uint64_t& budget, const StopToken& stop) {
  const auto wanted = static_cast<std::size_t>(options_.scale_samples);
  while (scale_samples_.size() < wanted && budget > 0 && !stop.stop_requested()) {
    const std::size_t out = objective_.selected()[rng_.below(objective_.selected().size())];
    const std::size_t in = outside_[rng_.below(outside_.size())];
    scale_samples_.push_back(std::abs(objective_.swap_change(out, in)));
    ++evaluations_;
    --budget;
  }
  if (scale_samples_.size() < wanted) return;
  const auto middle = scale_samples_.begin() + static_cast<std::ptrdiff_t>(wanted / 2);
  std::nth_element(scale_samples_.begin(), middle, scale_samples_.end());
  scale_ = *middle;
  scaled_ = true;
}

void SimulatedAnnealing::run(std::uint64_t evaluations, const StopToken& stop) {
  stopped_ = false;
  if (outside_.empty() || objective_.selected().empty()) return;
  if (parked_) {
    objective_.assign(current_);
    parked_ = false;
  }
  if (!scaled_) find_scale(evaluations, stop);
  const auto most = static_cast<std::uint64_t>(options_.max_steps);
  while (scaled_ && evaluations > 0 && (most == 0 || steps_ < most) && !stop.stop_requested()) {
    --evaluations;
    ++evaluations_;
    ++steps_;
    const double T =
        scale_ * std::max(first_temperature_ * std::pow(options_.cooling, static_cast<double>(steps_)),
                          options_.temperature_min);
    const std::size_t out = objective_.selected()[rng_.below(objective_.selected().size())];
    const std::size_t place = choose_partner(out);
    const std::size_t in = outside_[place];
    const double change = objective_.swap_change(out, in);
    const double draw = rng_.uniform();
    if (!(change < 0.0 || (T > 0.0 && std::exp(-change / T) > draw))) continue;
    objective_.swap(out, in);
    outside_[place] = out;
    ++accepted_;
    value_ = objective_.value();
    if (value_ < best_value_) {
      best_value_ = value_;
      best_ = objective_.selected();
    }
  }
  stopped_ = stop.stop_requested();
}

Selection SimulatedAnnealing::best() {
  if (!parked_) {
    current_ = objective_.selected();
    parked_ = true;
  }
  Selection out;
  objective_.assign(best_);
  out.value = objective_.value();
  if (out.value > start_value_) {  // an improvement below the rounding error was not real
    best_ = start_;
    best_value_ = start_value_;
    objective_.assign(best_);
    out.value = start_value_;
  }
  out.set = best_;
  out.evaluations = evaluations_;
  out.accepted = accepted_;
  out.stopped = stopped_;
  return out;
}

}  // namespace loopwise
