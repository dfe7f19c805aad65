// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Makes an output folder, or takes an existing one that is empty or that `may_exist` allows. `hint` ends the
/// message where it does not. \throws OptionError if it exists otherwise; std::runtime_error if it cannot be
/// made or written to
LOOPWISE_EXPORT void prepare_output_folder(const std::filesystem::path& folder, bool may_exist,
                                           const std::string& hint);

}  // namespace loopwise
