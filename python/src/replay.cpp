// SPDX-License-Identifier: BSD-3-Clause
#include "prioritizer.hpp"

#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_history.hpp>
#include <loopwise/replay/replay.hpp>
#include <set>

namespace loopwise::python {
namespace {

/// A run with the data for its evaluation and its files.
struct PythonRun {
  std::shared_ptr<const Mission> mission;
  Config config;
  ReplayResult result;
  std::vector<HistoryRow> history;
};

PythonRun run_replay(const std::shared_ptr<Mission>& mission, const py::object& method,
                     const py::object& config_value, const py::object& prioritizers, int threads,
                     const py::object& progress) {
  PythonRun run;
  run.mission = mission;
  run.config = config_from(config_value);
  if (!method.is_none()) run.config.replay.prioritization.method = parse_method(method.cast<std::string>());
  PrioritizerFactory factory;
  if (!prioritizers.is_none()) {
    const auto own = prioritizers.cast<std::vector<std::shared_ptr<Prioritizer>>>();
    std::set<OfOneRun*> of_this_run;
    for (const auto& prioritizer : own) {
      auto* once = dynamic_cast<OfOneRun*>(prioritizer.get());
      if (once != nullptr) once->require_unused(prioritizer->name(), of_this_run.insert(once).second);
    }
    for (OfOneRun* once : of_this_run) once->begin_run();
    factory = [own] {
      std::vector<std::unique_ptr<Prioritizer>> out;
      for (const auto& prioritizer : own) out.push_back(std::make_unique<SharedPrioritizer>(prioritizer));
      return out;
    };
  }
  StopSource stop;
  ReplayHooks hooks;
  hooks.stop = stop.token();
  // The callback also handles Ctrl-C, because Python handles signals only between its own instructions.
  std::exception_ptr interrupted;
  hooks.progress = [&](const Progress& p) {
    const py::gil_scoped_acquire acquire;
    try {
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
      if (!progress.is_none()) progress(p.stage, p.done, p.total, p.detail);
    } catch (const py::error_already_set&) {
      interrupted = std::current_exception();
      stop.request_stop();
    }
  };
  RunHistory history(*mission);
  hooks.moment = [&history](const ReplayMoment& moment) { history.add(moment); };
  {
    const py::gil_scoped_release release;
    const Registration registration =
        make_registration(run.config.replay.registration, mission->scans->loader());
    ThreadPool pool(threads);
    run.result = MissionReplay(*mission, run.config.replay, registration, factory).run(pool, hooks);
  }
  if (interrupted) std::rethrow_exception(interrupted);
  run.history = history.rows();
  return run;
}

py::dict closures_dict(const ReplayResult& result) {
  std::vector<Key> from, to;
  std::vector<Eigen::Isometry3d> T;
  py::list reason;
  const auto n = static_cast<py::ssize_t>(result.computed.size());
  py::array_t<double> weight(n), time(n);
  py::array_t<bool> verified(n);
  for (py::ssize_t i = 0; i < n; ++i) {
    const ComputedCandidate& c = result.computed[static_cast<std::size_t>(i)];
    from.push_back(c.result.candidate.from);
    to.push_back(c.result.candidate.to);
    Eigen::Isometry3d nowhere = Eigen::Isometry3d::Identity();
    nowhere.matrix().topRows<3>().setConstant(std::numeric_limits<double>::quiet_NaN());
    T.push_back(c.result.T_from_to.value_or(nowhere));
    reason.append(enum_name(c.result.reason));
    weight.mutable_at(i) = c.weight;
    time.mutable_at(i) = c.mission_time_s;
    verified.mutable_at(i) = c.result.verified();
  }
  py::dict out;
  out["from"] = keys_array(from);
  out["to"] = keys_array(to);
  out["T_from_to"] = poses_array(T);
  out["verified"] = verified;
  out["weight"] = weight;
  out["reason"] = reason;
  out["mission_time_s"] = time;
  return out;
}

}  // namespace

void bind_replay(py::module_& module) {
  py::class_<Config>(module, "Config", "All options of a run, by sections.")
      .def(py::init(&config_from), py::arg("values") = py::none(),
           "{\"prioritization\": {\"method\": \"full\"}, ...} or JSON")
      .def("to_json", &config_json)
      .def("to_dict", [](const Config& config) {
        return py::module_::import("json").attr("loads")(config_json(config));
      });

  py::class_<PythonRun>(module, "Run", "What came of a replay.")
      .def_property_readonly(
          "graph", [](const PythonRun& run) { return run.result.graph; },
          "Last estimate: priors, odometry, verified closures with their weights.")
      .def_property_readonly(
          "odometry", [](const PythonRun& run) { return poses_array(run.result.odometry); },
          "(n, 4, 4), poses by odometry alone, in the order of the graph")
      .def_property_readonly(
          "closures", [](const PythonRun& run) { return closures_dict(run.result); },
          "Arrays over the computed candidates, in the order of their results.")
      .def_property_readonly("results",
                             [](const PythonRun& run) {
                               std::vector<RegistrationResult> results;
                               for (const ComputedCandidate& c : run.result.computed)
                                 results.push_back(c.result);
                               return results;
                             })
      .def_property_readonly(
          "summary",
          [](const PythonRun& run) {
            const std::string json = run_summary_json(*run.mission, run.config.replay, run.result,
                                                      evaluate_run(*run.mission, run.result));
            return py::module_::import("json").attr("loads")(json);
          },
          "Contents of summary.json: candidates, closures, ate_m, ...")
      .def_property_readonly("problems",
                             [](const PythonRun& run) { return problem_lines(run.result.problems); })
      .def(
          "write",
          [](const PythonRun& run, const std::filesystem::path& folder, double map_voxel_m) {
            const py::gil_scoped_release release;
            std::filesystem::create_directories(folder);
            ReplayResult result = run.result;
            StitchedMap map;
            if (map_voxel_m > 0.0) {
              map = stitch_map(result.graph, *run.mission->scans, map_voxel_m, {}, {},
                               run.config.replay.registration.features.max_range_m);
            }
            result.problems.add(map.problems);
            add_scan_problems(result, *run.mission->scans);
            write_run_folder(folder, *run.mission, run.config.replay, result,
                             evaluate_run(*run.mission, result), run.history, map.cloud);
          },
          py::arg("folder"), py::arg("map_voxel_m") = 0.5, "Writes the files of `loopwise replay`.");

  module.def(
      "replay", &run_replay, py::arg("mission"), py::arg("method") = py::none(),
      py::arg("config") = py::none(), py::arg("prioritizers") = py::none(), py::arg("threads") = 0,
      py::arg("progress") = py::none(),
      "Replays a mission on a virtual clock. `prioritizers`, a list of new objects, replace those of the "
      "method. `progress(stage, done, total, detail)` is called repeatedly. A study is a loop over "
      "missions, methods and seeds.");
}

}  // namespace loopwise::python
