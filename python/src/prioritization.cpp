// SPDX-License-Identifier: BSD-3-Clause
#include "prioritizer.hpp"

#include <algorithm>

#include <loopwise/core/error.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>
#include <loopwise/prioritization/round_robin_queue.hpp>

namespace loopwise::python {
namespace {

/// All prioritisers of a method as one, for use without an engine.
class QueuePrioritizer final : public Prioritizer, public OfOneRun {
 public:
  QueuePrioritizer(std::string name, RoundRobinQueue queue)
      : name_(std::move(name)), queue_(std::move(queue)) {}
  [[nodiscard]] std::string_view name() const override { return name_; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    return queue_.add(candidates);
  }
  void remove(const std::vector<CandidateId>& ids) override { queue_.remove(ids); }
  void on_graph(const PoseGraph& graph) override { queue_.on_graph(graph); }
  void on_scan(const KeyedScan& scan) override { queue_.on_scan(scan); }
  void on_result(const RegistrationResult& result) override { queue_.on_result(result); }
  std::uint64_t improve(std::size_t count, const StopToken& stop, std::uint64_t max_evaluations) override {
    std::vector<std::uint64_t> used;
    queue_.improve(count, stop, std::vector<std::uint64_t>(queue_.prioritizers().size(), max_evaluations),
                   used);
    return used.empty() ? 0 : *std::max_element(used.begin(), used.end());
  }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return queue_.take(count); }
  [[nodiscard]] std::vector<Refusal> give_up(double now_s) override { return queue_.give_up(now_s); }
  [[nodiscard]] std::size_t size() const override { return queue_.size(); }

 private:
  std::string name_;
  RoundRobinQueue queue_;
};

std::shared_ptr<Prioritizer> prioritizer_of(const std::string& method, const Robots& robots,
                                            const py::object& config_value) {
  const Config config = config_from(config_value);
  PrioritizationOptions chosen = config.replay.prioritization;
  chosen.method = parse_method(method);
  const FeatureOptions features = config.replay.registration.features;
  const bool lamp = config.replay.prioritization.observability.variant == ObservabilityVariant::kLamp;
  ScanInsight insight;
  insight.eigenvalue = [features, lamp](const KeyedScan& scan) {
    const Observability observability = compute_features(*scan.cloud, features).observability;
    return lamp ? observability.min_eigenvalue_lamp : observability.min_eigenvalue;
  };
  insight.signature = [](const KeyedScan& scan) { return ScanSignature(*scan.cloud); };
  return std::make_shared<QueuePrioritizer>(
      method, RoundRobinQueue(make_prioritizers(chosen, config.replay.engine.seed, robots, insight)));
}

}  // namespace

void bind_prioritization(py::module_& module) {
  py::class_<Refusal>(module, "Refusal", "A candidate that a prioritiser does not want.")
      .def(py::init<CandidateId, std::string>(), py::arg("id"), py::arg("reason"))
      .def_readwrite("id", &Refusal::id)
      .def_readwrite("reason", &Refusal::reason);

  py::class_<Prioritizer, PythonPrioritizer, std::shared_ptr<Prioritizer>>(
      module, "Prioritizer",
      "Orders pending candidates. Derive from it for your own method: name, add, remove, take and size are "
      "required, the on_* functions and improve are optional. One object serves one run.")
      .def(py::init<>())
      .def("name", [](const Prioritizer& p) { return std::string(p.name()); })
      .def("add", &Prioritizer::add, py::arg("candidates"), "Adds candidates; returns those that it refuses.")
      .def("remove", &Prioritizer::remove, py::arg("ids"))
      .def("on_graph", &Prioritizer::on_graph, py::arg("graph"))
      .def(
          "on_scan",
          [](Prioritizer& prioritizer, Key key, const Floats& points, const py::object& normals,
             std::int64_t stamp_ns) {
            prioritizer.on_scan(
                {key, stamp_ns, std::make_shared<const PointCloud>(cloud_from(points, normals, py::none()))});
          },
          py::arg("key"), py::arg("points"), py::arg("normals") = py::none(), py::arg("stamp_ns") = 0)
      .def("on_result", &Prioritizer::on_result, py::arg("result"))
      .def(
          "improve",
          [](Prioritizer& prioritizer, std::size_t count, std::uint64_t max_evaluations) {
            const py::gil_scoped_release release;
            prioritizer.improve(count, {}, max_evaluations);
          },
          py::arg("count"), py::arg("max_evaluations"), "Prepares the best set of `count`.")
      .def(
          "take", [](Prioritizer& prioritizer, std::size_t count) { return prioritizer.take(count); },
          py::arg("count"), "Removes and returns up to `count` candidates, most valuable first.")
      .def("__len__", &Prioritizer::size)
      .def("size", &Prioritizer::size);

  module.def("make_prioritizer", &prioritizer_of, py::arg("method"), py::arg("robots"),
             py::arg("config") = py::none(),
             "One of the library's: baseline, random, obs, gi, full, or several joined by +.");
  module.def("method_names", &method_names);

  module.def(
      "propose",
      [](const PoseGraph& graph, const py::object& robots, const py::object& options) {
        Config config;
        apply_sections(config, {"generation"}, options);
        ProximityGenerator generator(config.replay.engine.generation, robots_from(robots, graph));
        std::vector<LoopCandidate> all;
        for (const Node& node : graph.nodes()) {
          for (LoopCandidate candidate :
               generator.on_node(graph, node.key, static_cast<double>(node.stamp_ns) * 1e-9)) {
            candidate.id = all.size();
            all.push_back(candidate);
          }
        }
        return all;
      },
      py::arg("graph"), py::arg("robots") = py::none(), py::arg("options") = py::none(),
      "Candidates by proximity, node by node in the order of the graph. Options of the section "
      "\"generation\".");

  module.def(
      "exact_gains",
      [](const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
         const py::object& closure_model) {
        Config config;
        apply_sections(config, {"closure_model"}, closure_model);
        std::vector<double> gains;
        {
          const py::gil_scoped_release release;
          CovarianceObjective objective(graph, candidates, config.replay.prioritization.closure_model);
          gains = objective.add_changes();
        }
        for (double& gain : gains) gain = -gain;
        return py::array_t<double>(static_cast<py::ssize_t>(gains.size()), gains.data());
      },
      py::arg("graph"), py::arg("candidates"), py::arg("closure_model") = py::none(),
      "Decrease of the trace of the covariances by each candidate's closure alone, m^2.");
}

}  // namespace loopwise::python
