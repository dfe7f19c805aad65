// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/joining/join.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise {

/// Contents of a configuration file: an object of sections, {"generation": {"rate_m": 0.3}, ...}.
struct Config {
  MissionOptions mission;  ///< Reading of missions.
  JoinOptions joining;     ///< Joining of sources without a common frame.
  ReplayOptions replay;    ///< All later stages.

  /// Calls visitor(name, section) for each section.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    visitor("mission", self.mission);
    visitor("joining", self.joining);
    ReplayOptions::visit_sections(self.replay, visitor);
  }
};

/// \throws OptionError naming "section.field".
LOOPWISE_EXPORT void validate_config(const Config& config);

/// Reads {"generation": {"rate_m": 0.3}, ...} over `config`; other fields keep their values. In the section
/// "generation" the key "preset" names a proximity preset, which the other keys modify. \throws IoError;
/// ParseError naming the line; OptionError naming "section.field", for a key of an earlier version also its
/// replacement.
LOOPWISE_EXPORT void read_config(const std::filesystem::path& path, Config& config);

/// The same from a JSON text; `source` replaces the file's name in errors.
LOOPWISE_EXPORT void parse_config(std::string_view json, const std::string& source, Config& config);

/// Sets one field, as `--set generation.rate_m=0.3` does. \throws OptionError
LOOPWISE_EXPORT void set_config_option(const std::string& assignment, Config& config);

/// The whole configuration as indented JSON for read_config().
[[nodiscard]] LOOPWISE_EXPORT std::string config_json(const Config& config);

/// options_key() with the section "mission".
[[nodiscard]] LOOPWISE_EXPORT std::string config_key(const Config& config);

/// Description of one option: "generation.rate_m", its value, bounds and meaning.
struct ConfigEntry {
  std::string name;    ///< "section.field"
  std::string type;    ///< As OptionDescription::type.
  std::string value;   ///< As JSON.
  std::string bounds;  ///< As OptionDescription::bounds.
  std::string doc;     ///< Meaning and unit.
};
/// Every option with its current value, by section.
[[nodiscard]] LOOPWISE_EXPORT std::vector<ConfigEntry> describe_config(const Config& config);

}  // namespace loopwise
