// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/io/trajectory.hpp>

namespace loopwise::python {
namespace {

py::dict cloud_dict(const PointCloud& cloud) {
  py::dict out;
  out["points"] = points_array(cloud.points);
  out["origin"] = py::array_t<double>(3, cloud.origin.data());
  out["normals"] = cloud.has_normals() ? py::object(points_array(cloud.normals)) : py::none();
  out["intensities"] = py::none();
  if (!cloud.intensities.empty()) {
    out["intensities"] =
        py::array_t<float>(static_cast<py::ssize_t>(cloud.intensities.size()), cloud.intensities.data());
  }
  return out;
}

py::dict poses_dict(const std::map<Key, Eigen::Isometry3d>& poses) {
  py::dict out;
  for (const auto& [key, pose] : poses) out[py::int_(key)] = matrix_from(pose);
  return out;
}

py::dict statistics_dict(const Statistics& s) {
  py::dict out;
  out["mean"] = s.mean;
  out["rmse"] = s.rmse;
  out["median"] = s.median;
  out["max"] = s.max;
  return out;
}

/// A graph, or a dictionary of key: (4, 4).
PosesByKey poses_by_key(const py::object& value) {
  PosesByKey poses;
  if (py::isinstance<PoseGraph>(value)) {
    for (const Node& node : value.cast<const PoseGraph&>().nodes()) poses[node.key] = node.pose;
    return poses;
  }
  if (!py::isinstance<py::dict>(value))
    throw InputError("poses must be a graph or a dictionary of key: (4, 4)");
  for (const auto& [key, pose] : py::reinterpret_borrow<py::dict>(value)) {
    const Key k = key_from(py::reinterpret_borrow<py::object>(key));
    poses[k] = pose_from(py::reinterpret_borrow<py::object>(pose), "node " + key_name(k));
  }
  return poses;
}

void bind_mission(py::module_& module) {
  py::class_<Mission, std::shared_ptr<Mission>>(
      module, "Mission", "Everything recorded of a run of a team of robots, in one common frame.")
      .def(py::init<>())
      .def_readwrite("name", &Mission::name)
      .def_readwrite("robots", &Mission::robots)
      .def_property(
          "graph", [](const Mission& mission) -> const PoseGraph& { return mission.graph; },
          [](Mission& mission, const PoseGraph& graph) { mission.graph = graph; },
          py::return_value_policy::reference_internal)
      .def_readonly("start_ns", &Mission::start_ns)
      .def_property_readonly("kind", [](const Mission& mission) { return enum_name(mission.kind); })
      .def_property_readonly(
          "ground_truth", [](const Mission& mission) { return poses_dict(mission.ground_truth); },
          "key: (4, 4); empty if not known")
      .def_readonly("truth_is_aligned", &Mission::truth_is_aligned,
                    "set_truth() found the truth in another frame, so only aligned errors are meaningful.")
      .def_property_readonly(
          "reference", [](const Mission& mission) { return poses_dict(mission.reference); },
          "key: (4, 4), of another program, such as a session's own optimised poses: not the truth")
      .def_property_readonly("scan_keys",
                             [](const Mission& mission) { return keys_array(mission.scans->keys()); })
      .def_property_readonly("problems",
                             [](const Mission& mission) { return problem_lines(mission.problems); })
      .def(
          "scan",
          [](const Mission& mission, const py::object& node) {
            const Key key = key_from(node);
            std::shared_ptr<const PointCloud> cloud;
            {
              const py::gil_scoped_release release;
              cloud = mission.scans->load(key);
            }
            if (!cloud) throw UnknownKeyError("node " + key_name(key) + " has no scan");
            return cloud_dict(*cloud);
          },
          py::arg("key"), "points (n, 3), normals and intensities or None; body frame, m");
}

void bind_mission_files(py::module_& module) {
  module.def(
      "read_mission",
      [](const std::filesystem::path& path, const py::object& options) {
        Config config;
        apply_sections(config, {"mission"}, options);
        const py::gil_scoped_release release;
        return read_mission(path, config.mission);
      },
      py::arg("path"), py::arg("options") = py::none(),
      "Reads any mission that `loopwise info` reads, for example a mission folder, a session folder or a g2o "
      "file. Options are those of the section \"mission\" of a configuration.");
  module.def(
      "set_truth",
      [](Mission& mission, const std::vector<std::string>& files, const py::object& options) {
        Config config;
        apply_sections(config, {"mission"}, options);
        set_truth(mission, files, config.mission);
      },
      py::arg("mission"), py::arg("files"), py::arg("options") = py::none(),
      "Sets the ground truth from TUM, KITTI or g2o files, each given as a path or \"ROBOT=PATH\". Options "
      "are those that the mission was read with.");
  module.def(
      "write_mission",
      [](const std::filesystem::path& folder, const Mission& mission) {
        const py::gil_scoped_release release;
        write_mission(folder, mission);
      },
      py::arg("folder"), py::arg("mission"));
}

void bind_data_files(py::module_& module) {
  module.def(
      "read_g2o",
      [](const std::filesystem::path& path) {
        G2oFile file = read_g2o(path);
        return std::pair(std::move(file.graph), problem_lines(file.problems));
      },
      py::arg("path"), "Returns (graph, problems).");
  module.def("write_g2o", &write_g2o, py::arg("path"), py::arg("graph"));
  module.def(
      "read_cloud",
      [](const std::filesystem::path& path, const std::string& bin_layout) {
        return cloud_dict(read_cloud(path, parse_enum<BinLayout>("bin_layout", bin_layout)).cloud);
      },
      py::arg("path"), py::arg("bin_layout") = "auto",
      ".pcd, .ply or .bin: points (n, 3), normals and intensities or None. Points are relative to `origin`, "
      "which is "
      "not zero for clouds in world coordinates.");
  module.def(
      "write_pcd",
      [](const std::filesystem::path& path, const Floats& points, const py::object& normals,
         const py::object& intensities) { write_pcd(path, cloud_from(points, normals, intensities)); },
      py::arg("path"), py::arg("points"), py::arg("normals") = py::none(),
      py::arg("intensities") = py::none());
  module.def(
      "write_tum",
      [](const std::filesystem::path& path, const std::vector<std::int64_t>& stamps_ns,
         const Doubles& poses) {
        const std::vector<Eigen::Isometry3d> all = poses_from(poses);
        if (all.size() != stamps_ns.size()) {
          throw InputError(std::to_string(stamps_ns.size()) + " stamps for " + std::to_string(all.size()) +
                           " poses");
        }
        std::vector<StampedPose> stamped;
        for (std::size_t i = 0; i < all.size(); ++i) stamped.push_back({stamps_ns[i], all[i]});
        write_tum(path, stamped);
      },
      py::arg("path"), py::arg("stamps_ns"), py::arg("poses"));
}

void bind_errors(py::module_& module) {
  module.def(
      "trajectory_errors",
      [](const py::object& estimate, const py::object& truth, const std::string& alignment) {
        const TrajectoryErrors errors = evaluate_trajectory(poses_by_key(estimate), poses_by_key(truth),
                                                            parse_enum<Alignment>("alignment", alignment));
        py::dict out;
        out["poses"] = errors.poses;
        out["ate_m"] = statistics_dict(errors.ate_m);
        out["ate_rad"] = statistics_dict(errors.ate_rad);
        return out;
      },
      py::arg("estimate"), py::arg("truth"), py::arg("alignment") = "none",
      "Errors of a graph or a dictionary of poses against another; alignment none, first or se3.");
}

}  // namespace

void bind_io(py::module_& module) {
  bind_mission(module);
  bind_mission_files(module);
  bind_data_files(module);
  bind_errors(module);
}

}  // namespace loopwise::python
