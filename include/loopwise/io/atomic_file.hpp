// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// The whole file. \throws IoError with the system's reason; a folder is refused.
[[nodiscard]] LOOPWISE_EXPORT std::string read_file(const std::filesystem::path& path);

/// When new contents reach the disk.
enum class Flush {
  kNow,    ///< Before the call returns: a power loss removes nothing that was written.
  kLater,  ///< Later, by the system, for thousands of files; call flush_file_system() after the last.
};

/// Replaces or makes the file in one step: a reader of the path finds the old contents or the new, never a
/// part. The new contents are first written beside it under another name. A target that is not a regular file
/// (a pipe) or that is standard output (/dev/stdout) is written to directly. \throws IoError with the
/// system's reason
LOOPWISE_EXPORT void write_file(const std::filesystem::path& path, std::string_view contents,
                                Flush flush = Flush::kNow);

/// A name as part of a file name: all characters except ASCII letters, digits and '-' become '_', and at most
/// 100 bytes remain, which leaves room for prefix and suffix. Different names may become equal.
[[nodiscard]] LOOPWISE_EXPORT std::string plain_file_name(std::string_view name);

/// Returns when the disk has the file's contents, or the folder's names. \throws IoError with the reason
LOOPWISE_EXPORT void flush_file(const std::filesystem::path& path);

/// Returns when the disk has all that was written so far to the file system of the path.
/// \throws IoError with the system's reason
LOOPWISE_EXPORT void flush_file_system(const std::filesystem::path& path);

}  // namespace loopwise
