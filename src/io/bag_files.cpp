// SPDX-License-Identifier: BSD-3-Clause
#include "bag_files.hpp"

#include <algorithm>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMetadata = "metadata.yaml";
constexpr std::string_view kMetadataKey = "rosbag2_bagfile_information:";

/// The name without the ending of a file that is compressed with zstd.
fs::path unpacked_name(const fs::path& file) {
  return file.extension() == ".zstd" || file.extension() == ".zst" ? file.parent_path() / file.stem() : file;
}

bool is_rosbag2_name(const fs::path& file) {
  const fs::path ending = unpacked_name(file).extension();
  return ending == ".db3" || ending == ".mcap";
}

/// A value of YAML as rosbag2 writes it: plain, or in quotes.
std::string_view scalar(std::string_view text) {
  text = text::trim(text);
  const bool quoted = text.size() >= 2 && (text[0] == '"' || text[0] == '\'') && text.back() == text[0];
  return quoted ? text.substr(1, text.size() - 2) : text;
}

/// Names of the files that metadata.yaml lists, without the folders that old versions wrote.
std::vector<std::string> listed_files(const fs::path& metadata) {
  const std::string contents = read_file(metadata);
  if (contents.find(kMetadataKey) == std::string::npos)
    throw InputError(metadata.string() + ": expected rosbag2_bagfile_information");
  std::vector<std::string> names;
  bool in_list = false;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    std::string_view rest = text::trim(line);
    if (rest.empty()) continue;
    if (in_list && rest[0] == '-') {
      const fs::path path(std::string(scalar(rest.substr(1))));
      if (!is_rosbag2_name(path.filename()))
        text::Place{metadata.string(), lines.number()}.fail(text::quoted(path.string()) +
                                                            " is not the name of a bag");
      names.push_back(path.filename().string());
    } else {
      in_list = rest == "relative_file_paths:";
    }
  }
  return names;
}

/// The listed file, or its compressed or decompressed copy.
fs::path find_listed(const fs::path& folder, const std::string& name) {
  const fs::path plain = unpacked_name(folder / name);
  for (const fs::path& file : {folder / name, plain, fs::path(plain.string() + ".zstd")}) {
    if (parts::exists(file)) return file;
  }
  throw InputError((folder / kMetadata).string() + ": lists " + text::quoted(name) +
                   ", which is missing: add it, or remove metadata.yaml to read the files that exist");
}

Parts rosbag2_parts(const fs::path& folder, Problems& problems) {
  Parts files, there;
  for (const fs::path& entry : parts::entries(folder)) {
    if (is_rosbag2_name(entry) && fs::is_regular_file(entry)) there.push_back(entry);
  }
  if (!parts::exists(folder / kMetadata)) {
    for (const fs::path& file : there) {
      const fs::path plain = unpacked_name(file);
      if (plain == file || !parts::exists(plain)) files.push_back(file);
    }
    return files;
  }
  std::set<fs::path> known;
  for (const std::string& name : listed_files(folder / kMetadata)) {
    files.push_back(find_listed(folder, name));
    known.insert(unpacked_name(files.back()));
  }
  for (const fs::path& file : there) {
    if (known.count(unpacked_name(file)) == 0)
      problems.add_altered("bag not listed in metadata.yaml left out", file.string());
  }
  return files;
}

}  // namespace

bool is_bag_name(const fs::path& file) {
  return file.extension() == ".bag" || is_rosbag2_name(file);
}

bool is_rosbag2_folder(const fs::path& folder) {
  if (!fs::is_directory(folder)) return false;
  const fs::path metadata = folder / kMetadata;
  if (fs::is_regular_file(metadata) && parts::begins_with(metadata, kMetadataKey)) return true;
  const std::vector<fs::path> files = parts::entries(folder);
  return std::any_of(files.begin(), files.end(),
                     [](const fs::path& file) { return is_rosbag2_name(file) && fs::is_regular_file(file); });
}

bool has_bags(const fs::path& folder) {
  if (is_rosbag2_folder(folder)) return true;
  const std::vector<fs::path> files = parts::entries(folder);
  return std::any_of(files.begin(), files.end(), [](const fs::path& file) {
    const bool is_ros1 = file.extension() == ".bag" || file.extension() == ".active";
    return is_ros1 ? fs::is_regular_file(file) : !parts::is_truth(file) && is_rosbag2_folder(file);
  });
}

std::vector<Parts> bags_of_folder(const fs::path& folder, Problems& problems) {
  std::vector<Parts> all;
  Parts ros1;
  for (const fs::path& entry : parts::entries(folder)) {
    if (entry.extension() == ".bag" && fs::is_regular_file(entry)) ros1.push_back(entry);
    if (entry.extension() == ".active" && fs::is_regular_file(entry))
      problems.add_altered("bag that was never closed left out", entry.string());
  }
  if (!ros1.empty()) all.push_back(std::move(ros1));
  if (is_rosbag2_folder(folder)) all.push_back(rosbag2_parts(folder, problems));
  for (const fs::path& entry : parts::entries(folder)) {
    if (!parts::is_truth(entry) && is_rosbag2_folder(entry)) all.push_back(rosbag2_parts(entry, problems));
  }
  return all;
}

}  // namespace loopwise::bags
