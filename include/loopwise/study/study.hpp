// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Studies of replays: each mission under each configuration once, in parallel, kept one by one so that a
/// study that was ended goes on; and tables of what came of them.
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

/// A mission to look at.
struct StudySource {
  std::string path;                ///< As for read_mission().
  std::vector<std::string> truth;  ///< Files of true poses in place of recorded ones, as for set_truth().
};

/// The defaults of studies: registrations get the odometry's guess, so that methods and budgets share their
/// outcomes.
[[nodiscard]] LOOPWISE_EXPORT Config study_config();

/// What is replayed, and where it is kept.
struct StudyOptions {
  std::vector<StudySource> missions;   ///< Those of one world are repetitions. Each has ground truth.
  Config config = study_config();      ///< That the studies vary.
  std::filesystem::path folder;        ///< For the runs and what they share.
  std::int64_t seeds = 1;              ///< Each mission is replayed with so many, from that of `config` on.
  bool keep_runs = false;              ///< Keep each run's folder, as write_run_folder() writes it.
  bool resume = false;                 ///< `folder` may hold anything. One that holds a study always goes on.
  int threads = 0;                     ///< Runs at a time; 0: all processors. Never changes the results.
  std::filesystem::path outcomes;      ///< Folder of registrations' outcomes; empty: one within `folder`.
  OutcomeStoreOptions outcomes_bound;  ///< Of that folder.
  Transport* job = nullptr;            ///< Ranks to spread the runs over; null: this process alone.
  double rank_time_limit_s = 86400.0;  ///< A rank that owes an answer for this long is taken for dead.
};

/// To watch a study, or to stop it. All may be empty; called from one thread at a time.
struct StudyHooks {
  ProgressCallback progress;                                    ///< Of reading missions and of runs.
  std::function<void(const std::string&)> note;                 ///< What is of use to know, a line at a time.
  std::function<void(const std::string&)> warn;                 ///< What the results may suffer from.
  std::function<void(const OutcomeStoreStatistics&)> outcomes;  ///< What came of stored outcomes, at the end.
  StopToken stop;                                               ///< Finished runs are kept.
};

/// Whether this process computes for the first rank of its job. A study then returns nothing in the end.
[[nodiscard]] LOOPWISE_EXPORT bool serves(const StudyOptions& options);

/// What a study of replays found, as the contents of files.
struct StudyReport {
  std::string json;      ///< Figures and how they were made.
  std::string markdown;  ///< Tables for people.
  std::string csv;       ///< A row for each run, moment or robot.
};

/// Methods side by side.
struct AblationOptions {
  std::vector<std::string> methods{"baseline", "obs", "random", "gi", "full"};  ///< Each once.
  std::optional<std::int64_t> workers;  ///< Registrations at a time; else those of the configuration.
};
/// Methods over missions and seeds, the paper's Table I. The file NAME_timings.csv in the folder gets the
/// wall times of the runs, as in the studies below. \returns nothing if stopped, or on ranks but the first of
/// a job \throws OptionError; InputError, also if a mission has no ground truth; IoError
[[nodiscard]] LOOPWISE_EXPORT std::optional<StudyReport> ablation(const StudyOptions& options,
                                                                  const AblationOptions& wanted = {},
                                                                  const StudyHooks& hooks = {});

/// What may be computed.
struct BudgetOptions {
  std::vector<std::string> methods{"baseline", "full"};  ///< Each once.
  std::vector<std::int64_t> workers{2, 10, 50};          ///< Computers, by their registrations at a time.
  /// Method in whose order everything is computed after the mission; "none" leaves that out.
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
