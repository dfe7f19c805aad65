// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// outcomes.jsonl, the outcomes of a run for its continuation after an interruption. See docs/formats.md.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/io/line_log.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// All input that determines the outcomes of a run, except the contents of the scans, as one line of JSON: a
/// run is resumed only with the same fingerprint.
[[nodiscard]] LOOPWISE_EXPORT std::string run_fingerprint(const Mission& mission, const Config& config);

/// Contents of a file of outcomes.
struct KeptOutcomes {
  KnownOutcomes known;  ///< Outcomes that this run can use.
  std::string lines;    ///< The lines of these outcomes.
  /// Number of lines with zeros: parts that were not on the disk when power was lost.
  std::size_t lost = 0;
};

/// Reads a file of outcomes. `fingerprint` is that of the resumed run, without line breaks; the first line of
/// the file has its own. A last line that was cut short is left out, and so are outcomes that depend on
/// circumstances, which may differ now. \throws OptionError naming the difference if the file is of another
/// run; ParseError naming `name` and the line
[[nodiscard]] LOOPWISE_EXPORT KeptOutcomes parse_outcomes(const std::string& contents,
                                                          const std::string& fingerprint,
                                                          const std::string& name);

/// The file of outcomes of a running replay. Each outcome is written as a line when it is computed.
class LOOPWISE_EXPORT OutcomeFile {
 public:
  /// Starts the file, or reads its contents if the run is resumed. \throws IoError; as parse_outcomes()
  OutcomeFile(const std::filesystem::path& path, const std::string& fingerprint, bool resume);

  /// Outcomes that were in the file at the start.
  [[nodiscard]] const KnownOutcomes& known() const { return kept_.known; }
  /// As KeptOutcomes::lost.
  [[nodiscard]] std::size_t lost() const { return kept_.lost; }

  /// Writes an outcome as a line. \throws IoError
  void add(const RegistrationResult& result);

  /// Ends the file after the last outcome, and returns when it is on the disk. \throws IoError
  void finish() { log_.finish(); }

 private:
  KeptOutcomes kept_;
  LineLog log_;
};

}  // namespace loopwise
