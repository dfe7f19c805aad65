// SPDX-License-Identifier: BSD-3-Clause
#include "surface.hpp"

#include <cmath>
#include <string>

#include <loopwise/core/error.hpp>

namespace loopwise {

bool check_normals(const char* what, const PointNormalView& cloud) {
  constexpr double kTolerance = 0.01;
  bool finite = true;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    const double length = cloud.normals()[i].norm();
    if (!std::isfinite(length)) {
      finite = false;
    } else if (length > 0.0 && std::abs(length - 1.0) > kTolerance) {
      throw InputError(std::string(what) + ": normal " + std::to_string(i) + " has the length " +
                       std::to_string(length) + ", must be 1: normalise the normals; zero means unknown");
    }
  }
  return finite;
}

}  // namespace loopwise
