// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The rows of a run's closures.csv.
#pragma once

#include <filesystem>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/key.hpp>

namespace loopwise {

/// A candidate that was computed. Unknown numbers are NaN.
struct RunClosure {
  Key from = 0, to = 0;
  bool verified = false;
  Eigen::Isometry3d T_from_to = Eigen::Isometry3d::Identity();
  double weight = 0.0;   ///< Of the last robust optimisation.
  double overlap = 0.0;  ///< Share of the source's points.
  double time_s = 0.0;   ///< Mission time of the result.
};

/// In the order of their results. \throws IoError, ParseError
[[nodiscard]] std::vector<RunClosure> read_run_closures(const std::filesystem::path& path);

}  // namespace loopwise
