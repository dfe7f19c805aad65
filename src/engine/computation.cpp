// SPDX-License-Identifier: BSD-3-Clause
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/registration/batch.hpp>

#include "engine_impl.hpp"

namespace loopwise {

void Engine::Impl::on(event::Tick&) {
  drop_old_factors();
  guarded([this] { pool_.expire(now_s_); });
}

void Engine::Impl::announce_graph() {
  if (!std::exchange(graph_is_new_, false) || !prioritizes_) return;
  guarded([this] { pool_.on_graph(graph_); });
}

void Engine::Impl::on(event::Improve& event) {
  announce_graph();
  evaluations_.clear();
  guarded([&] { pool_.improve(event.count, event.stop, event.max_evaluations, evaluations_); });
}

void Engine::Impl::on(event::Choose& event) {
  announce_graph();
  std::vector<LoopCandidate> batch;
  guarded([&] { batch = pool_.take(event.count); });
  if (batch.empty()) {
    may_choose_ = false;  // the prioritisers hold back all candidates until something changes
    return;
  }
  computing_ = true;
  std::vector<RegistrationTask> tasks;
  std::vector<RegistrationResult> failed;
  if (options_.task.use_guess) covariances_.update(graph_);
  for (const LoopCandidate& candidate : batch) {
    in_computation_.emplace(candidate.id, candidate);
    try {
      tasks.push_back(task_of(candidate));
    } catch (const Error& error) {  // a node of the candidate has not arrived
      failed.push_back(failed_result(candidate, error.what()));
    }
  }
  emit(effect::Compute{std::move(tasks)});
  for (RegistrationResult& result : failed) on(result);
}

RegistrationTask Engine::Impl::task_of(const LoopCandidate& candidate) const {
  RegistrationTask task = make_task(graph_, robots_, candidate, options_.task, options_.seed,
                                    [this](Key key) { return scans_.count(key) != 0; });
  if (!options_.task.use_guess) return task;
  if (candidate.recognition && candidate.recognition->T_from_to) {
    task.guess_from_to = candidate.recognition->T_from_to;
    return task;
  }
  const std::size_t from = graph_.index_of(candidate.from), to = graph_.index_of(candidate.to);
  task.guess_covariance = covariances_.between(from, to);  // right closures make an estimate more certain
  if (options_.guess == GuessSource::kOdometry) {
    const auto& odometry = placement_.odometry();
    task.guess_from_to = odometry[from].inverse() * odometry[to];
  }
  return task;
}

void Engine::Impl::on(RegistrationResult& result) {
  const CandidateId id = result.candidate.id;
  const auto begun = in_computation_.find(id);
  if (begun == in_computation_.end()) {
    throw InputError("registration " + pair_name(result.candidate) + " has a result but was not started");
  }
  result.candidate = begun->second;  // a registrar may leave it empty
  in_computation_.erase(begun);
  const bool moved_meanwhile = moved_meanwhile_.erase(id) != 0;
  guarded([&] { pool_.complete(result); });
  if (result.verified()) {
    take(*result.closure);
  } else {
    keep_rejected(result.candidate, moved_meanwhile);
  }
  emit(effect::Computed{result});
  if (result.incomplete) problem("neighbour's scan cannot be read", pair_name(result.candidate));
  if (result.reason == RejectionReason::kFailed) {
    problem("registration failed", pair_name(result.candidate) + ": " + result.message);
  } else if (result.reason == RejectionReason::kTimeLimit) {
    problem("registration reached its time limit", pair_name(result.candidate) + ": " + result.message);
  }
}

void Engine::Impl::take(const LoopClosure& closure) {
  const Verdict verdict = verdict_on(closure.from, closure.to);
  if (verdict == Verdict::kRejected) return;
  try {
    const std::size_t edge = change_graph().add_closure(closure);
    if (verdict == Verdict::kAccepted) change_graph().set_trusted(edge, true);
  } catch (const Error& error) {
    problem("closure refused", key_name(closure.from) + " - " + key_name(closure.to) + ": " + error.what());
    return;
  }
  closed_.insert({closure.from, closure.to});
  pool_.closure_added(closure.from, closure.to);
  wants_estimate_ = true;
  emit(effect::Closure{closure});
}

void Engine::Impl::on(event::BatchDone& event) {
  computing_ = false;
  for (const LoopCandidate& candidate : event.not_computed) {
    in_computation_.erase(candidate.id);
    moved_meanwhile_.erase(candidate.id);
  }
  guarded([&] { pool_.give_back(event.not_computed); });
  may_choose_ = true;
  start_estimate();
}

Engine::Impl::Verdict Engine::Impl::verdict_on(Key a, Key b) const {
  const auto found = decided_.find(pair_of(a, b));
  if (found == decided_.end()) return Verdict::kNone;
  return found->second ? Verdict::kAccepted : Verdict::kRejected;
}

void Engine::Impl::on(ClosureDecision& decision) {
  decided_[pair_of(decision.from, decision.to)] = decision.accepted;
  const AppliedDecisions applied = apply_decisions(change_graph(), {decision});
  if (applied.removed > 0) {
    pool_.closure_removed(decision.from, decision.to);
    removed_since_job_ = true;
  }
  if (applied.removed + applied.trusted > 0) wants_estimate_ = true;
}

}  // namespace loopwise
