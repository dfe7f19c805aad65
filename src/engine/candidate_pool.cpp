// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/candidate_pool.hpp>

#include <algorithm>
#include <exception>
#include <string_view>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/recognition.hpp>

namespace loopwise {
namespace {

/// Candidates older than this age. They come first, because ids and times ascend together.
std::vector<CandidateId> older_than(const IdTable<LoopCandidate>& candidates, double now_s, double age_s) {
  std::vector<CandidateId> old;
  candidates.visit([&](CandidateId id, const LoopCandidate& candidate) {
    if (now_s - candidate.time_s <= age_s) return false;
    old.push_back(id);
    return true;
  });
  return old;
}

}  // namespace

std::size_t CandidatePool::PairHash::operator()(const std::pair<Key, Key>& pair) const {
  return static_cast<std::size_t>(combine_seeds(pair.first, pair.second));
}

CandidatePool::CandidatePool(const CandidatePoolOptions& options, RoundRobinQueue queue, Robots robots)
    : options_(options), queue_(std::move(queue)), robots_(std::move(robots)) {
  validate(options_);
  if (options_.redundant_m > 0.0 && robots_.empty())
    throw OptionError("redundant_m needs the list of robots");
}

std::size_t CandidatePool::add(const std::vector<LoopCandidate>& candidates) {
  std::size_t added = 0;
  std::vector<LoopCandidate> ready;
  for (LoopCandidate candidate : candidates) {
    const auto [known, is_new] = proposed_.try_emplace(std::minmax(candidate.from, candidate.to), next_id_);
    if (!is_new) {
      take_recognition(known->second, candidate);
      continue;
    }
    candidate.id = next_id_++;
    candidate.time_s = latest_s_ = std::max(latest_s_, candidate.time_s);
    bool complete = true;
    for (const Key key : {candidate.from, candidate.to}) {
      if (scans_.count(key) != 0) continue;
      complete = false;
      waiting_for_[key].push_back(candidate.id);
    }
    (complete ? pending_ : waiting_).set(candidate.id, candidate);
    if (complete) ready.push_back(candidate);
    ++added;
  }
  accounting_.generated += added;
  accounting_.waiting = waiting_.size();
  accounting_.pending = pending_.size();
  enqueue(ready);
  return added;
}

void CandidatePool::take_recognition(CandidateId id, LoopCandidate from) {
  if (!from.recognition) return;
  const auto recognised = [&](LoopCandidate candidate) {
    if (candidate.from != from.from) swap_ends(from);
    candidate.recognition = from.recognition;
    return candidate;
  };
  if (const LoopCandidate* waiting = waiting_.find(id)) {
    if (!waiting->recognition) waiting_.set(id, recognised(*waiting));
    return;
  }
  const LoopCandidate* pending = pending_.find(id);
  if (pending == nullptr || pending->recognition) return;
  const LoopCandidate candidate = recognised(*pending);
  pending_.set(id, candidate);
  const auto deferred =
      std::find_if(redundant_.begin(), redundant_.end(), [id](const LoopCandidate& c) { return c.id == id; });
  if (deferred != redundant_.end()) {
    *deferred = candidate;
    return;
  }
  queue_.remove({id});  // the prioritisers' copies have no recognition
  enqueue({candidate});
}

void CandidatePool::on_scan(const KeyedScan& scan) {
  if (!scans_.insert(scan.key).second) return;
  std::exception_ptr failure;
  try {
    queue_.on_scan(scan);
  } catch (...) {  // the scan has arrived even if a prioritiser fails
    failure = std::current_exception();
  }
  std::vector<LoopCandidate> ready;
  if (const auto list = waiting_for_.find(scan.key); list != waiting_for_.end()) {
    for (const CandidateId id : list->second) {
      const LoopCandidate* waiting = waiting_.find(id);
      if (waiting == nullptr) continue;  // it has expired
      if (scans_.count(waiting->from) == 0 || scans_.count(waiting->to) == 0) continue;
      ready.push_back(*waiting);
      pending_.set(id, *waiting);
      waiting_.erase(id);
    }
    waiting_for_.erase(list);
  }
  accounting_.waiting = waiting_.size();
  accounting_.pending = pending_.size();
  enqueue(ready);
  if (failure) std::rethrow_exception(failure);
}

void CandidatePool::enqueue(const std::vector<LoopCandidate>& pending) {
  if (pending.empty()) return;
  std::vector<Refusal> refused;
  try {
    refused = queue_.add(pending);
  } catch (...) {
    // It is unknown which prioritisers hold the candidates. All must drop them, otherwise they would stay
    // pending for ever.
    prune(pending, "prioritizer_failed");
    try {
      std::vector<CandidateId> ids;
      ids.reserve(pending.size());
      for (const LoopCandidate& candidate : pending) ids.push_back(candidate.id);
      queue_.remove(ids);
    } catch (...) {  // the first failure is the one to report
    }
    throw;
  }
  for (const Refusal& refusal : refused) {
    pending_.erase(refusal.id);
    ++accounting_.pruned;
    ++pruned_reasons_[refusal.reason];
  }
  accounting_.pending = pending_.size();
}

void CandidatePool::prune(const std::vector<LoopCandidate>& candidates, std::string_view reason) {
  for (const LoopCandidate& candidate : candidates) pending_.erase(candidate.id);
  accounting_.pruned += candidates.size();
  accounting_.pending = pending_.size();
  if (!candidates.empty()) pruned_reasons_[std::string(reason)] += candidates.size();
}

void CandidatePool::drop_pending(const std::vector<CandidateId>& ids, std::string_view reason) {
  if (ids.empty()) return;
  for (const CandidateId id : ids) pending_.erase(id);
  accounting_.expired += ids.size();
  accounting_.pending = pending_.size();
  expired_reasons_[std::string(reason)] += ids.size();
  queue_.remove(ids);
}

void CandidatePool::expire(double now_s) {
  // Ids and times ascend together, so the candidates that are due come first.
  if (options_.max_wait_s > 0.0) {
    const std::vector<CandidateId> old = older_than(waiting_, now_s, options_.max_wait_s);
    for (const CandidateId id : old) waiting_.erase(id);
    accounting_.expired += old.size();
    if (!old.empty()) expired_reasons_["missing_scan"] += old.size();
    accounting_.waiting = waiting_.size();
  }
  for (const Refusal& refusal : queue_.give_up(now_s)) {
    pending_.erase(refusal.id);
    ++accounting_.expired;
    ++expired_reasons_[refusal.reason];
  }
  accounting_.pending = pending_.size();
  if (options_.max_age_s > 0.0) {
    drop_pending(older_than(pending_, now_s, options_.max_age_s), "too_old");
  }
  const auto cap = static_cast<std::size_t>(options_.max_pending);
  if (cap > 0 && pending_.size() > cap) {
    std::vector<CandidateId> oldest;
    pending_.visit([&](CandidateId id, const LoopCandidate&) {
      oldest.push_back(id);
      return oldest.size() < pending_.size() - cap;
    });
    drop_pending(oldest, "pool_full");
  }
}

void CandidatePool::expire_waiting() {
  if (waiting_.empty()) return;
  accounting_.expired += waiting_.size();
  expired_reasons_["missing_scan"] += waiting_.size();
  waiting_.clear();
  waiting_for_.clear();
  accounting_.waiting = 0;
}

void CandidatePool::on_graph(const PoseGraph& graph) {
  queue_.on_graph(graph);
  if (options_.redundant_m <= 0.0) return;
  for (const Node& node : graph.nodes()) positions_[node.key] = node.pose.translation();
}

std::optional<CandidatePool::Place> CandidatePool::place_of(Key from, Key to) const {
  if (robots_.of(from) > robots_.of(to)) std::swap(from, to);
  const auto first = positions_.find(from), second = positions_.find(to);
  if (first == positions_.end() || second == positions_.end()) return std::nullopt;
  return Place{{robots_.of(from), robots_.of(to)}, first->second, second->second};
}

bool CandidatePool::redundant(const LoopCandidate& candidate) const {
  const auto here = place_of(candidate.from, candidate.to);
  if (!here) return false;
  const auto near = [this](const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
    return (a - b).norm() <= options_.redundant_m;
  };
  return std::any_of(closed_.begin(), closed_.end(), [&](const std::pair<Key, Key>& closure) {
    const auto there = place_of(closure.first, closure.second);
    if (!there || there->robots != here->robots) return false;
    if (near(here->first, there->first) && near(here->second, there->second)) return true;
    return here->robots.first == here->robots.second && near(here->first, there->second) &&
           near(here->second, there->first);
  });
}

std::vector<LoopCandidate> CandidatePool::take(std::size_t count) {
  std::vector<LoopCandidate> batch;
  const std::size_t redundant_before = redundant_.size();
  try {
    while (batch.size() < count) {
      const std::vector<LoopCandidate> taken = queue_.take(count - batch.size());
      if (taken.empty()) break;
      for (const LoopCandidate& handed : taken) {
        const LoopCandidate candidate = *pending_.find(handed.id);  // a prioritiser may have changed its copy
        if (options_.redundant_m > 0.0 && redundant(candidate)) {
          redundant_.push_back(candidate);
        } else {
          batch.push_back(candidate);
        }
      }
    }
  } catch (...) {  // candidates taken before the failure become available again
    batch.insert(batch.end(), redundant_.begin() + static_cast<std::ptrdiff_t>(redundant_before),
                 redundant_.end());
    redundant_.resize(redundant_before);
    enqueue(batch);
    throw;
  }
  for (; batch.size() < count && !redundant_.empty(); redundant_.pop_front()) {
    if (pending_.contains(redundant_.front().id)) batch.push_back(redundant_.front());  // else it has expired
  }
  for (const LoopCandidate& candidate : batch) {
    in_flight_.set(candidate.id, candidate);
    pending_.erase(candidate.id);
  }
  accounting_.pending = pending_.size();
  accounting_.in_flight = in_flight_.size();
  return batch;
}

void CandidatePool::complete(const RegistrationResult& result) {
  if (!in_flight_.erase(result.candidate.id)) {
    throw InputError("candidate " + std::to_string(result.candidate.id) +
                     " has a result but is not in flight");
  }
  accounting_.in_flight = in_flight_.size();
  ++accounting_.computed;
  queue_.on_result(result);
}

void CandidatePool::give_back(const std::vector<LoopCandidate>& candidates) {
  std::vector<LoopCandidate> returned;
  for (const LoopCandidate& candidate : candidates) {
    const LoopCandidate* in_flight = in_flight_.find(candidate.id);
    if (in_flight == nullptr) continue;
    returned.push_back(*in_flight);
    pending_.set(candidate.id, *in_flight);
    in_flight_.erase(candidate.id);
  }
  accounting_.pending = pending_.size();
  accounting_.in_flight = in_flight_.size();
  enqueue(returned);
}

void CandidatePool::forget(const std::vector<std::pair<Key, Key>>& pairs) {
  for (const auto& [first, second] : pairs) proposed_.erase(std::minmax(first, second));
}

std::optional<double> CandidatePool::oldest_pending_s() const {
  std::optional<double> oldest;
  pending_.visit([&oldest](CandidateId, const LoopCandidate& candidate) {
    oldest = candidate.time_s;  // ids ascend in the order of generation
    return false;
  });
  return oldest;
}

}  // namespace loopwise
