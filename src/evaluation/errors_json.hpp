// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Statistics of errors as JSON; null for unknown numbers. Private to evaluation.
#pragma once

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/trajectory_errors.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {

[[nodiscard]] inline Json statistics_json(const Statistics& s) {
  return {{"rmse", s.rmse}, {"mean", s.mean}, {"median", s.median}, {"max", s.max}};
}

}  // namespace loopwise
