// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Replays as the units of a study: each mission under each configuration once, in parallel, kept one by one
/// so that a study that was ended goes on.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_store.hpp>

#include "command.hpp"
#include "replay_arguments.hpp"
#include "unit_file.hpp"

namespace loopwise::cli {

/// Options of every study of replays.
struct StudyOptions {
  CommonOptions common;
  ReplayArguments replay;
  std::vector<std::string> missions, truth;
  std::string output;
  std::int64_t seeds = 1;
  bool keep_runs = false;
  bool resume = false;
  Transport* job = nullptr;  ///< Ranks to spread the units over; null: this process alone.
};
void add_study_options(CLI::App& command, StudyOptions& options);

/// A mission that a study looks at.
struct StudyMission {
  std::string path;
  std::vector<std::string> truth;  ///< Given for it, see set_truth().
  std::string name;
  std::string world;  ///< Missions of one world are repetitions: provenance's options.world, else the name.
  std::string seed;   ///< That it was made with; empty if not known.
  std::string parameters_sha256;  ///< Of the world's parameters; empty if not known.
  bool has_radio = false;
  bool truth_is_aligned = false;  ///< Its errors are those after alignment, see Mission.
  ContentHash content;            ///< Of all files, given truth included.
};

/// A replay.
struct StudyUnit {
  std::size_t mission = 0;  ///< Place in Study::missions().
  std::string label;        ///< For people and folders: "full", "full-w50".
  Config config;
};

/// A unit's files within the study's folder.
struct UnitFiles {
  std::filesystem::path result, seconds, run;
};

/// A study's folder, its missions and the configuration that its units vary.
class Study {
 public:
  /// Reads all missions once and makes the folder. \throws OptionError, InputError (also if a mission has no
  /// ground truth), IoError
  Study(std::string name, const StudyOptions& options, Console& console);

  [[nodiscard]] const std::vector<StudyMission>& missions() const { return missions_; }
  /// Defaults, what was asked for, and the odometry's guess unless another was asked for: outcomes are then
  /// shared by methods and budgets.
  [[nodiscard]] const Config& config() const { return config_; }
  /// Of the replays: --seed and those after it.
  [[nodiscard]] std::vector<std::uint64_t> seeds() const;
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }

  /// The results of all units, in their order, computed on `--threads` threads unless they are there. A unit
  /// runs on one thread; its result depends neither on their number nor on what else runs. Nothing if
  /// interrupted: what was finished is kept. Nothing either on ranks but the first of a job: they compute for
  /// it.
  [[nodiscard]] std::optional<std::vector<UnitResult>> run(const std::vector<StudyUnit>& units,
                                                           const StopToken& stop);

  /// Exit status where run() gave nothing.
  [[nodiscard]] int status_without_results() const;

 private:
  struct Open;
  [[nodiscard]] std::shared_ptr<OutcomeStore> open_outcomes() const;
  void run_here(const Open& open, const StopToken& stop);
  void run_on_ranks(const Open& open, const StopToken& stop);
  void serve(const std::vector<StudyUnit>& units, const StopToken& stop);
  [[nodiscard]] bool serves() const;
  [[nodiscard]] UnitFiles files_of(const StudyUnit& unit) const;
  [[nodiscard]] std::string greeting(const std::vector<StudyUnit>& units) const;

  std::string name_;  ///< "ablation"
  const StudyOptions& options_;
  Console& console_;
  Config config_;
  std::filesystem::path folder_;
  std::vector<StudyMission> missions_;
};

/// A unit for each mission, seed and method, in this order; on `workers` if given.
[[nodiscard]] std::vector<StudyUnit> units_by_method(const Study& study,
                                                     const std::vector<std::string>& methods,
                                                     std::optional<std::int64_t> workers);

/// Provenance of a study in its files.
[[nodiscard]] Json study_json(const Study& study);

}  // namespace loopwise::cli
