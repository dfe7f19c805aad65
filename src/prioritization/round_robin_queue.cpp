// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/round_robin_queue.hpp>

#include <algorithm>
#include <exception>
#include <new>
#include <unordered_map>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

/// Calls a function of a prioritiser. \throws Error that names the call, with the exception of the
/// prioritiser nested
template <class Call>
auto guarded(const Prioritizer& prioritizer, const char* function, Call&& call) {
  const auto what = [&](const char* why) {
    return Error(std::string(prioritizer.name()) + ": " + function + "(): " + why);
  };
  try {
    return call();
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    std::throw_with_nested(what(error.what()));
  } catch (...) {
    std::throw_with_nested(what("something that is not a std::exception was thrown"));
  }
}

/// Calls a function of all prioritisers, even if one throws. \throws the first exception
template <class Call>
void each(const std::vector<std::unique_ptr<Prioritizer>>& prioritizers, const char* function, Call&& call) {
  std::exception_ptr failure;
  for (const auto& prioritizer : prioritizers) {
    try {
      guarded(*prioritizer, function, [&] { call(*prioritizer); });
    } catch (const std::bad_alloc&) {
      throw;
    } catch (...) {
      if (!failure) failure = std::current_exception();
    }
  }
  if (failure) std::rethrow_exception(failure);
}

}  // namespace

RoundRobinQueue::RoundRobinQueue(std::vector<std::unique_ptr<Prioritizer>> prioritizers)
    : prioritizers_(std::move(prioritizers)), handed_out_(prioritizers_.size(), 0) {
  for (const auto& prioritizer : prioritizers_) {
    if (!prioritizer) throw InputError("RoundRobinQueue: a prioritizer is null");
  }
}

std::vector<Refusal> RoundRobinQueue::add(const std::vector<LoopCandidate>& candidates) {
  std::unordered_map<CandidateId, std::string> reasons;
  for (const LoopCandidate& candidate : candidates) holders_.set(candidate.id, prioritizers_.size());
  for (const auto& prioritizer : prioritizers_) {
    const std::vector<Refusal> refusals =
        guarded(*prioritizer, "add", [&] { return prioritizer->add(candidates); });
    for (const Refusal& refusal : refusals) {
      std::size_t* holders = holders_.find(refusal.id);
      if (holders == nullptr || *holders == 0) continue;
      --*holders;
      std::string& joined = reasons[refusal.id];
      if (joined != refusal.reason) joined += (joined.empty() ? "" : ";") + refusal.reason;
    }
  }
  std::vector<Refusal> refused;
  for (const LoopCandidate& candidate : candidates) {
    const std::size_t* holders = holders_.find(candidate.id);
    if (holders == nullptr || *holders > 0) continue;
    holders_.erase(candidate.id);
    refused.push_back({candidate.id, prioritizers_.empty() ? "no_prioritizer" : reasons[candidate.id]});
  }
  return refused;
}

void RoundRobinQueue::remove(const std::vector<CandidateId>& ids) {
  for (const CandidateId id : ids) holders_.erase(id);
  each(prioritizers_, "remove", [&](Prioritizer& prioritizer) { prioritizer.remove(ids); });
}

void RoundRobinQueue::on_graph(const PoseGraph& graph) {
  each(prioritizers_, "on_graph", [&](Prioritizer& prioritizer) { prioritizer.on_graph(graph); });
}

void RoundRobinQueue::on_scan(const KeyedScan& scan) {
  each(prioritizers_, "on_scan", [&](Prioritizer& prioritizer) { prioritizer.on_scan(scan); });
}

void RoundRobinQueue::on_result(const RegistrationResult& result) {
  each(prioritizers_, "on_result", [&](Prioritizer& prioritizer) { prioritizer.on_result(result); });
}

void RoundRobinQueue::improve(std::size_t count, const StopToken& stop,
                              const std::vector<std::uint64_t>& max_evaluations,
                              std::vector<std::uint64_t>& used) {
  const std::size_t n = prioritizers_.size();
  used.assign(n, 0);
  count = std::min(count, size());
  if (count == 0) return;
  std::size_t next = 0;
  each(prioritizers_, "improve", [&](Prioritizer& prioritizer) {
    const std::size_t i = next++;
    const std::size_t k = (i + n - turn_) % n;  // its position in the next batch
    const std::size_t share = count / n + (k < count % n ? 1 : 0);
    const std::uint64_t most =
        i < max_evaluations.size() ? max_evaluations[i] : std::numeric_limits<std::uint64_t>::max();
    if (share > 0) used[i] = prioritizer.improve(share, stop, most);
  });
}

std::vector<Refusal> RoundRobinQueue::give_up(double now_s) {
  std::vector<Refusal> refused;
  try {
    each(prioritizers_, "give_up", [&](Prioritizer& prioritizer) {
      for (Refusal& refusal : prioritizer.give_up(now_s)) {
        std::size_t* holders = holders_.find(refusal.id);
        if (holders == nullptr || --*holders > 0) continue;
        holders_.erase(refusal.id);
        refused.push_back(std::move(refusal));
      }
    });
  } catch (const std::bad_alloc&) {
    throw;
  } catch (...) {
    if (refused.empty()) throw;  // otherwise these are reported now, and the next call throws again
  }
  return refused;
}

std::vector<LoopCandidate> RoundRobinQueue::take(std::size_t count) {
  const std::vector<std::size_t> handed_out = handed_out_;
  std::vector<LoopCandidate> taken;
  taken.reserve(std::min(count, size()));
  try {
    return take_in_turns(std::min(count, size()), taken);
  } catch (...) {
    handed_out_ = handed_out;
    try {
      static_cast<void>(add(taken));
    } catch (...) {  // the first failure is the one to report
    }
    throw;
  }
}

std::vector<LoopCandidate> RoundRobinQueue::share_of(Prioritizer& prioritizer, std::size_t count,
                                                     std::vector<LoopCandidate>& taken) {
  std::vector<LoopCandidate> share = guarded(prioritizer, "take", [&] { return prioritizer.take(count); });
  // All candidates are noted first, in memory that is already reserved, so that they can be given back after
  // any failure.
  const LoopCandidate* wrong = share.size() > count ? &share[count] : nullptr;
  for (const LoopCandidate& candidate : share) {
    if (holders_.erase(candidate.id)) {
      taken.push_back(candidate);
    } else if (wrong == nullptr || &candidate < wrong) {
      wrong = &candidate;
    }
  }
  if (wrong != nullptr) {
    throw Error(std::string(prioritizer.name()) + ": take(): returned candidate " +
                std::to_string(wrong->id) +
                (wrong == share.data() + count ? ", which was not requested" : ", which is not pending"));
  }
  std::vector<CandidateId> ids;
  ids.reserve(share.size());
  for (const LoopCandidate& candidate : share) ids.push_back(candidate.id);
  each(prioritizers_, "remove", [&](Prioritizer& other) {
    if (&other != &prioritizer) other.remove(ids);
  });
  return share;
}

std::vector<LoopCandidate> RoundRobinQueue::take_in_turns(std::size_t count,
                                                          std::vector<LoopCandidate>& taken) {
  const std::size_t n = prioritizers_.size();
  std::vector<LoopCandidate> batch;
  if (n == 0) return batch;
  batch.reserve(count);
  // Rounds of equal shares: an empty prioritiser gives less than its share, and another round takes the rest.
  std::size_t empty_rounds = 0;
  while (batch.size() < count) {
    const std::size_t left = count - batch.size();
    std::vector<std::vector<LoopCandidate>> shares(n);
    std::size_t found = 0;
    const std::size_t first = turn_;
    for (std::size_t k = 0; k < n; ++k) {
      const std::size_t i = (first + k) % n;
      const std::size_t share = left / n + (k < left % n ? 1 : 0);
      if (share == 0) continue;
      shares[k] = share_of(*prioritizers_[i], share, taken);
      found += shares[k].size();
      handed_out_[i] += shares[k].size();
    }
    turn_ = (first + left) % n;
    empty_rounds = found > 0 ? 0 : empty_rounds + 1;
    if (empty_rounds > n) break;  // the prioritisers hold back the rest
    // The best candidates of all shares come first, one of each share in turn.
    for (std::size_t rank = 0; found > 0; ++rank) {
      for (const auto& share : shares) {
        if (rank >= share.size()) continue;
        batch.push_back(share[rank]);
        --found;
      }
    }
  }
  return batch;
}

}  // namespace loopwise
