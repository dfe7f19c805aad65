// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <limits>
#include <map>
#include <vector>

#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::python {
namespace {

std::vector<std::size_t> nodes_without_factors(const PoseGraph& graph) {
  std::vector<bool> bound(graph.nodes().size(), false);
  const auto bind = [&](Key key) { bound[graph.index_of(key)] = true; };
  for (const PriorFactor& prior : graph.priors()) bind(prior.key);
  for (const RangeFactor& range : graph.ranges()) bind(range.from), bind(range.to);
  for (const GravityFactor& gravity : graph.gravities()) bind(gravity.key);
  std::vector<std::size_t> nodes;
  for (std::size_t node = 0; node < bound.size(); ++node) {
    if (!bound[node] && graph.edges_of(node).empty()) nodes.push_back(node);
  }
  return nodes;
}

void bind_estimates(py::module_& module) {
  py::class_<OptimizationResult>(module, "OptimizationResult")
      .def_property_readonly(
          "poses", [](const OptimizationResult& r) { return poses_array(r.poses); },
          "(n, 4, 4), in the order of the graph")
      .def_readonly("cost_initial", &OptimizationResult::cost_initial)
      .def_readonly("cost", &OptimizationResult::cost)
      .def_readonly("iterations", &OptimizationResult::iterations)
      .def_readonly("converged", &OptimizationResult::converged)
      .def_readonly("message", &OptimizationResult::message)
      .def_readonly("components", &OptimizationResult::components)
      .def_property_readonly(
          "held", [](const OptimizationResult& r) { return keys_array(r.held); },
          "nodes that are fixed in components without a prior")
      .def_readonly("seconds", &OptimizationResult::seconds);
  py::class_<GncResult>(module, "GncResult")
      .def_readonly("optimization", &GncResult::optimization)
      .def_property_readonly("poses", [](const GncResult& r) { return poses_array(r.optimization.poses); })
      .def_property_readonly(
          "weights",
          [](const GncResult& r) {
            return py::array_t<double>(static_cast<py::ssize_t>(r.weights.size()), r.weights.data());
          },
          "one for each edge, in the order of the graph")
      .def_readonly("inliers", &GncResult::inliers)
      .def_readonly("outliers", &GncResult::outliers)
      .def_readonly("truncated_cost", &GncResult::truncated_cost)
      .def_readonly(
          "noise_scale", &GncResult::noise_scale,
          "ratio of measured to stated sigmas, where the stated ones are far too large; otherwise 1")
      .def_property_readonly(
          "start", [](const GncResult& r) { return enum_name(r.start); },
          "the start that led to the result: first_estimate, confirmed, doubted_odometry, chordal or "
          "last_result")
      .def_property_readonly(
          "odometry_scales",
          [](const GncResult& r) {
            std::map<Key, double> scales;
            for (const OdometryScale& odometry : r.odometry_scales) scales[odometry.first] = odometry.scale;
            return scales;
          },
          "for chains whose odometry is worse than stated: first node, and ratio of true to stated sigmas");
  py::class_<Marginals>(module, "Marginals")
      .def_property_readonly(
          "covariances", [](const Marginals& m) { return matrices_array(m.covariances); },
          "(n, 6, 6), order translation, rotation, body frame")
      .def_readonly("trace_translation", &Marginals::trace_translation)
      .def_readonly("trace_full", &Marginals::trace_full);
}

void bind_certificate(py::module_& module) {
  py::class_<Certificate>(module, "Certificate")
      .def_property_readonly(
          "status", [](const Certificate& c) { return enum_name(c.status); },
          "certified, improvable, undecided or unsupported")
      .def_readonly("message", &Certificate::message)
      .def_readonly("cost", &Certificate::cost)
      .def_readonly("cost_at_estimate", &Certificate::cost_at_estimate)
      .def_readonly("lower_bound", &Certificate::lower_bound)
      .def_readonly("relative_gap", &Certificate::relative_gap)
      .def_readonly("min_eigenvalue", &Certificate::min_eigenvalue)
      .def_readonly("eigenvalue_tolerance", &Certificate::eigenvalue_tolerance)
      .def_property_readonly(
          "poses", [](const Certificate& c) { return poses_array(c.poses); },
          "(n, 4, 4), the critical point of the isotropic chordal cost next to the estimate")
      .def_property_readonly(
          "best_poses", [](const Certificate& c) { return poses_array(c.best_poses); },
          "(n, 4, 4), the lowest that was found")
      .def_readonly("best_cost", &Certificate::best_cost)
      .def_readonly("rotation_max_rad", &Certificate::rotation_max_rad)
      .def_readonly("translation_max_m", &Certificate::translation_max_m)
      .def_readonly("components", &Certificate::components)
      .def_readonly("certified_components", &Certificate::certified_components)
      .def_readonly("reduced_factors", &Certificate::reduced_factors)
      .def_readonly("seconds", &Certificate::seconds);
}

void bind_optimizers(py::module_& module) {
  module.def(
      "optimize",
      [](const PoseGraph& graph, const py::object& options) {
        Config config;
        config.replay.back_end.optimization =
            OptimizerOptions();  // the defaults of C++, not those of a replay
        apply_sections(config, {"optimization"}, options);
        const py::gil_scoped_release release;
        return optimize(graph, config.replay.back_end.optimization);
      },
      py::arg("graph"), py::arg("options") = py::none(),
      "Least squares over the poses. The graph is not changed: graph.poses = result.poses. Options of the "
      "section \"optimization\", as {\"threads\": 2} or {\"optimization\": {\"threads\": 2}}.");
  module.def(
      "optimize_gnc",
      [](const PoseGraph& graph, const py::object& options, const py::object& gnc) {
        Config config;
        config.replay.back_end.optimization = OptimizerOptions();
        config.replay.back_end.gnc = GncOptions();
        apply_sections(config, {"optimization", "gnc"}, options);
        apply_sections(config, {"gnc"}, gnc);
        const py::gil_scoped_release release;
        return optimize_gnc(graph, config.replay.back_end.optimization, config.replay.back_end.gnc);
      },
      py::arg("graph"), py::arg("options") = py::none(), py::arg("gnc") = py::none(),
      "Robust optimisation that detects false loop closures. `options` are those of the section "
      "\"optimization\", "
      "`gnc` those of \"gnc\"; or `options` holds both sections, as a configuration does.");
  module.def(
      "certify",
      [](const PoseGraph& graph) {
        const py::gil_scoped_release release;
        return certify(graph);
      },
      py::arg("graph"),
      "Certifies whether the graph's poses are globally optimal, by the isotropic chordal cost. Set the "
      "poses of an optimisation first: graph.poses = result.poses.");
  module.def(
      "marginals",
      [](const PoseGraph& graph) {
        const py::gil_scoped_release release;
        Marginals result = marginals(graph);
        for (const std::size_t node : nodes_without_factors(graph)) {
          result.covariances[node].setConstant(std::numeric_limits<double>::quiet_NaN());
        }
        return result;
      },
      py::arg("graph"),
      "Marginal covariances of all poses. They are zero for the first node of a component without a prior, "
      "which is fixed, and NaN for nodes without any factor. The traces leave both out.");
}

}  // namespace

void bind_optimization(py::module_& module) {
  bind_estimates(module);
  bind_certificate(module);
  bind_optimizers(module);
}

}  // namespace loopwise::python
