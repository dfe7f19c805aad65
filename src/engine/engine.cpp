// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/engine.hpp>

#include <algorithm>
#include <exception>
#include <iterator>
#include <map>
#include <new>
#include <set>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/registration/batch.hpp>

#include "factor.hpp"
#include "placement.hpp"

namespace loopwise {
namespace {

using KeyPair = std::pair<Key, Key>;

KeyPair pair_of(Key a, Key b) {
  return std::minmax(a, b);
}

std::string pair_name(const LoopCandidate& candidate) {
  return key_name(candidate.from) + " - " + key_name(candidate.to);
}

bool fits(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  constexpr double kSame = 1e-6;  // m and rad
  return se3::log(a.inverse() * b).cwiseAbs().maxCoeff() < kSame;
}

/// Whether the pose is at the prior, in the directions that the prior knows.
bool fits(const PriorFactor& prior, const Eigen::Isometry3d& pose) {
  constexpr double kNegligible = 1e-9;
  const Vector6d r = se3::log(prior.pose.inverse() * pose);
  return r.dot(prior.information * r) < kNegligible || fits(prior.pose, pose);
}

}  // namespace

class Engine::Impl {
 public:
  Impl(const Robots& robots, const EngineOptions& options, RoundRobinQueue queue)
      : robots_(robots),
        options_(options),
        placement_(robots),
        generator_(options.generation, robots),
        radio_(options.radio, robots),
        pool_(options.pool, std::move(queue), robots),
        prioritizes_(!pool_.queue().prioritizers().empty()) {}

  std::vector<Effect> handle(Event event, double now_s) {
    check_event(event, robots_);
    now_s_ = std::max(now_s_, now_s);
    effects_.clear();
    std::visit([this](auto& e) { on(e); }, event);
    propose_moved();
    return std::exchange(effects_, {});
  }

  [[nodiscard]] bool wants_batch() const {
    return !computing_ && may_choose_ && pool_.accounting().pending > 0;
  }

  Robots robots_;
  EngineOptions options_;
  PoseGraph graph_;
  Placement placement_;
  ProximityGenerator generator_;
  RadioGenerator radio_;
  CandidatePool pool_;
  bool prioritizes_;
  double now_s_ = 0.0;
  bool wants_estimate_ = false, optimizing_ = false, computing_ = false;
  std::multimap<Key, std::pair<double, Factor>> waiting_factors_;  // by a missing node; since when
  std::size_t factors_dropped_ = 0;
  std::unordered_map<CandidateId, LoopCandidate> in_computation_;
  std::vector<std::uint64_t> evaluations_;

 private:
  // ---- helpers

  void problem(std::string topic, std::string detail, std::exception_ptr cause = nullptr) {
    effects_.push_back(effect::Problem{std::move(topic), std::move(detail), std::move(cause)});
  }

  /// Calls code of a prioritiser, whose failure must not stop the rest.
  template <class Function>
  void guarded(Function&& function) {
    try {
      function();
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      problem("prioritisation", error.what(), std::current_exception());
    } catch (...) {
      problem("prioritisation", "something that is not a std::exception was thrown",
              std::current_exception());
    }
  }

  /// The graph as it is, shared until it changes.
  std::shared_ptr<const Estimate> snapshot() {
    if (!snapshot_) {
      auto copy = std::make_shared<Estimate>();
      copy->graph = graph_;
      snapshot_ = std::move(copy);
    }
    return snapshot_;
  }
  PoseGraph& change_graph() {
    snapshot_.reset();
    return graph_;
  }

  // ---- nodes and factors

  void on(KeyFrame& frame) {
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

    // Radio's first, so that a pair that both propose counts as radio's.
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

  void on(Factors& factors) { add_factors(factors_of(factors)); }

  void add_factors(const std::vector<Factor>& factors) {
    for (const Factor& factor : factors) {
      const std::vector<Key> keys = keys_of(factor);
      const auto missing =
          std::find_if(keys.begin(), keys.end(), [this](Key key) { return !graph_.contains(key); });
      if (missing != keys.end()) {
        waiting_factors_.emplace(*missing, std::pair(now_s_, factor));
        if (options_.max_factor_wait_s > 0.0) factor_ages_.emplace(now_s_, *missing);
        continue;
      }
      add_factor(change_graph(), factor);
      const Edge* edge = std::get_if<Edge>(&factor);
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

  void drop_old_factors() {
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
        problem("factor dropped", "node " + key_name(key) + " did not come");
      }
    }
  }

  // ---- nodes that move because odometry or a prior came late

  void move(const std::optional<Placement::Move>& asked) {
    if (!asked) return;
    const auto& [group, anchor, pose] = *asked;
    // Also where nothing moves: an estimate that is under way does not know that it is held there.
    moved_since_job_.insert(group.begin(), group.end());
    const Eigen::Isometry3d correction = pose * graph_.node(anchor).pose.inverse();
    if ((correction.matrix() - Eigen::Matrix4d::Identity()).cwiseAbs().maxCoeff() < 1e-9) return;
    forget_outcomes(group, correction);
    moved_.insert(moved_.end(), group.begin(), group.end());
    PoseGraph& graph = change_graph();
    for (const Key key : group) {
      graph.set_pose(key, key == anchor ? pose : se3::normalized(correction * graph.node(key).pose));
    }
    graph_is_new_ = may_choose_ = true;
    // Closures that tie the group to others say now that it lies elsewhere.
    if (std::any_of(group.begin(), group.end(), [this](Key key) { return closed_.count(key) != 0; }))
      wants_estimate_ = true;
  }

  /// A group is about to move: rejections between it and other nodes say nothing any more, nor will those
  /// that are being computed.
  void forget_outcomes(const std::vector<Key>& group, const Eigen::Isometry3d& correction) {
    constexpr double kSame_m = 0.01, kSame_rad = 0.002;  // to a registration
    const bool turns = se3::rotation_angle(correction) > kSame_rad;
    const std::unordered_set<Key> moving(group.begin(), group.end());
    const auto parted = [&](const LoopCandidate& c) {
      const bool from = moving.count(c.from) != 0, to = moving.count(c.to) != 0;
      if (from == to) return false;
      const Eigen::Vector3d t = graph_.node(from ? c.from : c.to).pose.translation();
      return turns || (correction * t - t).norm() > kSame_m;
    };
    std::vector<LoopCandidate> forgotten;
    for (const Key key : group) {
      const auto found = rejected_apart_.find(key);
      if (found == rejected_apart_.end()) continue;
      std::copy_if(found->second.begin(), found->second.end(), std::back_inserter(forgotten), parted);
    }
    for (const auto& [id, candidate] : in_computation_) {
      if (parted(candidate)) moved_meanwhile_.insert(id);
    }
    for (const LoopCandidate& candidate : forgotten) {
      for (const Key end : {candidate.from, candidate.to}) {
        const auto at = rejected_apart_.find(end);
        if (at == rejected_apart_.end()) continue;
        std::vector<LoopCandidate>& kept = at->second;
        kept.erase(std::remove_if(kept.begin(), kept.end(),
                                  [&](const LoopCandidate& c) { return c.id == candidate.id; }),
                   kept.end());
        if (kept.empty()) rejected_apart_.erase(at);
      }
    }
    forgotten_.insert(forgotten_.end(), forgotten.begin(), forgotten.end());
  }

  /// A rejection holds as long as its nodes lie so to each other.
  void keep_rejected(const LoopCandidate& candidate, bool moved_meanwhile) {
    if (moved_meanwhile) {
      moved_.push_back(candidate.from);
      forgotten_.push_back(candidate);
    } else if (placement_.apart(candidate.from, candidate.to)) {
      for (const Key end : {candidate.from, candidate.to}) rejected_apart_[end].push_back(candidate);
    }
  }

  /// Proposes what moved nodes are near to now, and again what others than the generator proposed.
  void propose_moved() {
    std::vector<KeyPair> pairs;
    std::vector<LoopCandidate> again;
    for (LoopCandidate& candidate : forgotten_) {
      if (vetoed_.count(pair_of(candidate.from, candidate.to)) != 0) continue;
      pairs.emplace_back(candidate.from, candidate.to);
      if (candidate.source == CandidateSource::kProximity) continue;
      candidate.distance_m =
          (graph_.node(candidate.from).pose.translation() - graph_.node(candidate.to).pose.translation())
              .norm();
      again.push_back(candidate);
    }
    forgotten_.clear();
    pool_.forget(pairs);
    propose(std::move(again));
    if (moved_.empty()) return;
    std::sort(moved_.begin(), moved_.end());
    moved_.erase(std::unique(moved_.begin(), moved_.end()), moved_.end());
    if (options_.use_proximity && prioritizes_) propose(generator_.on_moved(graph_, moved_, now_s_));
    moved_.clear();
  }

  // ---- scans and candidates

  void on(event::Scan& event) {
    if (const auto node = graph_.find(event.scan.key)) {
      event.scan.stamp_ns = graph_.nodes()[*node].stamp_ns;
      announce(event.scan);
    } else {
      early_scans_.emplace(event.scan.key, event.scan.cloud);
    }
  }

  void announce(const KeyedScan& scan) {
    if (!scans_.insert(scan.key).second || !prioritizes_) return;
    guarded([&] { pool_.on_scan(scan); });
    may_choose_ = true;
  }

  void on(event::NoMoreScans&) { pool_.expire_waiting(); }
  void on(event::Radio& event) { propose(radio_.on_radio(graph_, event.readings, now_s_)); }
  void on(BeaconDrop& drop) { propose(radio_.on_drop(graph_, drop, now_s_)); }

  void on(event::Candidates& event) {
    for (LoopCandidate& candidate : event.candidates) {
      candidate.source = CandidateSource::kUser;
      const auto from = graph_.find(candidate.from), to = graph_.find(candidate.to);
      if (from && to && graph_.nodes()[*from].stamp_ns < graph_.nodes()[*to].stamp_ns)
        std::swap(candidate.from, candidate.to);
    }
    propose(std::move(event.candidates));
  }

  /// Whether a candidate is among those that EngineOptions::thin leaves.
  [[nodiscard]] bool kept(const LoopCandidate& candidate) const {
    constexpr std::uint64_t kStream = 0x7468696e;  // apart from the registrations' seeds
    const auto [low, high] = pair_of(candidate.from, candidate.to);
    return pair_seed(combine_seeds(options_.seed, kStream), low, high) %
               static_cast<std::uint64_t>(options_.thin) ==
           0;
  }

  void propose(std::vector<LoopCandidate> candidates) {
    if (candidates.empty() || !prioritizes_) return;
    if (options_.thin > 1) {
      candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                      [this](const LoopCandidate& c) { return !kept(c); }),
                       candidates.end());
    }
    for (LoopCandidate& candidate : candidates) candidate.time_s = now_s_;
    guarded([&] { pool_.add(candidates); });
    may_choose_ = true;
  }

  // ---- choosing and computing

  void on(event::Tick&) {
    drop_old_factors();
    guarded([this] { pool_.expire(now_s_); });
  }

  /// The prioritisers learn of new nodes and moved poses before they choose.
  void announce_graph() {
    if (!std::exchange(graph_is_new_, false) || !prioritizes_) return;
    guarded([this] { pool_.on_graph(graph_); });
  }

  void on(event::Improve& event) {
    announce_graph();
    evaluations_.clear();
    guarded([&] { evaluations_ = pool_.improve(event.count, event.stop, event.max_evaluations); });
  }

  void on(event::Choose& event) {
    announce_graph();
    std::vector<LoopCandidate> batch;
    guarded([&] { batch = pool_.take(event.count); });
    if (batch.empty()) {
      may_choose_ = false;  // all are held back until something changes
      return;
    }
    computing_ = true;
    effect::Compute compute;
    std::vector<RegistrationResult> failed;
    for (const LoopCandidate& candidate : batch) {
      in_computation_.emplace(candidate.id, candidate);
      try {
        compute.tasks.push_back(task_of(candidate));
      } catch (const Error& error) {  // one of a node that has not come
        failed.push_back(failed_result(candidate, error.what()));
      }
    }
    effects_.push_back(std::move(compute));
    for (RegistrationResult& result : failed) on(result);
  }

  [[nodiscard]] RegistrationTask task_of(const LoopCandidate& candidate) const {
    RegistrationTask task = make_task(graph_, robots_, candidate, options_.task, options_.seed,
                                      [this](Key key) { return scans_.count(key) != 0; });
    if (options_.task.use_guess && options_.guess == GuessSource::kOdometry) {
      const auto& odometry = placement_.odometry();
      task.guess_from_to =
          odometry[graph_.index_of(candidate.from)].inverse() * odometry[graph_.index_of(candidate.to)];
    }
    return task;
  }

  void on(RegistrationResult& result) {
    const CandidateId id = result.candidate.id;
    const auto begun = in_computation_.find(id);
    if (begun == in_computation_.end()) {
      throw InputError("registration " + pair_name(result.candidate) + " has a result but was not begun");
    }
    result.candidate = begun->second;  // a registrar may not have filled it in
    in_computation_.erase(begun);
    const bool moved_meanwhile = moved_meanwhile_.erase(id) != 0;
    guarded([&] { pool_.complete(result); });
    if (result.verified()) {
      take(*result.closure);
    } else {
      keep_rejected(result.candidate, moved_meanwhile);
    }
    effects_.push_back(effect::Computed{result});
    if (result.incomplete) problem("neighbour's scan cannot be read", pair_name(result.candidate));
    if (result.reason == RejectionReason::kFailed) {
      problem("registration failed", pair_name(result.candidate) + ": " + result.message);
    } else if (result.reason == RejectionReason::kTimeLimit) {
      problem("registration reached its time limit", pair_name(result.candidate) + ": " + result.message);
    }
  }

  void take(const LoopClosure& closure) {
    if (vetoed_.count(pair_of(closure.from, closure.to)) != 0) return;
    try {
      change_graph().add_closure(closure);
    } catch (const Error& error) {
      problem("closure refused", key_name(closure.from) + " - " + key_name(closure.to) + ": " + error.what());
      return;
    }
    closed_.insert({closure.from, closure.to});
    wants_estimate_ = true;
    effects_.push_back(effect::Closure{closure});
  }

  void on(event::BatchDone& event) {
    computing_ = false;
    for (const LoopCandidate& candidate : event.not_computed) {
      in_computation_.erase(candidate.id);
      moved_meanwhile_.erase(candidate.id);
    }
    guarded([&] { pool_.give_back(event.not_computed); });
    may_choose_ = true;
    start_estimate();
  }

  void on(event::Veto& event) {
    vetoed_.insert(pair_of(event.from, event.to));
    const std::size_t removed = change_graph().remove_edges_if([&](const Edge& edge) {
      return edge.kind == EdgeKind::kLoopClosure &&
             pair_of(edge.from, edge.to) == pair_of(event.from, event.to);
    });
    if (removed == 0) return;
    removed_since_job_ = wants_estimate_ = true;
  }

  // ---- estimates

  void on(event::Settle&) {
    if (!computing_) start_estimate();
  }

  void start_estimate() {
    if (!wants_estimate_ || !options_.use_back_end || optimizing_) return;
    wants_estimate_ = removed_since_job_ = false;
    moved_since_job_.clear();
    optimizing_ = true;
    const auto now = snapshot();
    effects_.push_back(effect::Optimize{std::shared_ptr<const PoseGraph>(now, &now->graph)});
  }

  void on(event::Optimized& event) {
    if (!optimizing_) throw InputError("an estimate that was not asked for");
    optimizing_ = false;
    if (!event.failure.empty()) problem("the back end failed", event.failure);
    const bool nothing = event.stopped || !event.failure.empty();
    // One made with edges that were taken out since is not worth keeping: the next is already wanted.
    if (nothing || removed_since_job_) return;
    const std::vector<Eigen::Isometry3d>& poses = event.gnc.optimization.poses;
    PoseGraph& graph = change_graph();
    for (std::size_t e = 0; e < event.gnc.weights.size(); ++e) graph.set_weight(e, event.gnc.weights[e]);
    if (moved_since_job_.empty() && poses.size() == graph.nodes().size()) {
      graph.set_poses(poses);
    } else {
      std::unordered_map<Key, Eigen::Isometry3d> named;
      for (std::size_t i = 0; i < poses.size(); ++i) {
        // A node that odometry or a prior has moved since goes along with the nodes that it was tied to.
        const Key key = graph.nodes()[i].key;
        if (moved_since_job_.count(key) == 0) named.emplace(key, poses[i]);
      }
      move_nodes(named);
      if (is_torn(poses, event.gnc.weights.size())) wants_estimate_ = true;
    }
    publish();
  }

  /// Whether factors that came while the estimate was made contradict it.
  [[nodiscard]] bool is_torn(const std::vector<Eigen::Isometry3d>& estimated,
                             std::size_t edges_estimated) const {
    if (moved_since_job_.empty()) return false;
    const auto placed = [this](Key key) { return moved_since_job_.count(key) != 0; };
    // Odometry alone says no more than where its group lay before.
    for (std::size_t e = 0; e < edges_estimated; ++e) {
      const Edge& edge = graph_.edges()[e];
      if (edge.kind == EdgeKind::kOdometry) continue;
      for (const Key end : {edge.from, edge.to}) {
        if (placed(end) && !fits(graph_.node(end).pose, estimated[graph_.index_of(end)])) return true;
      }
    }
    const bool edges_fit = std::all_of(graph_.edges().begin(), graph_.edges().end(), [&](const Edge& edge) {
      if (edge.kind != EdgeKind::kOdometry || placed(edge.from) == placed(edge.to)) return true;
      return fits(graph_.node(edge.from).pose * edge.T_from_to, graph_.node(edge.to).pose);
    });
    return !edges_fit ||
           std::any_of(graph_.priors().begin(), graph_.priors().end(), [&](const PriorFactor& prior) {
             return Placement::is_full(prior) && placed(prior.key) &&
                    !fits(prior.pose, graph_.node(prior.key).pose);
           });
  }

  void on(ExternalEstimate& estimate) {
    if (options_.use_back_end)
      throw InputError("an estimate from outside needs the option engine.use_back_end to be off");
    std::unordered_map<Key, Eigen::Isometry3d> named;
    for (const auto& [key, pose] : estimate.poses) {
      if (!graph_.contains(key)) continue;
      const bool rounded = se3::rotation_defect(pose.linear()) > 1e-9;
      named.emplace(key, rounded ? se3::normalized(pose) : pose);
    }
    move_nodes(named);
    for (const auto& [key, pose] : named) placement_.fix(key);
    for (const auto& [key, covariance] : estimate.covariances) {
      if (const auto node = graph_.find(key)) change_graph().set_covariance(*node, covariance);
    }
    publish();
  }

  /// Sets the poses of the named nodes; the others of a robot move with the nearest named one before them.
  void move_nodes(const std::unordered_map<Key, Eigen::Isometry3d>& named) {
    std::vector<std::pair<std::size_t, std::size_t>> order;  // robot, node
    order.reserve(graph_.nodes().size());
    for (std::size_t i = 0; i < graph_.nodes().size(); ++i)
      order.emplace_back(robots_.of(graph_.nodes()[i].key), i);
    std::sort(order.begin(), order.end(), [this](const auto& a, const auto& b) {
      return std::pair(a.first, graph_.nodes()[a.second].key) <
             std::pair(b.first, graph_.nodes()[b.second].key);
    });
    std::vector<Eigen::Isometry3d> poses = graph_.poses();
    Eigen::Isometry3d correction = Eigen::Isometry3d::Identity();
    for (std::size_t k = 0; k < order.size(); ++k) {
      const auto [robot, i] = order[k];
      if (k == 0 || order[k - 1].first != robot) correction.setIdentity();
      if (const auto found = named.find(graph_.nodes()[i].key); found != named.end()) {
        correction = found->second * poses[i].inverse();
        poses[i] = found->second;
      } else {
        poses[i] = se3::normalized(correction * poses[i]);
      }
    }
    change_graph().set_poses(poses);
  }

  void publish() {
    auto estimate = std::make_shared<Estimate>();
    estimate->graph = graph_;
    estimate->revision = ++revision_;
    for (const Edge& edge : graph_.edges()) {
      if (edge.kind != EdgeKind::kLoopClosure) continue;
      ++estimate->closures;
      if (edge.weight > 0.5) ++estimate->inliers;
    }
    snapshot_ = estimate;
    generator_.on_graph(graph_);
    graph_is_new_ = may_choose_ = true;
    announce_graph();
    effects_.push_back(effect::EstimateReady{std::move(estimate)});
  }

  std::vector<Effect> effects_;
  std::shared_ptr<const Estimate> snapshot_;  // of graph_ as it is; null after a change
  std::uint64_t revision_ = 0;
  bool graph_is_new_ = false;  // to the prioritisers
  bool may_choose_ = false;    // something has changed since the prioritisers held everything back
  std::multimap<double, Key> factor_ages_;                                  // of waiting_factors_
  std::unordered_set<Key> scans_;                                           // announced
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> early_scans_;  // before their nodes
  std::set<KeyPair> vetoed_;
  std::unordered_set<Key> closed_;           // nodes with a closure, perhaps taken out since
  std::vector<Key> moved_;                   // since their neighbours were proposed
  std::unordered_set<Key> moved_since_job_;  // of the back end
  bool removed_since_job_ = false;           // closures
  // Rejected candidates of nodes that may still move against each other, by each of the two.
  std::unordered_map<Key, std::vector<LoopCandidate>> rejected_apart_;
  std::vector<LoopCandidate> forgotten_;             // rejections that say nothing any more
  std::unordered_set<CandidateId> moved_meanwhile_;  // of in_computation_
};

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
