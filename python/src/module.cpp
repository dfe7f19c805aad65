// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <algorithm>
#include <cstring>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>

namespace loopwise::python {

namespace {

std::string shape_text(const py::ssize_t* shape, py::ssize_t dimensions) {
  std::string text = "(";
  for (py::ssize_t i = 0; i < dimensions; ++i) text += (i > 0 ? ", " : "") + std::to_string(shape[i]);
  return text + (dimensions == 1 ? ",)" : ")");
}

std::string type_of(const py::object& value) {
  return py::str(py::type::of(value).attr("__name__")).cast<std::string>();
}

}  // namespace

Doubles array_from(const py::object& value, std::initializer_list<py::ssize_t> shape,
                   const std::string& what) {
  const Doubles array = Doubles::ensure(value);
  if (!array) throw InputError(what + " must be an array of numbers, found " + type_of(value));
  if (std::equal(shape.begin(), shape.end(), array.shape(), array.shape() + array.ndim())) return array;
  if (shape.size() == 1 && array.ndim() == 1) {
    throw InputError(what + " needs " + std::to_string(*shape.begin()) + " values, found " +
                     std::to_string(array.shape(0)));
  }
  throw InputError(what + " needs shape " +
                   shape_text(shape.begin(), static_cast<py::ssize_t>(shape.size())) + ", found " +
                   shape_text(array.shape(), array.ndim()));
}

Key key_from(const py::object& value) {
  if (py::isinstance<py::str>(value)) return parse_key(value.cast<std::string>());
  try {
    return value.cast<Key>();
  } catch (const py::cast_error&) {
    throw InputError("a key is a name such as \"a12\" or a number in [0, 2^64), found " +
                     py::repr(value).cast<std::string>());
  }
}

Robots robots_from(const py::object& value, const PoseGraph& graph) {
  if (value.is_none()) return Robots::from_keys(graph.keys());
  if (py::isinstance<py::str>(value)) return parse_robots(value.cast<std::string>());
  if (py::isinstance<Robots>(value)) return value.cast<Robots>();
  throw InputError("robots must be Robots or a text such as \"a,b\", found " + type_of(value));
}

Eigen::Isometry3d pose_from(const py::object& matrix, const std::string& what) {
  const Doubles array = array_from(matrix, {4, 4}, what + ": the pose");
  return pose_from(RowMatrix4d(Eigen::Map<const RowMatrix4d>(array.data())), what);
}

Eigen::Isometry3d pose_from(const RowMatrix4d& matrix, const std::string& what) {
  if (!matrix.row(3).isApprox(Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0), 1e-9)) {
    throw InputError(what + ": the last row of a pose must be 0 0 0 1");
  }
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.matrix().topRows<3>() = matrix.topRows<3>();
  return pose;
}

py::array poses_array(const std::vector<Eigen::Isometry3d>& poses) {
  py::array_t<double> out({static_cast<py::ssize_t>(poses.size()), py::ssize_t{4}, py::ssize_t{4}});
  double* to = out.mutable_data();
  for (const Eigen::Isometry3d& pose : poses) {
    Eigen::Map<RowMatrix4d> matrix(to);
    matrix = pose.matrix();
    to += 16;
  }
  return out;
}

std::vector<Eigen::Isometry3d> poses_from(const Doubles& array) {
  if (array.ndim() != 3 || array.shape(1) != 4 || array.shape(2) != 4) {
    throw InputError("poses must be an array of shape (n, 4, 4)");
  }
  std::vector<Eigen::Isometry3d> poses;
  for (py::ssize_t i = 0; i < array.shape(0); ++i) {
    poses.push_back(
        pose_from(Eigen::Map<const RowMatrix4d>(array.data() + 16 * i), "pose " + std::to_string(i)));
  }
  return poses;
}

py::array matrices_array(const std::vector<Matrix6d>& matrices) {
  py::array_t<double> out({static_cast<py::ssize_t>(matrices.size()), py::ssize_t{6}, py::ssize_t{6}});
  double* to = out.mutable_data();
  for (const Matrix6d& m : matrices) {
    Eigen::Map<RowMatrix6d> matrix(to);
    matrix = m;
    to += 36;
  }
  return out;
}

py::array keys_array(const std::vector<Key>& keys) {
  py::array_t<std::uint64_t> out(static_cast<py::ssize_t>(keys.size()));
  if (!keys.empty()) std::memcpy(out.mutable_data(), keys.data(), keys.size() * sizeof(Key));
  return out;
}

namespace {

std::vector<Eigen::Vector3f> vectors_from(const Floats& array, const char* what) {
  if (array.ndim() != 2 || array.shape(1) != 3) {
    throw InputError(std::string(what) + " must be an array of shape (n, 3)");
  }
  std::vector<Eigen::Vector3f> out(static_cast<std::size_t>(array.shape(0)));
  const float* from = array.data();
  for (Eigen::Vector3f& v : out) {
    v = Eigen::Vector3f(from[0], from[1], from[2]);
    if (!v.allFinite())
      throw InputError(std::string(what) + ": row " + std::to_string(&v - out.data()) + " is not finite");
    from += 3;
  }
  return out;
}

void require_rows(std::size_t rows, std::size_t points, const char* what) {
  if (rows != points) {
    throw InputError(std::to_string(rows) + " " + what + " for " + std::to_string(points) + " points");
  }
}

}  // namespace

PointCloud cloud_from(const Floats& points, const py::object& normals, const py::object& intensities) {
  PointCloud cloud;
  cloud.points = vectors_from(points, "points");
  constexpr double kCoarse_m = 16384.0;  // floats beyond are at least 2 mm apart
  if (robust_centre(cloud.points).norm() > kCoarse_m) {
    throw InputError(
        "points are in world coordinates, where a float loses digits: subtract an origin from them "
        "while they are doubles");
  }
  if (!normals.is_none()) {
    cloud.normals = vectors_from(normals.cast<Floats>(), "normals");
    require_rows(cloud.normals.size(), cloud.points.size(), "normals");
  }
  if (!intensities.is_none()) {
    const auto values = intensities.cast<Floats>();
    if (values.ndim() != 1) throw InputError("intensities must be an array of shape (n,)");
    cloud.intensities.assign(values.data(), values.data() + values.shape(0));
    require_rows(cloud.intensities.size(), cloud.points.size(), "intensities");
  }
  return cloud;
}

py::array points_array(const std::vector<Eigen::Vector3f>& points) {
  py::array_t<float> out({static_cast<py::ssize_t>(points.size()), py::ssize_t{3}});
  float* to = out.mutable_data();
  for (const Eigen::Vector3f& p : points) {
    std::memcpy(to, p.data(), 3 * sizeof(float));
    to += 3;
  }
  return out;
}

std::vector<std::string> problem_lines(const Problems& problems) {
  std::vector<std::string> lines;
  for (const Problem& problem : problems.all()) lines.push_back(to_string(problem));
  return lines;
}

namespace {

std::string json_text(const py::object& value) {
  if (py::isinstance<py::str>(value)) return value.cast<std::string>();
  return py::module_::import("json").attr("dumps")(value).cast<std::string>();
}

}  // namespace

void apply_sections(Config& config, std::initializer_list<const char*> sections, const py::object& values) {
  if (values.is_none()) return;
  py::dict file;
  const bool by_section = py::isinstance<py::dict>(values) && py::len(values) > 0 &&
                          std::all_of(py::reinterpret_borrow<py::dict>(values).begin(),
                                      py::reinterpret_borrow<py::dict>(values).end(),
                                      [](const auto& item) { return py::isinstance<py::dict>(item.second); });
  if (!by_section) {
    file[*sections.begin()] = values;
    return parse_config(json_text(file), "options", config);
  }
  for (const auto& [name, options] : py::reinterpret_borrow<py::dict>(values)) {
    const auto section = py::str(name).cast<std::string>();
    if (std::find(sections.begin(), sections.end(), section) == sections.end()) {
      std::string known;
      for (const char* one : sections) known += (known.empty() ? "\"" : " or \"") + std::string(one) + "\"";
      throw OptionError("options of the section \"" + section + "\" have no effect here: give those of " +
                        known);
    }
    file[name] = options;
  }
  parse_config(json_text(file), "options", config);
}

Config config_from(const py::object& value) {
  if (value.is_none()) return {};
  if (py::isinstance<Config>(value)) return value.cast<Config>();
  Config config;
  parse_config(json_text(value), "config", config);
  return config;
}

}  // namespace loopwise::python

PYBIND11_MODULE(_loopwise, module) {
  namespace py = loopwise::python::py;
  module.doc() = "Loop closure prioritisation for multi-robot lidar SLAM";
  module.attr("__version__") = LOOPWISE_VERSION;
  const auto base = py::register_exception<loopwise::Error>(module, "Error", PyExc_RuntimeError);
  const auto input = py::register_exception<loopwise::InputError>(module, "InputError", base.ptr());
  py::register_exception<loopwise::UnknownKeyError>(module, "UnknownKeyError", input.ptr());
  py::register_exception<loopwise::OptionError>(module, "OptionError", base.ptr());
  py::register_exception<loopwise::IoError>(module, "IoError", base.ptr());
  // Raised for a value of the wrong type, also for one from a function of the user.
  static const py::object input_error = input;
  py::register_exception_translator([](std::exception_ptr failure) {
    try {
      if (failure) std::rethrow_exception(failure);
    } catch (const py::cast_error& error) {
      PyErr_SetString(input_error.ptr(), error.what());
    }
  });
  loopwise::python::bind_core(module);
  loopwise::python::bind_io(module);
  loopwise::python::bind_optimization(module);
  loopwise::python::bind_prioritization(module);
  loopwise::python::bind_registration(module);
  loopwise::python::bind_replay(module);
}
