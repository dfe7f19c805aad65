// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Values of the library as JSON. Include <nlohmann/json.hpp> to use the results.
#pragma once

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// The number, or null if it is not finite, because JSON has no such numbers.
[[nodiscard]] LOOPWISE_EXPORT Json number_or_null(double value);

/// The elements of a matrix, row by row, as one list.
[[nodiscard]] LOOPWISE_EXPORT Json row_major_json(const Eigen::Ref<const Eigen::MatrixXd>& matrix);

/// The problems as a list of texts, one of each kind.
[[nodiscard]] LOOPWISE_EXPORT Json problems_json(const Problems& problems);

}  // namespace loopwise
