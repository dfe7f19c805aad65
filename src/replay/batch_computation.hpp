// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <vector>

#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Computes the registrations of a replay. Outcomes that are known from an earlier run are used; the others
/// are computed by the registrar's threads, or by ReplayHooks::compute.
class BatchComputation {
 public:
  BatchComputation(const Registrar& registrar, ThreadPool& threads, const ReplayHooks& hooks,
                   const KnownOutcomes& known)
      : registrar_(registrar), threads_(threads), hooks_(hooks), known_(known) {}

  /// Results in the order of the tasks; nothing for tasks that were not begun before a stop request.
  /// \param tasks of a batch, or the first ones of it
  /// \param computed called with the number of results so far
  [[nodiscard]] std::vector<std::optional<RegistrationResult>> run(
      const std::vector<RegistrationTask>& tasks, const std::function<void(std::size_t)>& computed);

  /// Wall time of all calls.
  [[nodiscard]] double seconds() const { return seconds_; }

 private:
  const Registrar& registrar_;
  ThreadPool& threads_;
  const ReplayHooks& hooks_;
  const KnownOutcomes& known_;
  double seconds_ = 0.0;
};

}  // namespace loopwise
