// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The parts of a run's journal that a report uses.
#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/key.hpp>

namespace loopwise {

struct RunJournal {
  /// The account after a batch, after an estimate, or at the end. Counts that the journal lacks are 0.
  struct Moment {
    double time_s;  ///< Since the mission's start.
    std::uint64_t generated, queued, computed, inliers;
  };

  std::vector<Moment> moments;                  ///< The last of each time, in the journal's order.
  std::vector<std::pair<Key, Key>> candidates;  ///< Those that were selected, batch by batch.
};

/// Lines that are not events, such as the last one of a killed run, are skipped. `name` is for messages.
/// \throws ParseError for a batch with invalid keys, IoError
[[nodiscard]] RunJournal parse_run_journal(std::istream& in, const std::string& name);

/// \throws IoError, ParseError
[[nodiscard]] RunJournal read_run_journal(const std::filesystem::path& path);

}  // namespace loopwise
