// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// Options of a back end that estimates the same graph again and again as it grows. Each estimate starts from
/// odometry: an earlier estimate may have been bent by a false closure, which would then seem to fit.
struct BackEndOptions {
  OptimizerOptions optimization = from_odometry();  ///< Minimisation.
  GncOptions gnc = with_second_start();             ///< Robust weights.

  /// Calls visitor(name, section) for both.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    visitor("optimization", self.optimization);
    visitor("gnc", self.gnc);
  }

 private:
  [[nodiscard]] static OptimizerOptions from_odometry() {
    OptimizerOptions options;
    options.initialization = Initialization::kOdometry;
    return options;
  }
  [[nodiscard]] static GncOptions with_second_start() {
    GncOptions options;
    options.second_start = true;
    return options;
  }
};

}  // namespace loopwise
