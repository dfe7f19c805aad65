// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <loopwise/registration/registrar.hpp>

namespace loopwise::python {

void bind_registration(py::module_& module) {
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
        if (!guess.is_none()) task.guess_from_to = pose_from(guess.cast<RowMatrix4d>(), "guess").inverse();
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
      "Aligns two clouds, (n, 3) in m. Finds T_target_source, which maps points of the source into the frame "
      "of the "
      "target; a pair that cannot be aligned is a result with a reason, not an exception.");
}

}  // namespace loopwise::python
