// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Clouds of nodes in a folder or an archive, by the names that LAMP and its data sets give them. Private to
/// io.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "mission_parts.hpp"

namespace loopwise {

/// The files of a folder or an archive: names without their folders, and how to read them.
struct FileSource {
  std::string where;  ///< The folder or archive.
  std::vector<std::string> names;
  std::function<std::string(std::size_t)> read;  ///< Safe to call from several threads.

  /// The n-th file, for messages.
  [[nodiscard]] std::string path(std::size_t number) const { return where + "/" + names[number]; }
  [[nodiscard]] std::optional<std::size_t> find(const std::string& name) const;
};
[[nodiscard]] FileSource files_of_folder(const std::filesystem::path& folder);
/// \throws as ZipArchive
[[nodiscard]] FileSource files_of_archive(const std::filesystem::path& file);

/// LAMP's keys.csv: `key,file,stamp_ns`, no header. A node without a cloud has no file.
struct KeyTable {
  std::map<std::string, Key> key_of;  ///< By the name of the file, without its folder.
  parts::Stamps stamps;
};
/// \throws ParseError naming `name` and the line
[[nodiscard]] KeyTable parse_key_table(const std::string& name, const std::string& contents);

/// Clouds of a source, assigned by their names.
struct NamedClouds {
  std::map<Key, std::size_t> by_key;     ///< KEY.pcd, a12.pcd, or by the key table.
  std::map<Key, std::size_t> by_number;  ///< pc_N.pcd without a key table: by N.

  [[nodiscard]] bool empty() const { return by_key.empty() && by_number.empty(); }
};
/// Counts "foreign file in scans" and "repeated scan".
[[nodiscard]] NamedClouds name_clouds(const FileSource& files, const KeyTable& table, Problems& problems);

/// Clouds by the keys of the key frames, which are in order. Numbered clouds belong to the nodes by rank.
/// Clouds that are named by a small index belong to the nodes of the only robot. \throws InputError if the
/// number of numbered clouds differs from the number of nodes: the assignment is unknown then
[[nodiscard]] std::map<Key, std::size_t> clouds_of_nodes(const NamedClouds& clouds,
                                                         const std::vector<Key>& keys,
                                                         const FileSource& files);

/// Makes the scan store of the mission, see parts::set_scans().
void set_scans(Mission& mission, const FileSource& files, const std::map<Key, std::size_t>& clouds,
               const MissionOptions& options);

}  // namespace loopwise
