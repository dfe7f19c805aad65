// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/batch.hpp>

#include <algorithm>
#include <exception>
#include <mutex>
#include <new>
#include <numeric>
#include <string>
#include <tuple>

#include <loopwise/core/error.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

RegistrationResult failed_result(const LoopCandidate& candidate, const char* message) {
  RegistrationResult result;
  result.candidate = candidate;
  result.reason = RejectionReason::kFailed;
  try {
    result.message = message;
  } catch (const std::bad_alloc&) {
    result.message = "out of memory";  // short enough to need no allocation
  }
  return result;
}

namespace {

/// Prepares the result of any registrar for a graph. Restores the requested candidate, and normalises a
/// rotation that went through single precision. \throws InputError if the closure is not valid in a graph
RegistrationResult fit_for_graph(RegistrationResult result, const LoopCandidate& candidate) {
  result.candidate = candidate;
  if ((result.reason == RejectionReason::kNone) != result.closure.has_value()) {
    throw InputError(
        "the registrar returned a verified result without a closure, or a rejected one with one");
  }
  if (!result.closure) return result;
  LoopClosure& closure = *result.closure;
  if (closure.from != candidate.from || closure.to != candidate.to) {
    throw InputError("the registrar returned a closure of other nodes than the candidate's");
  }
  PoseGraph graph;
  for (const Key key : {closure.from, closure.to}) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  const double off = se3::rotation_defect(closure.T_from_to.linear());
  if (off > 1e-6 && off < 1e-3) closure.T_from_to = se3::normalized(closure.T_from_to);
  graph.add_closure(closure);
  return result;
}

}  // namespace

RegistrationResult compute_or_fail(const Registrar& registrar, const RegistrationTask& task) {
  try {
    return fit_for_graph(registrar.compute(task), task.candidate);
  } catch (const std::bad_alloc&) {
    return failed_result(task.candidate, "out of memory");
  } catch (const std::exception& error) {
    return failed_result(task.candidate, error.what());
  } catch (...) {
    return failed_result(task.candidate, "the registrar threw something that is not a std::exception");
  }
}

std::vector<std::optional<RegistrationResult>> compute_batch(
    const Registrar& registrar, const std::vector<RegistrationTask>& tasks, ThreadPool& pool,
    const StopToken& stop, const ProgressCallback& progress,
    const std::function<void(const RegistrationResult&)>& on_result) {
  std::vector<std::optional<RegistrationResult>> results(tasks.size());
  // Pairs with the same target run consecutively, so that even a small cache holds the target of the next
  // pair. Results do not depend on the order.
  std::vector<std::size_t> order(tasks.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    const LoopCandidate &x = tasks[a].candidate, &y = tasks[b].candidate;
    return std::tie(x.to, x.from, a) < std::tie(y.to, y.from, b);
  });
  std::mutex mutex;
  std::size_t accepted = 0, rejected = 0;
  pool.for_each(tasks.size(), [&](std::size_t position) {
    const std::size_t i = order[position];
    if (stop.stop_requested()) return;
    results[i] = compute_or_fail(registrar, tasks[i]);
    if (!progress && !on_result) return;
    const std::lock_guard<std::mutex> lock(mutex);
    if (on_result) on_result(*results[i]);
    if (!progress) return;
    ++(results[i]->verified() ? accepted : rejected);
    progress({"registering", accepted + rejected, tasks.size(),
              std::to_string(accepted) + " accepted, " + std::to_string(rejected) + " rejected"});
  });
  return results;
}

}  // namespace loopwise
