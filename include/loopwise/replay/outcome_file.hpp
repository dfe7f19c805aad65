// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// outcomes.jsonl of a run: what a killed one leaves to the one that resumes it. See docs/formats.md.
#pragma once

#include <cstddef>
#include <filesystem>
#include <fstream>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Contents of a file of outcomes.
struct KeptOutcomes {
  KnownOutcomes known;  ///< Those that count this time.
  std::string lines;    ///< Theirs.
  /// Lines with zeros in them: parts that had not reached the disk when power was lost.
  std::size_t lost = 0;
};

/// Reads such a file. `fingerprint`: of the run that goes on, without line breaks; the file's first line is
/// that of its own. A last line that was cut short is left out, as are outcomes that depend on circumstances,
/// which may differ this time. \throws OptionError if it is another run's, saying in what they differ;
/// ParseError naming `name` and the line
[[nodiscard]] LOOPWISE_EXPORT KeptOutcomes parse_outcomes(const std::string& contents,
                                                          const std::string& fingerprint,
                                                          const std::string& name);

/// Closes a file that grew line by line; returns when the disk has it. \throws IoError
LOOPWISE_EXPORT void finish_log(std::ofstream& log, const std::filesystem::path& path);

/// The file of a run under way, a line for each outcome as soon as it is computed.
class LOOPWISE_EXPORT OutcomeFile {
 public:
  /// Begins the file, or takes over what is in it if it is to be resumed. \throws IoError; as
  /// parse_outcomes()
  OutcomeFile(std::filesystem::path path, const std::string& fingerprint, bool resume);

  /// Outcomes that it held at first.
  [[nodiscard]] const KnownOutcomes& known() const { return kept_.known; }
  /// As KeptOutcomes::lost.
  [[nodiscard]] std::size_t lost() const { return kept_.lost; }

  /// Writes a line. \throws IoError
  void add(const RegistrationResult& result);

  /// No more is added, and the disk has all. \throws IoError
  void finish() { finish_log(out_, path_); }

 private:
  std::filesystem::path path_;
  KeptOutcomes kept_;
  std::ofstream out_;
};

}  // namespace loopwise
