// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// A text file that is written line by line while a program runs. The operating system has each line when
/// add() returns, so the lines of a process that is killed remain. Not thread-safe.
class LOOPWISE_EXPORT LineLog {
 public:
  /// Whether the lines replace the contents of an existing file or follow them.
  enum class Mode {
    kReplace,  ///< An existing file is emptied first.
    kAppend,   ///< The lines follow the contents of an existing file.
  };

  /// Opens the file. \throws IoError
  explicit LineLog(std::filesystem::path path, Mode mode = Mode::kReplace);

  /// Writes a line; `line` has no line end. \throws IoError
  void add(const std::string& line);
  /// Closes the file after the last line, and returns when it is on the disk. \throws IoError
  void finish();

 private:
  void require_good() const;

  std::filesystem::path path_;
  std::ofstream out_;
};

}  // namespace loopwise
