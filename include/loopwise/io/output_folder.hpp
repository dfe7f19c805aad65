// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Makes an output folder. An existing folder is accepted if it is empty or `may_exist` is set. \throws
/// OptionError, whose message ends with `hint`, if an existing folder is not accepted; std::runtime_error if
/// it cannot be made or written to
LOOPWISE_EXPORT void prepare_output_folder(const std::filesystem::path& folder, bool may_exist,
                                           const std::string& hint);

/// Protects recorded files from results. \throws OptionError if results in this folder could overwrite
/// recorded files: if it is or contains one of the sources, or contains any recording
LOOPWISE_EXPORT void refuse_recording(const std::filesystem::path& folder,
                                      const std::vector<std::string>& sources);

/// A folder for results that is new or empty. Unless keep() is called, the destructor removes the folder
/// again if this object made it and nothing is in it.
class LOOPWISE_EXPORT NewFolder {
 public:
  /// Makes the folder. \throws as prepare_output_folder()
  explicit NewFolder(std::filesystem::path folder);
  ~NewFolder();
  NewFolder(const NewFolder&) = delete;
  NewFolder& operator=(const NewFolder&) = delete;

  /// The results are complete: the folder stays.
  void keep() { remove_ = false; }

 private:
  std::filesystem::path folder_;
  bool remove_;
};

/// Removes a file that would be mistaken for a result of a new run, if it exists. \throws IoError
LOOPWISE_EXPORT void remove_former(const std::filesystem::path& file);

}  // namespace loopwise
