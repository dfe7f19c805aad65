// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// Options of a back end that estimates one graph repeatedly as it grows. It starts from the last result, and
/// at times also from odometry, because a false closure that has bent the last result seems to fit it.
struct BackEndOptions {
  OptimizerOptions optimization = from_odometry();  ///< Minimisation.
  GncOptions gnc = from_last_result();              ///< Robust weights.

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
  [[nodiscard]] static GncOptions from_last_result() {
    GncOptions options;
    options.warm_start = true;
    return options;
  }
};

}  // namespace loopwise
