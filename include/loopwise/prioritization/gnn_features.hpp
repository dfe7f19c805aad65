// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/options.hpp>

namespace loopwise {

/// Input features of a graph network of the paper's kind.
enum class GnnFeatures {
  kWorld,  ///< The paper's: diagonal of the translational covariance in the world frame (m²), position, 1;
           ///< candidates have the edge type of closures.
  kLamp,   ///< As LAMP's code computes them: rotational variances in the body frame (rad²), position, 1, in
           ///< single precision; candidates have the edge type of odometry.
};
[[nodiscard]] inline EnumNames<GnnFeatures> enum_names(GnnFeatures) {
  return {{GnnFeatures::kWorld, "world"}, {GnnFeatures::kLamp, "lamp"}};
}

}  // namespace loopwise
