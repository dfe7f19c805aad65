// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// The whole file. \throws IoError with the system's reason; a folder is refused.
[[nodiscard]] LOOPWISE_EXPORT std::string read_file(const std::filesystem::path& path);

/// Replaces or makes the file in one step: whoever opens the path finds the old contents or the new, never a
/// part. The new contents are written beside it under another name first. A path that exists and is no
/// regular file (/dev/stdout, a pipe) is written to directly. \throws IoError with the system's reason
LOOPWISE_EXPORT void write_file(const std::filesystem::path& path, std::string_view contents);

}  // namespace loopwise
