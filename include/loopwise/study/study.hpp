// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Studies of replays: each mission under each configuration once, in parallel, with results stored one by
/// one so that an interrupted study can continue; and tables of the results.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_store.hpp>

namespace loopwise {
class Transport;
}

/// Measurements of the system, or of a part of it, against ground truth.
namespace loopwise::study {

/// A mission of a study.
struct StudySource {
  std::string path;                ///< As for read_mission().
  std::vector<std::string> truth;  ///< Files of true poses in place of recorded ones, as for set_truth().
};

/// The defaults of studies: registrations use the guess by odometry, so that methods and budgets share their
/// outcomes.
[[nodiscard]] LOOPWISE_EXPORT Config study_config();

/// Missions and configuration of a study, and the folder of its results.
struct StudyOptions {
  std::vector<StudySource> missions;   ///< Those of one world are repetitions. Each has ground truth.
  Config config = study_config();      ///< The base configuration, which the studies vary.
  std::filesystem::path folder;        ///< For the runs and their shared data.
  std::int64_t seeds = 1;              ///< Number of seeds for each mission, starting at that of `config`.
  bool keep_runs = false;              ///< Keep each run's folder, as write_run_folder() writes it.
  bool resume = false;                 ///< `folder` may hold any files. A study in it always continues.
  int threads = 0;                     ///< Runs at a time; 0: all processors. Never changes the results.
  std::filesystem::path outcomes;      ///< Folder of registrations' outcomes; empty: one within `folder`.
  OutcomeStoreOptions outcomes_bound;  ///< Of that folder.
  Transport* job = nullptr;            ///< Ranks to spread the runs over; null: this process alone.
  double rank_time_limit_s = 86400.0;  ///< A rank without an answer for this time counts as dead.
};

/// To watch a study, or to stop it. All may be empty; called from one thread at a time.
struct StudyHooks {
  ProgressCallback progress;                                    ///< Of reading missions and of runs.
  std::function<void(const std::string&)> note;                 ///< Notes, one line at a time.
  std::function<void(const std::string&)> warn;                 ///< Warnings about the results.
  std::function<void(const OutcomeStoreStatistics&)> outcomes;  ///< Use of stored outcomes, at the end.
  StopToken stop;                                               ///< Finished runs are kept.
};

/// Whether this process computes for the first rank of its job. A study then returns no result.
[[nodiscard]] LOOPWISE_EXPORT bool serves(const StudyOptions& options);

/// Results of a study of replays, as the contents of files.
struct StudyReport {
  std::string json;      ///< Figures and their provenance.
  std::string markdown;  ///< Tables for people.
  std::string csv;       ///< A row for each run, moment or robot.
};

/// Comparison of methods.
struct AblationOptions {
  std::vector<std::string> methods{"baseline", "obs", "random", "gi", "full"};  ///< Each once.
  std::optional<std::int64_t> workers;  ///< Registrations at a time; else those of the configuration.
  /// Also judge each map at revisits that it was not made of, as map_quality() does: takes as long as up to
  /// 500 registrations for each mission and seed.
  bool map_quality = false;
};
/// Methods over missions and seeds, the paper's Table I. The file NAME_timings.csv in the folder gets the
/// wall times of the runs, as in the studies below. \returns no result if stopped, or on ranks except the
/// first of a job \throws OptionError; InputError, also if a mission has no ground truth; IoError
[[nodiscard]] LOOPWISE_EXPORT std::optional<StudyReport> ablation(const StudyOptions& options,
                                                                  const AblationOptions& wanted = {},
                                                                  const StudyHooks& hooks = {});

/// Computing budgets.
struct BudgetOptions {
  std::vector<std::string> methods{"baseline", "full"};  ///< Each once.
  std::vector<std::int64_t> workers{2, 10, 50};          ///< Computers, by their registrations at a time.
  /// Method that orders the computation of all candidates after the mission; "none" skips it.
  std::string everything = "baseline";
};
/// Errors against computation: on larger computers, later in the mission, and after it until everything is
/// computed. \returns, \throws as ablation()
[[nodiscard]] LOOPWISE_EXPORT std::optional<StudyReport> budget(const StudyOptions& options,
                                                                const BudgetOptions& wanted = {},
                                                                const StudyHooks& hooks = {});

/// Methods beside odometry.
struct RssiOptions {
  std::vector<std::string> methods{"rssi", "full"};  ///< Each once.
  std::optional<std::int64_t> workers;  ///< Registrations at a time; else those of the configuration.
};
/// Each robot's errors by odometry, with closures at radio beacons and with all: the paper's Table II.
/// \returns, \throws as ablation()
[[nodiscard]] LOOPWISE_EXPORT std::optional<StudyReport> rssi(const StudyOptions& options,
                                                              const RssiOptions& wanted = {},
                                                              const StudyHooks& hooks = {});

}  // namespace loopwise::study
