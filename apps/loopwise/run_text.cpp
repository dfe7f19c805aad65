// SPDX-License-Identifier: BSD-3-Clause
#include "run_text.hpp"

#include "command.hpp"

namespace loopwise::cli {

bool is_judged(const RunEvaluation& e) {
  return e.has_truth && e.odometry.ate_m.max > 1e-6;
}

std::string errors_text(const RunEvaluation& e) {
  std::string text;
  if (e.residuals.translation_m.count > 0) {
    text += "residuals    " + fixed(e.residuals.translation_m.median, 3) + " m in the median of the " +
            std::to_string(e.residuals.translation_m.count) + " closures kept, " +
            fixed(e.odometry_residuals.translation_m.median, 3) + " m by odometry\n";
  }
  if (is_judged(e)) {
    const bool aligned = e.optimized.alignment != Alignment::kNone;
    text += "ATE mean     " + fixed(e.odometry.ate_m.mean, 3) + " m by odometry, " +
            fixed(e.optimized.ate_m.mean, 3) + " m optimised" +
            (aligned ? ", aligned: the truth is in another frame"
                     : " (aligned: " + fixed(e.odometry_aligned.ate_m.mean, 3) + ", " +
                           fixed(e.optimized_aligned.ate_m.mean, 3) + ")") +
            "\n";
  } else if (e.has_truth) {
    text +=
        "ATE          not judged: odometry and truth are the same poses; --odometry-noise 0.05 0.01 makes "
        "the "
        "odometry worse\n";
  }
  if (e.has_reference && e.odometry_reference.ate_m.max > 1e-6) {
    text += "reference    " + fixed(e.odometry_reference.ate_m.mean, 3) + " m by odometry, " +
            fixed(e.optimized_reference.ate_m.mean, 3) +
            " m optimised: mean difference from the session's own optimised poses, which are not the truth\n";
  }
  return text;
}

}  // namespace loopwise::cli
