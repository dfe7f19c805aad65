// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/candidate_pool.hpp>

#include <algorithm>
#include <exception>
#include <new>
#include <string_view>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

namespace loopwise {
namespace {

/// Without memory for its reason a candidate is missing from them alone; the account counts all.
void tally(std::map<std::string, std::size_t>& reasons, std::string_view reason, std::size_t candidates = 1) {
  try {
    reasons[std::string(reason)] += candidates;
  } catch (const std::bad_alloc&) {
  }
}

}  // namespace

std::size_t CandidatePool::PairHash::operator()(const std::pair<Key, Key>& pair) const {
  return static_cast<std::size_t>(combine_seeds(pair.first, pair.second));
}

CandidatePool::CandidatePool(const CandidatePoolOptions& options, RoundRobinQueue queue, Robots robots)
    : options_(options), queue_(std::move(queue)), robots_(std::move(robots)) {
  validate(options_);
  if (options_.redundant_m > 0.0 && robots_.empty())
    throw OptionError("redundant_m needs to know the robots");
}

std::size_t CandidatePool::add(const std::vector<LoopCandidate>& candidates) {
  std::size_t added = 0;
  std::vector<LoopCandidate> ready;
  ready.reserve(candidates.size());
  std::exception_ptr failure;
  for (LoopCandidate candidate : candidates) {
    candidate.id = next_id_;
    try {
      const auto taken_in = take_in(candidate);
      if (!taken_in) continue;
      if (*taken_in == TakenIn::kReady) ready.push_back(candidate);
      ++added;
    } catch (...) {  // those before it are in
      failure = std::current_exception();
      break;
    }
  }
  accounting_.generated += added;
  accounting_.waiting = waiting_.size();
  accounting_.pending = pending_.size();
  enqueue(ready);
  if (failure) std::rethrow_exception(failure);
  return added;
}

std::optional<CandidatePool::TakenIn> CandidatePool::take_in(const LoopCandidate& candidate) {
  const auto [proposed, is_new] = proposed_.insert(std::minmax(candidate.from, candidate.to));
  if (!is_new) return std::nullopt;
  ++next_id_;
  try {
    std::size_t missing = 0;
    for (const Key key : {candidate.from, candidate.to}) {
      if (scans_.count(key) != 0) continue;
      ++missing;
      waiting_for_[key].push_back(candidate.id);  // where it stays behind it is nobody's
    }
    (missing == 0 ? pending_ : waiting_).emplace(candidate.id, candidate);
    return missing == 0 ? TakenIn::kReady : TakenIn::kWaiting;
  } catch (...) {
    proposed_.erase(proposed);
    throw;
  }
}

void CandidatePool::on_scan(const KeyedScan& scan, bool whatever_fails) {
  if (scans_.count(scan.key) != 0) return;
  const auto list = waiting_for_.find(scan.key);
  std::vector<LoopCandidate> ready;
  if (list != waiting_for_.end()) ready.reserve(list->second.size());
  std::exception_ptr failure;
  try {
    queue_.on_scan(scan);
  } catch (const std::bad_alloc&) {
    if (!whatever_fails) throw;
    failure = std::current_exception();
  } catch (...) {  // it is here all the same
    failure = std::current_exception();
  }
  scans_.insert(scan.key);
  // From here on nothing asks for memory before all that waited for this scan alone is pending.
  if (list != waiting_for_.end()) {
    for (const CandidateId id : list->second) {
      const auto waiting = waiting_.find(id);
      if (waiting == waiting_.end()) continue;  // expired meanwhile
      const LoopCandidate& candidate = waiting->second;
      if (scans_.count(candidate.from) == 0 || scans_.count(candidate.to) == 0) continue;
      ready.push_back(candidate);
      pending_.insert(waiting_.extract(waiting));
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
  } catch (const std::bad_alloc&) {
    some_unheld_ = true;
    throw;
  } catch (...) {
    // Nobody knows who holds them: all must let go, or they would be pending for ever.
    prune(pending, "prioritizer_failed");
    try {
      std::vector<CandidateId> ids;
      ids.reserve(pending.size());
      for (const LoopCandidate& candidate : pending) ids.push_back(candidate.id);
      queue_.remove(ids);
    } catch (...) {  // the first failure says more
    }
    throw;
  }
  for (const Refusal& refusal : refused) {
    pending_.erase(refusal.id);
    ++accounting_.pruned;
    tally(pruned_reasons_, refusal.reason);
  }
  accounting_.pending = pending_.size();
}

/// What is in no prioritiser, for there was no memory for it there or one failed, is added anew.
void CandidatePool::offer_again() {
  if (!some_unheld_) return;
  std::unordered_set<CandidateId> last;
  for (const LoopCandidate& candidate : redundant_) last.insert(candidate.id);
  std::vector<LoopCandidate> unheld;
  for (const auto& [id, candidate] : pending_) {
    if (!queue_.holds(id) && last.count(id) == 0) unheld.push_back(candidate);
  }
  some_unheld_ = false;
  enqueue(unheld);
}

void CandidatePool::prune(const std::vector<LoopCandidate>& candidates, std::string_view reason) {
  for (const LoopCandidate& candidate : candidates) pending_.erase(candidate.id);
  accounting_.pruned += candidates.size();
  accounting_.pending = pending_.size();
  if (!candidates.empty()) tally(pruned_reasons_, reason, candidates.size());
}

void CandidatePool::drop_pending(const std::vector<CandidateId>& ids, std::string_view reason) {
  if (ids.empty()) return;
  try {
    queue_.remove(ids);
  } catch (...) {
    some_unheld_ = true;
    throw;
  }
  for (const CandidateId id : ids) pending_.erase(id);
  accounting_.expired += ids.size();
  accounting_.pending = pending_.size();
  tally(expired_reasons_, reason, ids.size());
}

void CandidatePool::expire(double now_s) {
  if (options_.max_wait_s > 0.0) {
    for (auto waiting = waiting_.begin(); waiting != waiting_.end();) {
      if (now_s - waiting->second.time_s > options_.max_wait_s) {
        waiting = waiting_.erase(waiting);
        ++accounting_.expired;
        tally(expired_reasons_, "missing_scan");
      } else {
        ++waiting;
      }
    }
    accounting_.waiting = waiting_.size();
  }
  std::vector<Refusal> given_up;
  try {
    given_up = queue_.give_up(now_s);
  } catch (...) {
    some_unheld_ = true;
    throw;
  }
  for (const Refusal& refusal : given_up) {
    pending_.erase(refusal.id);
    ++accounting_.expired;
    tally(expired_reasons_, refusal.reason);
  }
  accounting_.pending = pending_.size();
  if (options_.max_age_s > 0.0) {
    std::vector<CandidateId> old;
    for (const auto& [id, candidate] : pending_) {
      if (now_s - candidate.time_s > options_.max_age_s) old.push_back(id);
    }
    drop_pending(old, "too_old");
  }
  const auto cap = static_cast<std::size_t>(options_.max_pending);
  if (cap > 0 && pending_.size() > cap) {
    std::vector<CandidateId> oldest;
    for (const auto& [id, candidate] : pending_) {
      if (oldest.size() == pending_.size() - cap) break;
      oldest.push_back(id);
    }
    drop_pending(oldest, "pool_full");
  }
}

void CandidatePool::expire_waiting() {
  if (waiting_.empty()) return;
  accounting_.expired += waiting_.size();
  tally(expired_reasons_, "missing_scan", waiting_.size());
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
  offer_again();
  std::vector<LoopCandidate> batch;
  batch.reserve(std::min(count, pending_.size()));
  while (batch.size() < count) {
    std::vector<LoopCandidate> taken;
    try {
      taken = queue_.take(count - batch.size());
      if (taken.empty()) break;
      for (const LoopCandidate& handed : taken) {
        const LoopCandidate candidate = pending_.at(handed.id);  // whatever a prioritiser made of its copy
        if (options_.redundant_m > 0.0 && redundant(candidate)) {
          redundant_.push_back(candidate);
        } else {
          batch.push_back(candidate);
        }
      }
    } catch (...) {
      some_unheld_ = true;  // what was taken before it failed
      throw;
    }
  }
  for (; batch.size() < count && !redundant_.empty(); redundant_.pop_front()) {
    if (pending_.count(redundant_.front().id) != 0)
      batch.push_back(redundant_.front());  // else it has expired
  }
  for (const LoopCandidate& candidate : batch) in_flight_.insert(pending_.extract(candidate.id));
  accounting_.pending = pending_.size();
  accounting_.in_flight = in_flight_.size();
  return batch;
}

void CandidatePool::complete(const RegistrationResult& result) {
  if (in_flight_.erase(result.candidate.id) == 0) {
    throw InputError("candidate " + std::to_string(result.candidate.id) +
                     " has a result but is not in flight");
  }
  accounting_.in_flight = in_flight_.size();
  ++accounting_.computed;
  if (result.verified()) closed_.emplace_back(result.candidate.from, result.candidate.to);
  queue_.on_result(result);
}

void CandidatePool::give_back(const std::vector<LoopCandidate>& candidates) {
  std::vector<LoopCandidate> returned;
  returned.reserve(candidates.size());
  // From here on nothing asks for memory before all are pending.
  for (const LoopCandidate& candidate : candidates) {
    const auto in_flight = in_flight_.find(candidate.id);
    if (in_flight == in_flight_.end()) continue;
    returned.push_back(candidate);
    pending_.insert(in_flight_.extract(in_flight));
  }
  accounting_.pending = pending_.size();
  accounting_.in_flight = in_flight_.size();
  enqueue(returned);
}

void CandidatePool::forget(const std::vector<std::pair<Key, Key>>& pairs) {
  for (const auto& [first, second] : pairs) proposed_.erase(std::minmax(first, second));
}

std::optional<double> CandidatePool::oldest_pending_s() const {
  if (pending_.empty()) return std::nullopt;
  return pending_.begin()->second.time_s;  // ids count up in the order of generation
}

}  // namespace loopwise
