// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/output_folder.hpp>

#include <unistd.h>

#include <stdexcept>
#include <system_error>

#include <loopwise/core/error.hpp>

namespace loopwise {

void prepare_output_folder(const std::filesystem::path& folder, bool may_exist, const std::string& hint) {
  namespace fs = std::filesystem;
  if (folder.empty()) throw OptionError("the output folder has no name");
  if (fs::exists(folder) && !fs::is_directory(folder)) {
    throw OptionError(folder.string() + ": exists and is not a folder");
  }
  if (fs::exists(folder) && !fs::is_empty(folder) && !may_exist) {
    throw OptionError(folder.string() + ": exists and is not empty" + hint);
  }
  std::error_code failure;
  fs::create_directories(folder, failure);
  if (failure) throw std::runtime_error(folder.string() + ": " + failure.message());
  if (access(folder.c_str(), W_OK | X_OK) != 0) throw std::runtime_error(folder.string() + ": not writable");
}

}  // namespace loopwise
