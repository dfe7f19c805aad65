// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Makes a folder of training data from missions.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/training/training_data.hpp>

namespace loopwise::training {

/// A mission to make data of.
struct DataSource {
  std::string name;         ///< Of the mission.
  std::string group;        ///< As MissionRecord::group.
  bool other_size = false;  ///< As MissionRecord::other_size.
  std::string made_with;    ///< All input that determines the record.
  /// Returns the record; may throw if the stop is requested. Calls may come from any thread.
  std::function<MissionRecord(const StopToken&)> record;
};

/// A recorded mission as a source. Its group is the world in its provenance, otherwise "recorded".
/// \throws InputError as record_of()
[[nodiscard]] LOOPWISE_EXPORT DataSource data_source(const Mission& mission, bool other_size);

/// The entries of the data set of these sources, with the names of their files. \throws OptionError if two
/// names give the same file; InputError as split_by_mission()
[[nodiscard]] LOOPWISE_EXPORT std::vector<DataSetEntry> data_set_entries(
    const std::vector<DataSource>& sources);

/// Size of a data set.
struct DataSetCounts {
  std::size_t missions = 0;  ///< All missions.
  std::size_t kept = 0;      ///< Missions whose data were in the folder already.
  std::size_t graphs = 0;    ///< Graphs of all missions.
  std::size_t sets = 0;      ///< Sets of all graphs, solved exactly.
};

/// Makes the data of the sources, for read_data_set(). Data of a mission that are in the folder already are
/// kept if they come from the same input and the same code. dataset.json is removed before the first file
/// changes and written after the last one, so an interrupted data set is not taken for a complete one. The
/// files do not depend on the number of threads.
/// \param folder that exists
/// \param sources missions, one file each
/// \param options of the graphs and sets
/// \param threads that make the data of missions
/// \param stop ends it early: Error; finished missions stay
/// \param progress is called after each mission, from one thread at a time
/// \throws as data_set_entries() and make_mission_data(); IoError
LOOPWISE_EXPORT DataSetCounts make_data_set(const std::filesystem::path& folder,
                                            const std::vector<DataSource>& sources,
                                            const DataOptions& options, ThreadPool& threads,
                                            const StopToken& stop = {},
                                            const ProgressCallback& progress = {});

}  // namespace loopwise::training
