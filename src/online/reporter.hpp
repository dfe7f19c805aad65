// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <exception>
#include <new>
#include <string>
#include <utility>

#include <loopwise/online/loop_closure_module.hpp>

#include "statistics_board.hpp"

namespace loopwise {

/// Calls the callbacks of a module; their exceptions become problems. Only the engine's thread uses it.
class Reporter {
 public:
  Reporter(ModuleCallbacks callbacks, StatisticsBoard& statistics)
      : callbacks_(std::move(callbacks)), statistics_(statistics) {}

  void closure(const LoopClosure& closure) { call("on_closure", callbacks_.on_closure, closure); }
  void result(const RegistrationResult& result) { call("on_result", callbacks_.on_result, result); }
  void estimate(const std::shared_ptr<const Estimate>& estimate) {
    call("on_estimate", callbacks_.on_estimate, estimate);
  }

  /// Counts the problem and stores it for the statistics.
  void problem(const std::string& text) {
    statistics_.problem(text);
    if (!callbacks_.on_problem) return;
    try {
      callbacks_.on_problem(text);
    } catch (...) {  // there is no other channel for the report
    }
  }

  template <class Callback, class... Arguments>
  void call(const char* name, const Callback& callback, const Arguments&... arguments) {
    if (!callback) return;
    try {
      callback(arguments...);
    } catch (const std::bad_alloc&) {
      throw;  // ends the module
    } catch (const std::exception& error) {
      problem(std::string("callback ") + name + ": " + error.what());
    } catch (...) {
      problem(std::string("callback ") + name + ": something that is not a std::exception was thrown");
    }
  }

 private:
  const ModuleCallbacks callbacks_;
  StatisticsBoard& statistics_;
};

}  // namespace loopwise
