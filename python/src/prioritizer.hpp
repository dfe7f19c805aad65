// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "bindings.hpp"

#include <string>
#include <string_view>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/prioritization/prioritizer.hpp>

namespace loopwise::python {

/// A prioritiser keeps the state of one run, so each run needs a new object.
class OfOneRun {
 public:
  /// \throws InputError if a run has used the object, or if it occurs twice in the list of a run
  void require_unused(std::string_view name, bool first_in_list) const {
    if (!used_ && first_in_list) return;
    throw InputError("prioritizer \"" + std::string(name) +
                     "\" has been used before: make a new object for each run and each place in the list");
  }
  void begin_run() { used_ = true; }

 private:
  bool used_ = false;
};

/// A prioritiser written in Python. Each call acquires the interpreter's lock.
class PythonPrioritizer final : public Prioritizer, public OfOneRun {
 public:
  using Prioritizer::Prioritizer;

  [[nodiscard]] std::string_view name() const override {
    if (name_.empty()) {
      const py::gil_scoped_acquire acquire;
      const py::function own = py::get_override(static_cast<const Prioritizer*>(this), "name");
      name_ = own ? own().cast<std::string>() : "python";
    }
    return name_;
  }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    const py::gil_scoped_acquire acquire;
    const py::function own = py::get_override(static_cast<const Prioritizer*>(this), "add");
    if (!own) missing("add");
    const py::object refused = own(candidates);
    if (refused.is_none()) return {};
    return refused.cast<std::vector<Refusal>>();
  }
  void remove(const std::vector<CandidateId>& ids) override {
    PYBIND11_OVERRIDE_PURE(void, Prioritizer, remove, ids);
  }
  void on_graph(const PoseGraph& graph) override {
    const py::gil_scoped_acquire acquire;
    const py::function own = py::get_override(static_cast<const Prioritizer*>(this), "on_graph");
    if (own) own(&graph);  // by pointer, because pybind11 copies a reference
  }
  void on_scan(const KeyedScan& scan) override {
    const py::gil_scoped_acquire acquire;
    const py::function own = py::get_override(static_cast<const Prioritizer*>(this), "on_scan");
    if (own) own(scan.key, points_array(scan.cloud->points));
  }
  void on_result(const RegistrationResult& result) override {
    PYBIND11_OVERRIDE(void, Prioritizer, on_result, result);
  }
  std::uint64_t improve(std::size_t count, const StopToken&, std::uint64_t max_evaluations) override {
    const py::gil_scoped_acquire acquire;
    const py::function own = py::get_override(static_cast<const Prioritizer*>(this), "improve");
    if (!own) return 0;
    const py::object used = own(count, max_evaluations);
    return used.is_none() ? 0 : used.cast<std::uint64_t>();
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override {
    PYBIND11_OVERRIDE_PURE(std::vector<LoopCandidate>, Prioritizer, take, count);
  }
  [[nodiscard]] std::size_t size() const override { PYBIND11_OVERRIDE_PURE(std::size_t, Prioritizer, size); }

 private:
  [[noreturn]] static void missing(const char* function) {
    throw py::type_error(std::string("a Prioritizer must have the function ") + function);
  }
  mutable std::string name_;
};

/// Forwards calls to a Python object. The library takes ownership of this wrapper, and not of the object.
class SharedPrioritizer final : public Prioritizer {
 public:
  explicit SharedPrioritizer(std::shared_ptr<Prioritizer> inner) : inner_(std::move(inner)) {}
  [[nodiscard]] std::string_view name() const override { return inner_->name(); }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& c) override { return inner_->add(c); }
  void remove(const std::vector<CandidateId>& ids) override { inner_->remove(ids); }
  void on_graph(const PoseGraph& graph) override { inner_->on_graph(graph); }
  void on_scan(const KeyedScan& scan) override { inner_->on_scan(scan); }
  void on_result(const RegistrationResult& result) override { inner_->on_result(result); }
  std::uint64_t improve(std::size_t count, const StopToken& stop, std::uint64_t max_evaluations) override {
    return inner_->improve(count, stop, max_evaluations);
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return inner_->take(count); }
  [[nodiscard]] std::vector<Refusal> give_up(double now_s) override { return inner_->give_up(now_s); }
  [[nodiscard]] std::size_t size() const override { return inner_->size(); }

 private:
  std::shared_ptr<Prioritizer> inner_;
};

}  // namespace loopwise::python
