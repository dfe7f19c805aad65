// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Replays as the units of a study: one mission under one configuration, its computation and its files.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_store.hpp>
#include <loopwise/replay/registration.hpp>
#include <loopwise/study/study.hpp>

#include "unit_file.hpp"

namespace loopwise::study {

/// A mission of a study.
struct StudyMission {
  StudySource source;
  std::string name;
  std::string world;  ///< Missions of one world are repetitions: provenance's options.world, else the name.
  std::string seed;   ///< Of its simulation; empty if unknown.
  std::string parameters_sha256;  ///< Of the world's parameters; empty if unknown.
  bool has_radio = false;
  bool truth_is_aligned = false;  ///< Its errors are those after alignment, see Mission.
  ContentHash content;            ///< Of all files, including a given truth.
};
[[nodiscard]] StudyMission describe(const StudySource& source, const Mission& mission);

/// A replay.
struct StudyUnit {
  std::size_t mission = 0;  ///< Place in Study::missions().
  std::string label;        ///< For people and folders: "full", "full-w50".
  Config config;
  bool map_quality = false;  ///< Its map is also evaluated at revisits.
};

/// A unit's files within the study's folder.
struct UnitFiles {
  std::filesystem::path result, seconds, run;
};
[[nodiscard]] UnitFiles files_of(const std::filesystem::path& folder, const StudyMission& mission,
                                 const StudyUnit& unit);

/// A mission in memory with the data that its units share.
struct LoadedMission {
  Mission mission;
  Registration registration;
};
[[nodiscard]] std::shared_ptr<const LoadedMission> load(const StudyMission& mission, const Config& config,
                                                        const std::shared_ptr<OutcomeStore>& store);

/// The result of a unit in the form that is stored and sent.
struct ComputedUnit {
  Json json;
  double seconds = 0.0;
  /// Problems of this run that another may not have, see depends_on_circumstances(): scans that could not be
  /// read, registrations that failed. Usually empty.
  std::vector<std::string> not_repeatable;
};

/// Computes one unit on one thread. Empty if it was stopped.
[[nodiscard]] std::optional<ComputedUnit> compute(const LoadedMission& loaded, const StudyMission& about,
                                                  const StudyUnit& unit, const UnitFiles& files,
                                                  bool keep_run, const StopToken& stop,
                                                  const ProgressCallback& progress);

/// Writes the files of a unit. A run that is not repeatable is in this study's tables with a warning, but the
/// next study computes it again.
[[nodiscard]] UnitResult keep(const ComputedUnit& unit, const UnitFiles& files);

/// Reads the file of keep(). Empty if it is unfinished, lacks requested figures, or is damaged.
[[nodiscard]] std::optional<UnitResult> finished(const StudyUnit& unit, const UnitFiles& files,
                                                 bool with_run);

}  // namespace loopwise::study
