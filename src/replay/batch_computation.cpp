// SPDX-License-Identifier: BSD-3-Clause
#include "batch_computation.hpp"

#include <map>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/registration/batch.hpp>

namespace loopwise {

std::vector<std::optional<RegistrationResult>> BatchComputation::run(
    const std::vector<RegistrationTask>& tasks, const std::function<void(std::size_t)>& computed) {
  const Stopwatch watch;
  std::vector<std::optional<RegistrationResult>> results(tasks.size());
  std::vector<RegistrationTask> unknown;
  std::vector<std::size_t> places;
  std::map<std::pair<Key, Key>, std::uint64_t> task_hashes;
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    const std::pair<Key, Key> pair(tasks[i].candidate.from, tasks[i].candidate.to);
    const std::uint64_t task_hash = hash_of(tasks[i]).low;
    const auto known = known_.find(pair);
    if (known != known_.end() && (known->second.task_hash == task_hash || known->second.task_hash == 0)) {
      results[i] = known->second;
      results[i]->candidate = tasks[i].candidate;
      continue;
    }
    task_hashes[pair] = task_hash;
    unknown.push_back(tasks[i]);
    places.push_back(i);
  }
  const auto with_hash = [&](RegistrationResult result) {
    result.task_hash = task_hashes.at({result.candidate.from, result.candidate.to});
    return result;
  };
  std::function<void(const RegistrationResult&)> outcome;
  if (hooks_.outcome) outcome = [&](const RegistrationResult& result) { hooks_.outcome(with_hash(result)); };
  const auto progress = [&](const Progress& p) { computed(p.done); };
  const auto fresh = hooks_.compute
                         ? hooks_.compute(unknown, hooks_.stop, progress, outcome)
                         : compute_batch(registrar_, unknown, threads_, hooks_.stop, progress, outcome);
  for (std::size_t k = 0; k < places.size(); ++k) {
    if (fresh[k]) results[places[k]] = with_hash(*fresh[k]);
  }
  seconds_ += watch.seconds();
  return results;
}

}  // namespace loopwise
