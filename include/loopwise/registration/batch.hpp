// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// A result of RejectionReason::kFailed. Never throws. If memory is missing for the message, the message
/// reports the allocation failure.
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult failed_result(const LoopCandidate& candidate,
                                                               const char* message);

/// Computes one task. Never throws. A registrar that throws gives RejectionReason::kFailed with the
/// exception's message.
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult compute_or_fail(const Registrar& registrar,
                                                                 const RegistrationTask& task);

/// Computes tasks on the pool, one task per thread at a time. Results have the order of the tasks and do not
/// depend on the number of threads. After a stop request no further task starts, and tasks that did not start
/// have no result. `on_result` gets each result at once: in any order, one at a time, from any thread of the
/// pool.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::optional<RegistrationResult>> compute_batch(
    const Registrar& registrar, const std::vector<RegistrationTask>& tasks, ThreadPool& pool,
    const StopToken& stop = {}, const ProgressCallback& progress = {},
    const std::function<void(const RegistrationResult&)>& on_result = {});

}  // namespace loopwise
