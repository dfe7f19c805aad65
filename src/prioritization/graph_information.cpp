// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/graph_information.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <optional>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/effect_network.hpp>
#include <loopwise/prioritization/gnn.hpp>

#include "closure_factor.hpp"

namespace loopwise {
namespace {

std::vector<LoopCandidate> at(const std::vector<LoopCandidate>& all, const std::vector<std::size_t>& places) {
  std::vector<LoopCandidate> out;
  out.reserve(places.size());
  for (const std::size_t i : places) out.push_back(all[i]);
  return out;
}

/// Appends all elements except those at `places`.
void append_others(std::vector<LoopCandidate>& out, const std::vector<LoopCandidate>& all,
                   const std::vector<std::size_t>& places) {
  std::vector<bool> listed(all.size(), false);
  for (const std::size_t i : places) listed[i] = true;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (!listed[i]) out.push_back(all[i]);
  }
}

bool knows_nodes_of(const PoseGraph& graph, const LoopCandidate& candidate) {
  return graph.contains(candidate.from) && graph.contains(candidate.to);
}

}  // namespace

/// A prepared set and its inputs.
struct GraphInformationPrioritizer::Prepared {
  std::size_t count = 0;
  bool stale = false;                // the candidates or the graph have changed since then
  bool handed = false;               // candidates of the set were handed out
  std::vector<LoopCandidate> first;  // connecting candidates
  std::vector<LoopCandidate> list;   // candidates among which to choose
  std::vector<Eigen::Vector3d> midpoints;
  std::unique_ptr<GraphObjective> objective;
  std::optional<SimulatedAnnealing> annealing;
  std::vector<std::size_t> set;     // indices into list, most valuable first
  std::vector<LoopCandidate> rest;  // known candidates that are not in the list
  std::optional<std::vector<LoopCandidate>> reserve;

  std::size_t choose_connecting(const GraphInformationPrioritizer& of,
                                const std::vector<LoopCandidate>& connecting, std::size_t others,
                                std::size_t wanted);
  void make_objective(GraphInformationPrioritizer& of, const std::vector<LoopCandidate>& others,
                      std::size_t wanted, std::uint64_t seed);
  void choose_by_objective(GraphInformationPrioritizer& of, std::size_t wanted, std::uint64_t seed);
};

GraphInformationPrioritizer::GraphInformationPrioritizer(const GraphInformationOptions& options,
                                                         const ClosureModelOptions& closures,
                                                         const AnnealingOptions& annealing,
                                                         const GreedyOptions& greedy)
    : options_(options), closure_options_(closures), annealing_options_(annealing), greedy_options_(greedy) {
  validate(options_);
  validate(closure_options_);
  validate(annealing_options_);
  validate(greedy_options_);
  if (options_.objective == ObjectiveKind::kGnn) {
    if (options_.gnn_weights.empty()) throw OptionError("gnn_weights is empty, objective gnn needs a file");
    if (network_kind(options_.gnn_weights) == "loopwise") {
      effect_network_ = std::make_shared<const EffectNetwork>(options_.gnn_weights);
    } else {
      network_ = std::make_shared<const GraphNetwork>(options_.gnn_weights);
    }
  }
}

GraphInformationPrioritizer::~GraphInformationPrioritizer() = default;

std::vector<Refusal> GraphInformationPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  std::vector<Refusal> refused;
  for (const LoopCandidate& candidate : candidates) {
    if (candidate.from == candidate.to) {
      refused.push_back({candidate.id, "same_node"});
      continue;
    }
    held_.emplace(candidate.id, candidate);
    if (!knows_nodes_of(graph_, candidate)) unknown_.emplace(candidate.id, candidate);
  }
  if (prepared_ && !candidates.empty()) prepared_->stale = true;
  return refused;
}

void GraphInformationPrioritizer::remove(const std::vector<CandidateId>& ids) {
  for (const CandidateId id : ids) {
    held_.erase(id);
    unknown_.erase(id);
  }
}

void GraphInformationPrioritizer::on_graph(const PoseGraph& graph) {
  graph_ = graph;
  for (auto unknown = unknown_.begin(); unknown != unknown_.end();) {
    unknown = knows_nodes_of(graph_, unknown->second) ? unknown_.erase(unknown) : std::next(unknown);
  }
  if (prepared_) prepared_->stale = true;
}

void GraphInformationPrioritizer::on_result(const RegistrationResult& result) {
  if (!result.closure) return;
  const Vector6d variances = result.closure->covariance.diagonal();
  if (variances.allFinite() && variances.minCoeff() > 0.0) accepted_.push_back(variances);
}

std::vector<Refusal> GraphInformationPrioritizer::give_up(double now_s) {
  std::vector<Refusal> refused;
  if (options_.max_wait_s <= 0.0) return refused;
  while (!unknown_.empty() && now_s - unknown_.begin()->second.time_s > options_.max_wait_s) {
    refused.push_back({unknown_.begin()->first, "missing_node"});
    held_.erase(unknown_.begin()->first);
    unknown_.erase(unknown_.begin());
  }
  return refused;
}

ClosureModel GraphInformationPrioritizer::model() const {
  ClosureModel model = closure_model(closure_options_);
  if (options_.covariance == ClosureCovariance::kMedian && !accepted_.empty()) {
    for (int k = 0; k < 6; ++k) {
      std::vector<double> values;
      for (const Vector6d& v : accepted_) values.push_back(v[k]);
      const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
      std::nth_element(values.begin(), middle, values.end());
      model.covariance(k, k) = *middle;
    }
  }
  return model;
}

std::map<CandidateId, double> GraphInformationPrioritizer::sketch() const {
  std::vector<LoopCandidate> known;
  std::map<CandidateId, double> out;
  for (const auto& [id, c] : held_) {
    out[id] = 0.0;
    if (graph_.contains(c.from) && graph_.contains(c.to)) known.push_back(c);
  }
  if (known.empty()) return out;
  const std::vector<double> gains =
      sketched_gains(graph_, known, closure_options_, model(), static_cast<std::size_t>(options_.probes),
                     combine_seeds(options_.seed, 0));
  for (std::size_t i = 0; i < known.size(); ++i) out[known[i].id] = gains[i];
  return out;
}

void GraphInformationPrioritizer::prepare(std::size_t count) {
  prepared_.reset();  // so that an exception below does not leave a partial set
  auto prepared = std::make_unique<Prepared>();
  prepared->count = count;
  choose(*prepared, count);
  prepared_ = std::move(prepared);
}

void GraphInformationPrioritizer::choose(Prepared& p, std::size_t count) {
  status_ = {};
  const std::uint64_t seed = combine_seeds(options_.seed, ++round_);

  std::vector<LoopCandidate> connecting, others;
  const detail::GraphComponents parts(graph_);
  for (const auto& [id, candidate] : held_) {
    const auto from = graph_.find(candidate.from), to = graph_.find(candidate.to);
    if (!from || !to) continue;
    (parts.connecting(*from, *to) ? connecting : others).push_back(candidate);
  }
  status_.pool = connecting.size() + others.size();
  count = std::min(count, status_.pool);
  if (!connecting.empty()) count -= p.choose_connecting(*this, connecting, others.size(), count);
  if (others.empty()) return;

  const auto spread_alone = [&] {
    p.list = others;
    p.set = farthest_points(candidate_midpoints(graph_, others), count);
  };
  if (options_.selector == SelectorKind::kSeparated) {
    spread_alone();
    return;
  }
  try {
    if (options_.selector == SelectorKind::kLargestCovariance) {
      p.list = others;
      p.set = largest_covariance(graph_, others, marginals(graph_).covariances, count);
      return;
    }
    p.make_objective(*this, others, count, seed);
  } catch (const InputError& error) {
    // If the factors leave a pose undetermined, the covariance does not exist, but positions do.
    status_.problem = error.what();
    p.rest.clear();
    p.objective.reset();
    spread_alone();
    return;
  }
  p.choose_by_objective(*this, count, seed);
}

/// Chooses candidates that connect components of the graph, far from each other. \returns their number
std::size_t GraphInformationPrioritizer::Prepared::choose_connecting(
    const GraphInformationPrioritizer& of, const std::vector<LoopCandidate>& connecting, std::size_t others,
    std::size_t wanted) {
  const auto share =
      static_cast<std::size_t>(std::ceil(of.greedy_options_.connecting_share * static_cast<double>(wanted)));
  const std::size_t ties =
      std::min({std::max(share, wanted - std::min(wanted, others)), connecting.size(), wanted});
  const auto chosen = farthest_points(candidate_midpoints(of.graph_, connecting), ties);
  first = at(connecting, chosen);
  append_others(rest, connecting, chosen);
  return ties;
}

/// Makes the shortlist for a set of `wanted` candidates, and the objective over it.
void GraphInformationPrioritizer::Prepared::make_objective(GraphInformationPrioritizer& of,
                                                           const std::vector<LoopCandidate>& others,
                                                           std::size_t wanted, std::uint64_t seed) {
  const ClosureModel closures = of.model();
  const auto longest = static_cast<std::size_t>(
      std::ceil(of.options_.shortlist * static_cast<double>(std::max<std::size_t>(wanted, 1))));
  std::vector<std::size_t> shortlist(others.size());
  std::iota(shortlist.begin(), shortlist.end(), std::size_t{0});
  if (others.size() > longest) {
    const std::vector<double> gains = sketched_gains(of.graph_, others, of.closure_options_, closures,
                                                     static_cast<std::size_t>(of.options_.probes), seed);
    shortlist = spread_shortlist(of.graph_, others, gains, longest, of.options_.cell_m);
    append_others(rest, others, shortlist);
  }
  list = at(others, shortlist);
  of.status_.shortlist = list.size();
  switch (of.options_.objective) {
    case ObjectiveKind::kCovariance:
      objective = std::make_unique<CovarianceObjective>(of.graph_, list, of.closure_options_, closures);
      break;
    case ObjectiveKind::kLogDet:
      objective = std::make_unique<LogDetObjective>(of.graph_, list, of.closure_options_, closures);
      break;
    case ObjectiveKind::kGnn:
      if (of.effect_network_) {
        objective = std::make_unique<EffectObjective>(of.graph_, list, of.effect_network_,
                                                      of.closure_options_, closures);
        break;
      }
      objective = std::make_unique<GnnObjective>(of.graph_, list, of.network_, of.options_.gnn_features,
                                                 marginals(of.graph_).covariances);
  }
}

void GraphInformationPrioritizer::Prepared::choose_by_objective(GraphInformationPrioritizer& of,
                                                                std::size_t wanted, std::uint64_t seed) {
  midpoints = candidate_midpoints(of.graph_, list);
  if (of.options_.selector == SelectorKind::kAnnealing) {
    annealing.emplace(*objective, midpoints, wanted, of.annealing_options_, seed);
    set = annealing->best().set;
    of.status_.start_value = of.status_.value = annealing->start_value();
    return;
  }
  const Selection chosen = greedy(*objective, midpoints, wanted, of.greedy_options_);
  set = chosen.set;
  of.status_.start_value = of.status_.value = chosen.value;
  if (of.options_.selector == SelectorKind::kGreedyAnnealing && !set.empty()) {
    annealing.emplace(*objective, midpoints, wanted, of.annealing_options_, seed, set);
  }
}

std::uint64_t GraphInformationPrioritizer::improve(std::size_t count, const StopToken& stop,
                                                   std::uint64_t max_evaluations) {
  if (!prepared_ || prepared_->stale || prepared_->handed || prepared_->count != count) prepare(count);
  Prepared& p = *prepared_;
  if (!p.annealing || max_evaluations == 0) return 0;
  try {
    const std::uint64_t before = p.annealing->evaluations();
    p.annealing->run(max_evaluations, stop);
    const std::uint64_t used = p.annealing->evaluations() - before;
    const Selection best = p.annealing->best();
    p.set = best.set;
    status_.value = best.value;
    status_.steps = p.annealing->steps();
    status_.accepted = p.annealing->accepted();
    return used;
  } catch (...) {
    prepared_.reset();
    throw;
  }
}

std::vector<LoopCandidate> GraphInformationPrioritizer::take(std::size_t count) {
  if (count == 0 || held_.empty()) return {};
  std::vector<std::map<CandidateId, LoopCandidate>::node_type> taken;
  try {
    std::vector<LoopCandidate> out;
    taken.reserve(std::min(count, held_.size()));
    out.reserve(taken.capacity());
    take(count, taken, out);
    return out;
  } catch (...) {  // the caller gets no candidates: they are held again, and the next call prepares a new set
    for (auto& node : taken) held_.insert(std::move(node));
    prepared_.reset();
    throw;
  }
}

void GraphInformationPrioritizer::take(std::size_t count,
                                       std::vector<std::map<CandidateId, LoopCandidate>::node_type>& taken,
                                       std::vector<LoopCandidate>& out) {
  const std::size_t missing = count - out.size();
  const bool usable = prepared_ && (prepared_->handed || (!prepared_->stale && prepared_->count >= missing));
  if (!usable) prepare(missing);
  Prepared& p = *prepared_;
  const auto hand_out = [&](const LoopCandidate& candidate) {
    if (out.size() >= count) return;
    auto node = held_.extract(candidate.id);
    if (node.empty()) return;
    out.push_back(candidate);
    taken.push_back(std::move(node));
  };
  for (const LoopCandidate& candidate : p.first) hand_out(candidate);
  if (options_.selector == SelectorKind::kAnnealing && p.objective && !p.handed) {
    // An annealed set has no order. The candidates whose removal costs most come first.
    p.objective->assign(p.set);
    std::map<std::size_t, double> missed;
    for (const std::size_t i : p.set) missed[i] = p.objective->remove_change(i);
    std::stable_sort(p.set.begin(), p.set.end(),
                     [&](std::size_t a, std::size_t b) { return missed[a] > missed[b]; });
  }
  for (const std::size_t i : p.set) hand_out(p.list[i]);
  if (out.size() < count && !p.reserve) {
    // Other prioritisers took candidates of the set: the next best ones replace them.
    p.reserve.emplace();
    std::vector<bool> chosen(p.list.size(), false);
    for (const std::size_t i : p.set) chosen[i] = true;
    std::vector<std::size_t> next;
    for (std::size_t i = 0; i < p.list.size(); ++i) {
      if (!chosen[i]) next.push_back(i);
    }
    if (p.objective && !next.empty()) {
      p.objective->assign(p.set);
      const std::vector<double> changes = p.objective->add_changes();
      std::stable_sort(next.begin(), next.end(),
                       [&](std::size_t a, std::size_t b) { return changes[a] < changes[b]; });
    }
    *p.reserve = at(p.list, next);
    p.reserve->insert(p.reserve->end(), p.rest.begin(), p.rest.end());
  }
  if (p.reserve) {
    for (const LoopCandidate& candidate : *p.reserve) {
      if (out.size() == count) break;
      hand_out(candidate);
    }
  }
  p.handed = true;
  if (out.size() < count && p.stale) {
    // A new set includes the candidates that arrived after the last one was prepared.
    prepared_.reset();
    if (!held_.empty()) take(count, taken, out);
  }
}

}  // namespace loopwise
