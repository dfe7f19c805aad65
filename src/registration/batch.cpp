// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/batch.hpp>

#include <exception>
#include <mutex>
#include <string>

namespace loopwise {
namespace {

RegistrationResult compute_or_fail(const Registrar& registrar, const RegistrationTask& task) {
  const auto failed = [&](const std::string& message) {
    RegistrationResult result;
    result.candidate = task.candidate;
    result.reason = RejectionReason::kFailed;
    result.message = message;
    return result;
  };
  try {
    return registrar.compute(task);
  } catch (const std::exception& error) {
    return failed(error.what());
  } catch (...) {
    return failed("the registrar threw something that is not a std::exception");
  }
}

}  // namespace

std::vector<std::optional<RegistrationResult>> compute_batch(const Registrar& registrar,
                                                             const std::vector<RegistrationTask>& tasks,
                                                             ThreadPool& pool, const StopToken& stop,
                                                             const ProgressCallback& progress) {
  std::vector<std::optional<RegistrationResult>> results(tasks.size());
  std::mutex mutex;
  std::size_t accepted = 0, rejected = 0;
  pool.for_each(tasks.size(), [&](std::size_t i) {
    if (stop.stop_requested()) return;
    results[i] = compute_or_fail(registrar, tasks[i]);
    if (!progress) return;
    const std::lock_guard<std::mutex> lock(mutex);
    ++(results[i]->verified() ? accepted : rejected);
    progress({"registering", accepted + rejected, tasks.size(),
              std::to_string(accepted) + " accepted, " + std::to_string(rejected) + " rejected"});
  });
  return results;
}

}  // namespace loopwise
