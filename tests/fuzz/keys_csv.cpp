// SPDX-License-Identifier: BSD-3-Clause
// keys.csv, and the names of clouds beside it: the first line is a list of names, parted by '/'.
#include <algorithm>

#include "cloud_files.hpp"
#include "target.hpp"

LOOPWISE_FUZZ_TARGET(keys_csv, bytes) {
  using namespace loopwise;
  const std::size_t end = std::min(bytes.find('\n'), bytes.size());
  const std::string rest(bytes.substr(std::min(end + 1, bytes.size())));
  const auto table = fuzz::attempt([&] { return parse_key_table("keys.csv", rest); });
  if (!table) return;
  for (const auto& [file, key] : table->key_of) {
    fuzz::expect(!file.empty() && file.find('/') == std::string::npos, "names are of files, not of paths");
    fuzz::expect(table->stamps.count(key) == 1, "a file's node has a stamp");
  }
  for (const auto& [key, stamp] : table->stamps) {
    fuzz::expect(parts::stamp_in_range(stamp), "stamps are in range");
  }
  FileSource files;
  files.where = "folder";
  std::string_view names = bytes.substr(0, end);
  while (!names.empty()) {
    const std::size_t slash = std::min(names.find('/'), names.size());
    if (slash > 0) files.names.emplace_back(names.substr(0, slash));
    names.remove_prefix(std::min(slash + 1, names.size()));
  }
  Problems problems;
  const NamedClouds clouds = name_clouds(files, *table, problems);
  for (const auto& [key, number] : clouds.by_key) {
    fuzz::expect(number < files.names.size(), "clouds are among the files");
  }
  std::vector<Key> keys;
  for (const auto& [key, stamp] : table->stamps) keys.push_back(key);
  std::sort(keys.begin(), keys.end());
  const auto of_nodes = fuzz::attempt([&] { return clouds_of_nodes(clouds, keys, files); });
  for (const auto& [key, number] : of_nodes.value_or(std::map<Key, std::size_t>())) {
    fuzz::expect(number < files.names.size(), "clouds of nodes are among the files");
  }
}
