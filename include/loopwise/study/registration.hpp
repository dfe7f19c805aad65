// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The study of registrars: pairs of one mission computed by each, and judged against the truth.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/study/pair_statistics.hpp>

namespace loopwise::study {

/// Which pairs are computed, and by what.
struct RegistrationStudyOptions {
  std::vector<RegistrarKind> registrars{RegistrarKind::kFast, RegistrarKind::kPcl};  ///< One after the other.
  std::size_t count = 2000;   ///< Candidates to draw; 0 takes all.
  std::size_t pcl_count = 0;  ///< PCL computes only the first so many of them; 0: all.
  std::uint64_t seed = 1;     ///< Of the draw.
  /// The registrars get the true relative pose in place of the odometry's. The recall is then nearly
  /// what the tests of closures allow; a few pairs are found only from another guess.
  bool true_guess = false;
  int threads = 0;  ///< 0: all processors. Changes only times, never results.
};

/// Results of one registrar for the pairs.
struct RegistrarOutcomes {
  RegistrarKind registrar = RegistrarKind::kFast;  ///< Which.
  std::vector<PairOutcome> outcomes;               ///< Of the first pairs of the study.
  std::map<std::string, std::size_t> rejected;     ///< Number of rejected pairs, by reason.
  double seconds = 0.0;                            ///< Wall time of the batch.
};

/// The pairs and their results.
struct RegistrationStudy {
  std::size_t generated = 0;                  ///< Candidates of the mission.
  std::vector<StudyPair> pairs;               ///< The drawn pairs.
  std::vector<RegistrarOutcomes> registrars;  ///< In the requested order.
};

/// Draws candidates of a mission uniformly among those whose nodes have truth and scans, and computes them.
/// \returns no result if stopped
/// \throws OptionError, also if this build lacks a registrar; InputError
[[nodiscard]] LOOPWISE_EXPORT std::optional<RegistrationStudy> study_registration(
    const Mission& mission, const ReplayOptions& replay, const RegistrationStudyOptions& options,
    const StopToken& stop = {}, const ProgressCallback& progress = {});

/// A registration study for people and programs.
struct RegistrationReport {
  std::string json;      ///< Figures of each registrar, over all pairs and by strata.
  std::string csv;       ///< A row for every pair and registrar.
  std::string markdown;  ///< Tables as Markdown.
  std::string summary;   ///< One table as text in columns: all pairs.
  std::string strata;    ///< Tables as text in columns: by distance, overlap and observability.
};
/// Puts a study into figures and tables. `mission` is its name, `threads` were used, and all took `seconds`.
[[nodiscard]] LOOPWISE_EXPORT RegistrationReport report_registration(const RegistrationStudy& study,
                                                                     const std::string& mission, int threads,
                                                                     double seconds);

}  // namespace loopwise::study
