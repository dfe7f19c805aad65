// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/output_folder.hpp>

#include <unistd.h>

#include <stdexcept>
#include <system_error>
#include <utility>

#include <loopwise/core/error.hpp>

namespace loopwise {

namespace fs = std::filesystem;

void prepare_output_folder(const fs::path& folder, bool may_exist, const std::string& hint) {
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

void refuse_recording(const fs::path& folder, const std::vector<std::string>& sources) {
  if (!fs::is_directory(folder)) return;
  const std::string consequence = ", whose files the results could replace: choose another folder";
  std::error_code unknown;
  for (const fs::path source : sources) {
    const fs::path place = fs::is_directory(source) ? source : fs::absolute(source).parent_path();
    if (fs::equivalent(place, folder, unknown))
      throw OptionError(folder.string() + ": " + source.string() + " lies there" + consequence);
  }
  for (const char* name :
       {"mission.json", "result.g2o", "keys.csv", "optimized_poses.txt", "odom_poses.txt",
        "singlesession_posegraph.g2o", "poses.txt", "calib.txt", "graph.txt", "poses_tum.txt",
        "poses_kitti.txt", "pose.json", "alidarState.txt", "local_map_graph.g2o", "special_nodes.csv"}) {
    if (fs::exists(folder / name))
      throw OptionError(folder.string() + ": there is a recording (" + name + ")" + consequence);
  }
}

NewFolder::NewFolder(fs::path folder) : folder_(std::move(folder)), remove_(!fs::exists(folder_)) {
  prepare_output_folder(folder_, false, "");
}

NewFolder::~NewFolder() {
  std::error_code ignored;
  if (remove_) fs::remove(folder_, ignored);  // does nothing if the folder is not empty
}

void remove_former(const fs::path& file) {
  std::error_code failure;
  fs::remove(file, failure);
  if (failure) throw IoError(file.string(), "cannot be removed: " + failure.message());
}

}  // namespace loopwise
