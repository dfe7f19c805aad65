// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <loopwise/core/error.hpp>
#include <loopwise/registration/align.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise::python {
namespace {

/// The points of an (n, 3) array without a copy.
Eigen::Map<const Eigen::Matrix3Xd> columns_of(const Doubles& array, const char* what) {
  if (array.ndim() != 2 || array.shape(1) != 3) {
    throw InputError(std::string(what) + " must be an array of shape (n, 3)");
  }
  return {array.data(), 3, static_cast<Eigen::Index>(array.shape(0))};
}

void bind_register(py::module_& module) {
  module.def(
      "register",
      [](const Floats& source, const Floats& target, const py::object& guess, const std::string& registrar,
         std::uint64_t seed, const py::object& source_normals, const py::object& target_normals,
         const py::object& config_value) {
        constexpr Key kTarget = 0, kSource = 1;
        RegistrationOptions options = config_from(config_value).replay.registration;
        options.registrar = parse_enum<RegistrarKind>("registrar", registrar);
        const auto source_cloud =
            std::make_shared<const PointCloud>(cloud_from(source, source_normals, py::none()));
        const auto target_cloud =
            std::make_shared<const PointCloud>(cloud_from(target, target_normals, py::none()));
        // As a pair of nodes: `from` is the newer one, the source.
        RegistrationTask task = pair_task(kSource, kTarget, seed);
        if (!guess.is_none()) task.guess_from_to = pose_from(guess, "guess").inverse();
        RegistrationResult result;
        {
          const py::gil_scoped_release release;
          const auto scans = [&](Key key) { return key == kSource ? source_cloud : target_cloud; };
          result = make_registration(options, scans).registrar->compute(task);
        }
        py::dict out;
        out["verified"] = result.verified();
        out["reason"] = enum_name(result.reason);
        out["message"] = result.message;
        out["T_target_source"] = py::none();
        out["covariance"] = py::none();
        if (result.T_from_to) out["T_target_source"] = matrix_from(result.T_from_to->inverse());
        if (result.closure) {
          out["covariance"] =
              RowMatrix6d(se3::covariance_of_inverse(result.closure->T_from_to, result.closure->covariance));
        }
        out["fitness_m2"] = result.gicp_fitness_m2;
        out["overlap"] = result.overlap;
        out["seconds"] = result.seconds();
        return out;
      },
      py::arg("source"), py::arg("target"), py::arg("guess") = py::none(), py::arg("registrar") = "fast",
      py::arg("seed") = 1, py::arg("source_normals") = py::none(), py::arg("target_normals") = py::none(),
      py::arg("config") = py::none(),
      "Aligns two clouds, (n, 3) in m, by a registrar and all its options, see also align(). T_target_source "
      "maps points of the source to the frame of the target, as does `guess`; C++'s pair_task(source, "
      "target) "
      "gives the inverse. The covariance is that of T_target_source (right perturbation, in the frame of the "
      "source). A pair that cannot be aligned is a result with a reason, not an exception.");
}

void bind_align_result(py::module_& module) {
  py::class_<AlignResult>(module, "AlignResult", "The result of align().")
      .def_readonly("success", &AlignResult::success, "the alignment has passed all tests")
      .def_property_readonly(
          "reason", [](const AlignResult& r) { return enum_name(r.reason); },
          "empty if successful, else a word such as too_few_points")
      .def_readonly("message", &AlignResult::message)
      .def_property_readonly(
          "T_target_source", [](const AlignResult& r) { return matrix_from(r.T_target_source); },
          "(4, 4), maps points of the source to the frame of the target; NaN unless successful")
      .def_property_readonly(
          "covariance", [](const AlignResult& r) { return RowMatrix6d(r.covariance); },
          "(6, 6) of T_target_source, order translation, rotation, right perturbation (frame of the source); "
          "NaN unless successful")
      .def_readonly("inlier_share", &AlignResult::inlier_share,
                    "share of source points with a target point nearby; NaN if not measured")
      .def_readonly("dropped_target_points", &AlignResult::dropped_target_points,
                    "not finite, or beyond features.max_range_m")
      .def_readonly("dropped_source_points", &AlignResult::dropped_source_points)
      .def("__repr__", [](const AlignResult& r) {
        return "<AlignResult: " +
               (r.success ? std::string("success") : enum_name(r.reason) + ", " + r.message) + ">";
      });
}

void bind_align(py::module_& module) {
  module.def(
      "align",
      [](const Doubles& target, const Doubles& source, const py::object& guess, const py::object& options) {
        Config config;
        apply_sections(config, {"fast_registrar", "features"}, options);
        AlignOptions align_options;
        align_options.features = config.replay.registration.features;
        align_options.registration = config.replay.registration.fast;
        if (!guess.is_none()) align_options.guess = pose_from(guess, "guess");
        const Eigen::Map<const Eigen::Matrix3Xd> to = columns_of(target, "target");
        const Eigen::Map<const Eigen::Matrix3Xd> from = columns_of(source, "source");
        const py::gil_scoped_release release;
        return align(to, from, align_options);
      },
      py::arg("target"), py::arg("source"), py::arg("guess") = py::none(), py::arg("options") = py::none(),
      "Aligns two lidar scans of one place, (n, 3) in m: T_target_source maps points of the source to the "
      "frame "
      "of the target, as does `guess`. Rows that are not finite are dropped and counted. Options of the "
      "sections \"fast_registrar\" and \"features\".");
}

}  // namespace

void bind_registration(py::module_& module) {
  bind_register(module);
  bind_align_result(module);
  bind_align(module);
}

}  // namespace loopwise::python
