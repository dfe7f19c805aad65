// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Makes an output folder. An existing folder is accepted if it is empty or `may_exist` is set. \throws
/// OptionError, whose message ends with `hint`, if an existing folder is not accepted; std::runtime_error if
/// it cannot be made or written to
LOOPWISE_EXPORT void prepare_output_folder(const std::filesystem::path& folder, bool may_exist,
                                           const std::string& hint);

}  // namespace loopwise
