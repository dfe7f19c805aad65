// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/json_values.hpp>

#include <cmath>

#include <nlohmann/json.hpp>

namespace loopwise {

Json number_or_null(double value) {
  return std::isfinite(value) ? Json(value) : Json();
}

Json row_major_json(const Eigen::Ref<const Eigen::MatrixXd>& matrix) {
  Json list = Json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) list.push_back(matrix(r, c));
  }
  return list;
}

Json problems_json(const Problems& problems) {
  Json list = Json::array();
  for (const Problem& problem : problems.all()) list.push_back(to_string(problem));
  return list;
}

}  // namespace loopwise
