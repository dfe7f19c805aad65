// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The key frames that hdl_graph_slam and mrg_slam save beside their graph. Private to io.
#pragma once

#include <map>
#include <optional>
#include <set>

#include <loopwise/io/g2o.hpp>

#include "cloud_files.hpp"

namespace loopwise {

/// Contents of the file `data` of a key frame.
struct KeyFrameData {
  std::optional<Key> id;                 ///< Of its node.
  std::optional<std::int64_t> stamp_ns;  ///< Of its scan.
  std::string robot;                     ///< Name that mrg_slam writes; otherwise empty.
};
/// Parses lines `stamp SECONDS NANOSECONDS`, `id NODE` (mrg_slam: `g2o_id NODE`), `robot_name NAME`, and
/// poses, which the graph also has. Other lines are counted by their first word. \throws ParseError naming
/// `name` and the line
[[nodiscard]] KeyFrameData parse_key_frame_data(const std::string& name, std::string_view contents,
                                                Problems& problems);

/// Key frames by the ids of their nodes.
struct KeyFrameFolders {
  std::set<Key> ids;                  ///< Of all key frames.
  FileSource files;                   ///< NUMBER/cloud.pcd of each.
  std::map<Key, std::size_t> clouds;  ///< Number of the file; a key frame may lack it.
  parts::Stamps stamps;               ///< A key frame may lack it.
  /// The anchor of the first node according to special_nodes.csv. Old versions of the program do not write
  /// the file.
  std::optional<std::set<Key>> anchors;
  std::map<Key, Key> full;    ///< mrg_slam: key of each node, with the character of its robot.
  std::vector<Robot> robots;  ///< mrg_slam: by their names.
};

/// Key frames in folders NUMBER/ with a file `data`. Nothing if there is no such folder. \throws ParseError;
/// InputError naming two key frames of one id; IoError
[[nodiscard]] std::optional<KeyFrameFolders> find_key_frame_folders(const std::filesystem::path& folder,
                                                                    Problems& problems);

/// Whether mrg_slam saved the folder: g2o/graph.g2o and keyframes/.
[[nodiscard]] bool is_mrg_slam(const std::filesystem::path& folder);
/// Key frames of a team of robots in keyframes/NUMBER.txt and NUMBER.pcd. Robots get the characters a, b, …
/// in the order of their names, and their nodes get the indices 0, 1, … in the order of their stamps. \throws
/// as find_key_frame_folders(); InputError if there is no key frame, or more robots than letters
[[nodiscard]] KeyFrameFolders find_team_key_frames(const std::filesystem::path& folder, Problems& problems);

/// The graph without the fixed node to which hdl_graph_slam connects its first node. special_nodes.csv names
/// the fixed node. Without this file, fixed nodes without key frames are used, which is counted as a guess.
/// Edges to the fixed node become priors of the same cost, which is counted.
[[nodiscard]] G2oFile without_anchors(G2oFile graph, const KeyFrameFolders& key_frames,
                                      const std::string& name);

}  // namespace loopwise
