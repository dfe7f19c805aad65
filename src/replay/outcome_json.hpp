// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Poses, matrices and outcomes of registrations as JSON. Numbers are exact to the bit.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

/// Converts null to NaN.
[[nodiscard]] double number_or_nan(const Json& value);

/// Row by row. Values that are not finite become null.
template <class Matrix>
[[nodiscard]] Json numbers(const Matrix& matrix) {
  Json list = Json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) list.push_back(matrix(r, c));
  }
  return list;
}

/// Null becomes NaN. \throws InputError if the number of elements differs; Json::exception if one is not a
/// number
template <class Matrix>
[[nodiscard]] Matrix matrix_of(const Json& list) {
  Matrix matrix;
  if (!list.is_array() || list.size() != static_cast<std::size_t>(matrix.size()))
    throw InputError("a matrix has the wrong size");
  std::size_t i = 0;
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) matrix(r, c) = number_or_nan(list[i++]);
  }
  return matrix;
}

/// Adds candidate, outcome and figures, without wall times.
void put_result(Json& line, const RegistrationResult& result);
/// The object of put_result(), with the wall times.
[[nodiscard]] Json outcome_json(const RegistrationResult& result);
/// Reads the object of outcome_json(); the candidate gets its ends and source. Unless `any_numbers`, poses
/// must be rigid and covariances positive definite. \throws InputError; Json::exception
[[nodiscard]] RegistrationResult outcome_from(const Json& json, bool any_numbers = false);

}  // namespace loopwise
