// SPDX-License-Identifier: BSD-3-Clause
#include "hdl_graph_slam.hpp"

#include <algorithm>
#include <cctype>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "information.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

std::int64_t parse_stamp(std::string_view line, const text::Place& place) {
  std::int64_t seconds = 0, nanoseconds = 0;
  const std::string_view s = text::next_word(line), ns = text::next_word(line);
  const bool whole = text::parse_int64(s, seconds) && text::parse_int64(ns, nanoseconds);
  constexpr std::int64_t kSecond = 1'000'000'000;
  if (!whole || seconds < 0 || seconds > 4 * kSecond || nanoseconds < 0 || nanoseconds >= kSecond)
    place.fail("stamp needs seconds and nanoseconds");
  return seconds * kSecond + nanoseconds;
}

/// Known words of `data`. The first list has words that the graph repeats and words within poses; the second
/// has words of factors that are not read.
constexpr std::string_view kUsed[] = {
    "estimate",     "odom",           "accum_distance",  "nan",      "inf",          "readable_id",
    "odom_counter", "first_keyframe", "static_keyframe", "uuid_str", "slam_uuid_str"};
constexpr std::string_view kUnused[] = {"floor_coeffs", "utm_coord", "acceleration", "orientation"};

constexpr std::string_view kNameless = "\"\"";  // as mrg_slam writes the name of a robot without one

/// Ids in lines `anchor_node ID`; -1 stands for no node.
std::optional<std::set<Key>> read_anchors(const fs::path& file) {
  if (!fs::is_regular_file(file)) return std::nullopt;
  const std::string name = file.string(), contents = read_file(file);
  std::set<Key> anchors;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    if (text::next_word(line) != "anchor_node") continue;
    std::int64_t id = 0;
    if (!text::parse_int64(text::next_word(line), id))
      text::Place{name, lines.number()}.fail("anchor_node needs the id of a node, or -1");
    if (id >= 0) anchors.insert(static_cast<Key>(id));
  }
  return anchors;
}

/// Converts an edge to a fixed node to a prior of its other end. The residual is the same up to its frame.
PriorFactor prior_of(const Edge& edge, bool fixed_is_from, const Eigen::Isometry3d& fixed) {
  if (fixed_is_from) return {edge.to, se3::normalized(fixed * edge.T_from_to), edge.information};
  // r = Log(Z⁻¹T⁻¹F) = −Ad(Z⁻¹)·Log((FZ⁻¹)⁻¹T)
  const Eigen::Isometry3d inverse = edge.T_from_to.inverse();
  return {edge.from, se3::normalized(fixed * inverse), moved_information(edge.information, inverse)};
}

}  // namespace

KeyFrameData parse_key_frame_data(const std::string& name, std::string_view contents, Problems& problems) {
  KeyFrameData data;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const text::Place place{name, lines.number()};
    const std::string_view word = text::next_word(line);
    if (word.empty() || std::isalpha(static_cast<unsigned char>(word[0])) == 0) continue;  // rows of a matrix
    if (word == "stamp") {
      data.stamp_ns = parse_stamp(line, place);
    } else if (word == "robot_name") {
      const std::string_view robot = text::next_word(line);
      data.robot = robot == kNameless ? "" : std::string(robot);
    } else if (word == "id" || word == "g2o_id") {
      Key id = 0;
      if (const char* why = text::parse_id(text::next_word(line), id)) place.fail(std::string("id ") + why);
      data.id = id;
    } else if (std::find(std::begin(kUsed), std::end(kUsed), word) == std::end(kUsed)) {
      const bool known = std::find(std::begin(kUnused), std::end(kUnused), word) != std::end(kUnused);
      problems.add_altered("key frame's " + (known ? std::string(word) : "other data") + " not used",
                           place.str());
    }
  }
  return data;
}

std::optional<KeyFrameFolders> find_key_frame_folders(const fs::path& folder, Problems& problems) {
  KeyFrameFolders found;
  found.files.where = folder.string();
  std::map<Key, std::string> owner;
  for (const fs::path& entry : parts::entries(folder)) {
    const std::string number = entry.filename().string();
    if (!text::has_only_digits(number) || !fs::is_regular_file(entry / "data")) continue;
    const fs::path file = entry / "data";
    const KeyFrameData data = parse_key_frame_data(file.string(), read_file(file), problems);
    if (!data.id) {
      problems.add_altered("key frame without node left out", file.string());
      continue;
    }
    const auto [first, is_new] = owner.emplace(*data.id, number);
    if (!is_new) {
      throw InputError(file.string() + ": id " + std::to_string(*data.id) + " is also the id of " +
                       first->second);
    }
    if (data.stamp_ns) found.stamps.emplace(*data.id, *data.stamp_ns);
    if (!fs::is_regular_file(entry / "cloud.pcd")) continue;
    found.clouds.emplace(*data.id, found.files.names.size());
    found.files.names.push_back(number + "/cloud.pcd");
  }
  if (owner.empty()) return std::nullopt;
  found.files.read = [folder, names = found.files.names](std::size_t n) {
    return read_file(folder / names[n]);
  };
  for (const auto& [id, number] : owner) found.ids.insert(id);
  found.anchors = read_anchors(folder / "special_nodes.csv");
  return found;
}

bool is_mrg_slam(const fs::path& folder) {
  return fs::is_regular_file(folder / "g2o" / "graph.g2o") && fs::is_directory(folder / "keyframes");
}

namespace {

/// Gives the nodes of each robot its character, and indices in the order of their stamps.
void name_nodes(const std::map<std::string, std::vector<std::pair<std::int64_t, Key>>>& by_robot,
                const std::string& where, KeyFrameFolders& found) {
  constexpr std::size_t kLetters = 26;
  if (by_robot.size() > kLetters)
    throw InputError(where + ": " + std::to_string(by_robot.size()) + " robots, at most 26 can be read");
  char letter = 'a';
  for (const auto& [name, nodes] : by_robot) {
    found.robots.push_back(robot_of_character(letter, name.empty() ? std::string(1, letter) : name));
    std::vector<std::pair<std::int64_t, Key>> in_order = nodes;
    std::sort(in_order.begin(), in_order.end());
    for (std::size_t i = 0; i < in_order.size(); ++i) found.full[in_order[i].second] = make_key(letter, i);
    ++letter;
  }
}

}  // namespace

KeyFrameFolders find_team_key_frames(const fs::path& folder, Problems& problems) {
  const fs::path place = folder / "keyframes";
  KeyFrameFolders found;
  found.files.where = place.string();
  std::map<std::string, std::vector<std::pair<std::int64_t, Key>>> by_robot;
  for (const fs::path& file : parts::entries(place)) {
    if (file.extension() != ".txt" || !text::has_only_digits(file.stem().string())) continue;
    const KeyFrameData data = parse_key_frame_data(file.string(), read_file(file), problems);
    if (!data.id) {
      problems.add_altered("key frame without node left out", file.string());
      continue;
    }
    if (!data.stamp_ns)
      throw InputError(file.string() + ": has no stamp, which is needed to order the nodes of a robot");
    if (!found.ids.insert(*data.id).second)
      throw InputError(file.string() + ": g2o_id " + std::to_string(*data.id) +
                       " is also the id of another key frame");
    by_robot[data.robot].emplace_back(*data.stamp_ns, *data.id);
    found.stamps.emplace(*data.id, *data.stamp_ns);
    const std::string cloud = file.stem().string() + ".pcd";
    if (!fs::is_regular_file(place / cloud)) continue;
    found.clouds.emplace(*data.id, found.files.names.size());
    found.files.names.push_back(cloud);
  }
  if (found.ids.empty()) throw InputError(place.string() + ": has no key frame with a node");
  name_nodes(by_robot, place.string(), found);
  found.files.read = [place, names = found.files.names](std::size_t n) {
    return read_file(place / names[n]);
  };
  found.anchors = read_anchors(folder / "g2o" / "special_nodes.csv");
  return found;
}

G2oFile without_anchors(G2oFile file, const KeyFrameFolders& key_frames, const std::string& name) {
  std::set<Key> anchors;
  for (const Key key : file.fixed) {
    const bool named = !key_frames.anchors || key_frames.anchors->count(key) != 0;
    if (named && key_frames.ids.count(key) == 0) anchors.insert(key);
  }
  if (anchors.empty()) return file;
  G2oFile out;
  out.graph.set_planar(file.graph.planar());
  out.problems = std::move(file.problems);
  if (!key_frames.anchors) {
    out.problems.add_altered("fixed node without key frame, treated as an anchor",
                             name + ": " + std::to_string(*anchors.begin()), anchors.size());
  }
  const auto is_anchor = [&](Key key) { return anchors.count(key) != 0; };
  for (const Node& node : file.graph.nodes()) {
    if (!is_anchor(node.key)) out.graph.add_node(node);
  }
  for (const PriorFactor& prior : file.graph.priors()) {
    if (!is_anchor(prior.key)) out.graph.add_prior(prior);
  }
  const std::set<std::size_t> bare(file.without_information.begin(), file.without_information.end());
  for (std::size_t e = 0; e < file.graph.edges().size(); ++e) {
    const Edge& edge = file.graph.edges()[e];
    const std::string where = name + ": " + std::to_string(edge.from) + " to " + std::to_string(edge.to);
    if (is_anchor(edge.from) && is_anchor(edge.to)) {
      out.problems.add_altered("edge between fixed nodes left out", where);
      continue;
    }
    if (!is_anchor(edge.from) && !is_anchor(edge.to)) {
      if (bare.count(e) != 0) out.without_information.push_back(out.graph.edges().size());
      out.graph.add_edge(edge);
      continue;
    }
    const Key anchor = is_anchor(edge.from) ? edge.from : edge.to;
    out.graph.add_prior(prior_of(edge, anchor == edge.from, file.graph.node(anchor).pose));
    out.problems.add("edge to a fixed node without key frame, converted to a prior", where);
  }
  return out;
}

}  // namespace loopwise
