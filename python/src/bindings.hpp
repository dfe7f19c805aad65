// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Conversions between the library's types and NumPy's, for all sources of the Python module.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <vector>

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/replay/config.hpp>

namespace loopwise::python {

namespace py = pybind11;

using RowMatrix4d = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
using RowMatrix6d = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Floats = py::array_t<float, py::array::c_style | py::array::forcecast>;

/// An array of doubles of this shape. \throws InputError naming `what`, the needed shape and the shape found
[[nodiscard]] Doubles array_from(const py::object& value, std::initializer_list<py::ssize_t> shape,
                                 const std::string& what);

/// A (4, 4) array. \throws InputError naming `what` if the shape differs or the last row is not 0 0 0 1.
[[nodiscard]] Eigen::Isometry3d pose_from(const RowMatrix4d& matrix, const std::string& what);
[[nodiscard]] Eigen::Isometry3d pose_from(const py::object& matrix, const std::string& what);
[[nodiscard]] inline RowMatrix4d matrix_from(const Eigen::Isometry3d& pose) {
  return pose.matrix();
}

/// (n, 4, 4)
[[nodiscard]] py::array poses_array(const std::vector<Eigen::Isometry3d>& poses);
[[nodiscard]] std::vector<Eigen::Isometry3d> poses_from(const Doubles& array);
/// (n, 6, 6)
[[nodiscard]] py::array matrices_array(const std::vector<Matrix6d>& matrices);
/// (n,) of unsigned 64-bit keys
[[nodiscard]] py::array keys_array(const std::vector<Key>& keys);

/// A key as a name ("a12") or as a number. \throws InputError
[[nodiscard]] Key key_from(const py::object& value);
/// Robots, or their text. None stands for the robots that the keys of the graph name. \throws InputError
[[nodiscard]] Robots robots_from(const py::object& value, const PoseGraph& graph);

/// (n, 3) points, and optionally (n, 3) normals and (n,) intensities. \throws InputError on another shape or
/// a point that is not finite
[[nodiscard]] PointCloud cloud_from(const Floats& points, const py::object& normals,
                                    const py::object& intensities);
[[nodiscard]] py::array points_array(const std::vector<Eigen::Vector3f>& points);

/// One line per problem, see to_string(Problem).
[[nodiscard]] std::vector<std::string> problem_lines(const Problems& problems);

/// A Config from a dictionary of sections, a JSON text or a Config; None gives the defaults. \throws
/// OptionError
[[nodiscard]] Config config_from(const py::object& value);
/// Applies a dictionary to a Config. It has options of the first of these sections, or {section: options} of
/// any of them. \throws OptionError, also for another section
void apply_sections(Config& config, std::initializer_list<const char*> sections, const py::object& values);

void bind_core(py::module_& module);
void bind_io(py::module_& module);
void bind_optimization(py::module_& module);
void bind_prioritization(py::module_& module);
void bind_registration(py::module_& module);
void bind_replay(py::module_& module);

}  // namespace loopwise::python
