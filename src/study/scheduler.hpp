// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The units of a study in parallel, on threads or on the ranks of a job, stored one by one so that an
/// interrupted study can continue.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/study/study.hpp>

#include "unit.hpp"

namespace loopwise::study {

/// A study's folder, its missions and the configuration that its units vary.
class Study {
 public:
  /// Reads all missions once and makes the folder. Both arguments must outlive it. \throws OptionError,
  /// InputError (also if a mission has no ground truth), IoError
  Study(std::string name, const StudyOptions& options, const StudyHooks& hooks);

  [[nodiscard]] const std::vector<StudyMission>& missions() const { return missions_; }
  [[nodiscard]] const Config& config() const { return options_.config; }
  /// Of the replays: the seed of the configuration and the following ones.
  [[nodiscard]] std::vector<std::uint64_t> seeds() const;

  void warn(const std::string& text) const;

  /// The results of all units, in their order. Missing ones are computed on StudyOptions::threads threads. A
  /// unit runs on one thread; its result depends neither on the number of threads nor on other units. Empty
  /// if interrupted, but finished units are kept. Also empty on all ranks of a job except the first, because
  /// they compute for it.
  [[nodiscard]] std::optional<std::vector<UnitResult>> run(const std::vector<StudyUnit>& units);

 private:
  struct Open;
  [[nodiscard]] const std::filesystem::path& folder() const { return options_.folder; }
  [[nodiscard]] std::shared_ptr<OutcomeStore> open_outcomes() const;
  void run_here(const Open& open, const StopToken& stop);
  void run_on_ranks(const Open& open, const StopToken& stop);
  void serve(const std::vector<StudyUnit>& units, const StopToken& stop);
  [[nodiscard]] std::string greeting(const std::vector<StudyUnit>& units) const;
  void note(const std::string& text) const;
  void show(std::size_t done, std::size_t total, const std::string& detail) const;

  std::string name_;  ///< "ablation"
  const StudyOptions& options_;
  const StudyHooks& hooks_;
  std::vector<StudyMission> missions_;
};

/// A unit for each mission, seed and method, in this order; on `workers` if given.
[[nodiscard]] std::vector<StudyUnit> units_by_method(const Study& study,
                                                     const std::vector<std::string>& methods,
                                                     std::optional<std::int64_t> workers);

/// The provenance in the files of a study.
[[nodiscard]] Json study_json(const Study& study);

}  // namespace loopwise::study
