// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// GTSAM as a peer of the back end, where the build has found that library. Its version is printed: later
/// ones have other Jacobians and solvers.
#pragma once

#include <string>

namespace loopwise::bench {

/// Compares each g2o file of a folder whose path contains `filter` with GTSAM in one run, each with its
/// defaults on one thread. Files with false closures by their labels (NAME.labels): robust optimisation, ours
/// beside GncOptimizer. Others: optimisation and all marginals, ours beside Levenberg-Marquardt and
/// gtsam::Marginals. \returns false, with a message, if this build has no GTSAM.
bool compare_gtsam(const std::string& folder, const std::string& filter);

}  // namespace loopwise::bench
