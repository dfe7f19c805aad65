// SPDX-License-Identifier: BSD-3-Clause
#include "cloud_files.hpp"

#include <algorithm>
#include <cctype>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "cloud_points.hpp"
#include "file_kind.hpp"
#include "text.hpp"
#include "zip_archive.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

std::string last_part(const std::string& path) {
  return path.substr(path.find_last_of("/\\") + 1);
}

}  // namespace

std::optional<std::size_t> FileSource::find(const std::string& name) const {
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) return std::nullopt;
  return static_cast<std::size_t>(found - names.begin());
}

FileSource files_of_folder(const fs::path& folder) {
  FileSource files;
  files.where = folder.string();
  for (const fs::path& entry : parts::entries(folder)) {
    if (fs::is_regular_file(entry)) files.names.push_back(entry.filename().string());
  }
  files.read = [folder, names = files.names](std::size_t number) {
    return read_file(folder / names[number]);
  };
  return files;
}

FileSource files_of_archive(const fs::path& file) {
  refuse_foreign_file(file, {FileKind::kZip}, "a zip archive");
  const ZipArchive archive(file);
  FileSource files;
  files.where = file.string();
  for (const std::string& name : archive.names()) files.names.push_back(last_part(name));
  files.read = [archive](std::size_t number) { return archive.read(number); };
  return files;
}

KeyTable parse_key_table(const std::string& name, const std::string& contents) {
  KeyTable table;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    line = text::trim(line);
    if (line.empty()) continue;
    const text::Place place{name, lines.number()};
    // The name of a file may contain commas.
    const std::size_t first = line.find(','), last = line.rfind(',');
    if (first == std::string_view::npos || first == last) {
      place.fail("expected key,file,stamp in ns, found " + text::quoted(line));
    }
    Key key = 0;
    std::int64_t stamp = 0;
    const std::string_view key_text = text::trim(line.substr(0, first)),
                           stamp_text = text::trim(line.substr(last + 1));
    if (const char* why = text::parse_id(key_text, key))
      place.fail("key " + text::quoted(key_text) + " " + why);
    if (!text::parse_int64(stamp_text, stamp) || !parts::stamp_in_range(stamp)) {
      place.fail(text::quoted(stamp_text) + " is not a stamp in ns");
    }
    if (!table.stamps.emplace(key, stamp).second) place.fail("node " + key_name(key) + " appears twice");
    const std::string file = last_part(std::string(text::trim(line.substr(first + 1, last - first - 1))));
    if (!file.empty() && !table.key_of.emplace(file, key).second) {
      place.fail("file " + text::quoted(file) + " appears twice");
    }
  }
  return table;
}

NamedClouds name_clouds(const FileSource& files, const KeyTable& table, Problems& problems) {
  NamedClouds clouds;
  for (std::size_t i = 0; i < files.names.size(); ++i) {
    const std::string& name = files.names[i];
    if (!is_cloud_file(name)) {
      const bool known = name == "keys.csv" || name == parts::kRanges || name == parts::kGravity ||
                         name == parts::kOdometry || fs::path(name).extension() == ".g2o" ||
                         fs::path(name).extension() == ".bag" || fs::path(name).extension() == ".zip";
      if (!known) problems.add("foreign file in scans", files.path(i));
      continue;
    }
    const std::string stem = parts::cloud_stem(name);
    Key key = 0;
    auto* list = &clouds.by_key;
    const auto listed = table.key_of.find(name);
    if (listed != table.key_of.end()) {
      key = listed->second;
    } else if (stem.rfind("pc_", 0) == 0 && text::has_only_digits(stem.substr(3)) &&
               text::parse_id(stem.substr(3), key) == nullptr) {
      list = &clouds.by_number;
    } else {
      const bool letter = stem.size() > 1 && text::has_only_digits(stem.substr(1));
      try {
        if (!letter && !text::has_only_digits(stem)) throw InputError("no key");
        key = parse_key(stem);
      } catch (const InputError&) {
        problems.add("foreign file in scans", files.path(i));
        continue;
      }
    }
    const auto [taken, is_new] = list->emplace(key, i);
    if (!is_new) problems.add("repeated scan", files.path(i) + ", taken: " + files.names[taken->second]);
  }
  return clouds;
}

std::map<Key, std::size_t> clouds_of_nodes(const NamedClouds& clouds, const std::vector<Key>& keys,
                                           const FileSource& files) {
  std::map<Key, std::size_t> out = clouds.by_key;
  const char character = keys.empty() ? '\0' : key_character(keys.front());
  const bool one_robot = !keys.empty() && key_character(keys.back()) == character;
  const bool small_names = !out.empty() && key_character(out.rbegin()->first) == '\0';
  if (one_robot && small_names && character != '\0') {
    std::map<Key, std::size_t> renamed;
    for (const auto& [index, file] : out) renamed[make_key(character, index)] = file;
    out = std::move(renamed);
  }
  if (!clouds.by_number.empty()) {
    if (clouds.by_number.size() != keys.size()) {
      throw InputError(files.where + ": " + std::to_string(clouds.by_number.size()) +
                       " clouds are named by their rank (pc_N), for " + std::to_string(keys.size()) +
                       " nodes: keys.csv must list the node of each cloud");
    }
    auto key = keys.begin();
    for (const auto& [number, file] : clouds.by_number) out.emplace(*key++, file);
  }
  return out;
}

void set_scans(Mission& mission, const FileSource& files, const std::map<Key, std::size_t>& clouds,
               const MissionOptions& options) {
  std::vector<Key> keys;
  keys.reserve(clouds.size());
  for (const auto& [key, file] : clouds) keys.push_back(key);
  parts::set_scans(
      mission, keys,
      [files, clouds, layout = options.bin_layout](Key key) {
        const std::size_t number = clouds.at(key);
        return points::parse_cloud(files.path(number), files.read(number), layout);
      },
      [&](Key key) { return files.path(clouds.at(key)); }, options);
}

}  // namespace loopwise
