// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/engine.hpp>

#include <algorithm>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/recognition.hpp>

#include "engine_impl.hpp"

namespace loopwise {

std::vector<Effect> Engine::Impl::handle(Event event, double now_s) {
  check_event(event, robots_);
  now_s_ = std::max(now_s_, now_s);
  effects_.clear();
  std::visit([this](auto& e) { on(e); }, event);
  propose_moved();
  return std::exchange(effects_, {});
}

bool Engine::Impl::wants_batch() const {
  return !computing_ && may_choose_ && pool_.accounting().pending > 0;
}

void Engine::Impl::emit(Effect&& effect) {
  effects_.push_back(std::move(effect));
}

void Engine::Impl::problem(std::string topic, std::string detail, std::exception_ptr cause) {
  emit(effect::Problem{std::move(topic), std::move(detail), std::move(cause)});
}

std::shared_ptr<const Estimate> Engine::Impl::snapshot() {
  if (!snapshot_) {
    auto copy = std::make_shared<Estimate>();
    copy->graph = graph_;
    snapshot_ = std::move(copy);
  }
  return snapshot_;
}

PoseGraph& Engine::Impl::change_graph() {
  snapshot_.reset();
  return graph_;
}

void Engine::Impl::on(KeyFrame& frame) {
  Node& node = frame.node;
  if (graph_.contains(node.key)) throw InputError("node " + key_name(node.key) + " was added before");
  const std::vector<Factor> own = factors_of(frame);
  node.covariance.reset();
  Placement::Known known;
  const auto know = [&known](const Factor& factor) {
    if (const Edge* edge = std::get_if<Edge>(&factor)) known.edges.push_back(edge);
    if (const auto* prior = std::get_if<PriorFactor>(&factor)) known.priors.push_back(prior);
  };
  for (const Factor& factor : own) know(factor);
  const auto [first, last] = waiting_factors_.equal_range(node.key);
  for (auto waiting = first; waiting != last; ++waiting) know(waiting->second.second);
  node.pose = placement_.add(graph_, node, known);
  change_graph().add_node(node);
  graph_is_new_ = may_choose_ = true;
  add_factors(own);
  std::vector<Factor> waited;
  for (auto [waiting, end] = waiting_factors_.equal_range(node.key); waiting != end; ++waiting) {
    waited.push_back(std::move(waiting->second.second));
  }
  waiting_factors_.erase(node.key);
  add_factors(waited);

  // Radio comes first, so that a pair that both propose counts as proposed by radio.
  std::vector<LoopCandidate> candidates = radio_.on_node(graph_, node.key, now_s_);
  if (options_.use_proximity && prioritizes_) {
    const std::vector<LoopCandidate> near = generator_.on_node(graph_, node.key, now_s_);
    candidates.insert(candidates.end(), near.begin(), near.end());
  }
  propose(std::move(candidates));
  if (const auto early = early_scans_.find(node.key); early != early_scans_.end()) {
    announce({node.key, node.stamp_ns, early->second});
    early_scans_.erase(early);
  } else if (frame.cloud) {
    announce({node.key, node.stamp_ns, frame.cloud});
  }
}

void Engine::Impl::add_factors(const std::vector<Factor>& factors) {
  for (const Factor& factor : factors) {
    const std::vector<Key> keys = keys_of(factor);
    const auto missing =
        std::find_if(keys.begin(), keys.end(), [this](Key key) { return !graph_.contains(key); });
    if (missing != keys.end()) {
      waiting_factors_.emplace(*missing, std::pair(now_s_, factor));
      if (options_.max_factor_wait_s > 0.0) factor_ages_.emplace(now_s_, *missing);
      continue;
    }
    const Edge* edge = std::get_if<Edge>(&factor);
    const bool decided = edge != nullptr && edge->kind == EdgeKind::kLoopClosure;
    const Verdict verdict = decided ? verdict_on(edge->from, edge->to) : Verdict::kNone;
    if (verdict == Verdict::kRejected) continue;
    add_factor(change_graph(), factor);
    if (verdict == Verdict::kAccepted) change_graph().set_trusted(graph_.edges().size() - 1, true);
    const auto* prior = std::get_if<PriorFactor>(&factor);
    if (edge != nullptr && edge->kind == EdgeKind::kOdometry) {
      move(placement_.tie(graph_, *edge));
    } else if (prior != nullptr) {
      move(placement_.settle(graph_, *prior));
      if (!fits(*prior, graph_.node(prior->key).pose)) wants_estimate_ = true;
    } else {
      wants_estimate_ = true;
    }
  }
}

void Engine::Impl::drop_old_factors() {
  while (!factor_ages_.empty() && now_s_ - factor_ages_.begin()->first > options_.max_factor_wait_s) {
    const auto [since, key] = *factor_ages_.begin();
    factor_ages_.erase(factor_ages_.begin());
    auto [waiting, end] = waiting_factors_.equal_range(key);
    while (waiting != end) {
      if (waiting->second.first != since) {
        ++waiting;
        continue;
      }
      waiting = waiting_factors_.erase(waiting);
      ++factors_dropped_;
      problem("factor dropped", "node " + key_name(key) + " did not arrive");
    }
  }
}

void Engine::Impl::on(event::Scan& event) {
  if (const auto node = graph_.find(event.scan.key)) {
    event.scan.stamp_ns = graph_.nodes()[*node].stamp_ns;
    announce(event.scan);
  } else {
    early_scans_.emplace(event.scan.key, event.scan.cloud);
  }
}

void Engine::Impl::announce(const KeyedScan& scan) {
  if (!scans_.insert(scan.key).second || !prioritizes_) return;
  guarded([&] { pool_.on_scan(scan); });
  may_choose_ = true;
}

void Engine::Impl::on(event::Candidates& event) {
  for (LoopCandidate& candidate : event.candidates) {
    if (candidate.source != CandidateSource::kAppearance) candidate.source = CandidateSource::kUser;
    const auto from = graph_.find(candidate.from), to = graph_.find(candidate.to);
    if (from && to && graph_.nodes()[*from].stamp_ns < graph_.nodes()[*to].stamp_ns) swap_ends(candidate);
  }
  propose(std::move(event.candidates));
}

void Engine::Impl::propose(std::vector<LoopCandidate> candidates) {
  if (candidates.empty() || !prioritizes_) return;
  const auto left_out = [this](const LoopCandidate& c) {
    return (options_.thin > 1 && !kept_by_thinning(options_, c)) ||
           verdict_on(c.from, c.to) == Verdict::kRejected;
  };
  if (options_.thin > 1 || !decided_.empty()) {
    candidates.erase(std::remove_if(candidates.begin(), candidates.end(), left_out), candidates.end());
  }
  for (LoopCandidate& candidate : candidates) candidate.time_s = now_s_;
  guarded([&] { pool_.add(candidates); });
  may_choose_ = true;
}

bool kept_by_thinning(const EngineOptions& options, const LoopCandidate& candidate) {
  constexpr std::uint64_t kStream = 0x7468696e;  // a random stream that the seeds of registrations do not use
  const auto [low, high] = pair_of(candidate.from, candidate.to);
  return pair_seed(combine_seeds(options.seed, kStream), low, high) %
             static_cast<std::uint64_t>(options.thin) ==
         0;
}

Engine::Engine(const Robots& robots, const EngineOptions& options, RoundRobinQueue queue)
    : impl_(std::make_unique<Impl>(robots, options, std::move(queue))) {}
Engine::~Engine() = default;
Engine::Engine(Engine&&) noexcept = default;
Engine& Engine::operator=(Engine&&) noexcept = default;

std::vector<Effect> Engine::handle(Event event, double now_s) {
  return impl_->handle(std::move(event), now_s);
}
bool Engine::wants_batch() const {
  return impl_->wants_batch();
}
bool Engine::wants_estimate() const {
  return impl_->wants_estimate_ && impl_->options_.use_back_end;
}
bool Engine::computing() const {
  return impl_->computing_;
}
bool Engine::optimizing() const {
  return impl_->optimizing_;
}
std::size_t Engine::in_computation() const {
  return impl_->in_computation_.size();
}
const PoseGraph& Engine::graph() const {
  return impl_->graph_;
}
const std::vector<Eigen::Isometry3d>& Engine::odometry() const {
  return impl_->placement_.odometry();
}
const CandidatePool& Engine::pool() const {
  return impl_->pool_;
}
const std::vector<std::uint64_t>& Engine::evaluations() const {
  return impl_->evaluations_;
}
double Engine::now_s() const {
  return impl_->now_s_;
}
std::size_t Engine::factors_waiting() const {
  return impl_->waiting_factors_.size();
}
std::size_t Engine::factors_dropped() const {
  return impl_->factors_dropped_;
}
const Problems& Engine::radio_problems() const {
  return impl_->radio_.problems();
}

}  // namespace loopwise
