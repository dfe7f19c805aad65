// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Planar graphs of real robots, judged by their truth.
#pragma once

#include <string>

namespace loopwise::bench {

/// A row for every 2D g2o file of a folder that has loop closures. Where a file NAME_GT_GPS.g2o belongs to
/// it, also its errors and how many of the closures are right.
void compare_planar(const std::string& folder);

}  // namespace loopwise::bench
