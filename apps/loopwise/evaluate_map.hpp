// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include "common/common_options.hpp"

namespace loopwise::cli {

/// `evaluate --map`: compares scans at revisits of the recording, by its own poses and by the estimate's.
int evaluate_map(const CommonOptions& common, const std::string& estimate, const std::string& recording,
                 const std::string& robots);

}  // namespace loopwise::cli
