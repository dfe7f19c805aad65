// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <map>
#include <mutex>
#include <set>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "cloud_points.hpp"
#include "convert_parts.hpp"
#include "g2o_text.hpp"
#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

std::string six_digits(std::size_t number) {
  const std::string digits = std::to_string(number);
  return std::string(6 - std::min<std::size_t>(6, digits.size()), '0') + digits;
}

/// The key frames of the only robot, by key. \throws InputError if there are several robots
std::vector<Key> frames_of_one_robot(const Mission& mission, const char* program) {
  std::vector<Key> keys = key_frames(mission.graph, mission.robots);
  if (keys.empty()) throw InputError(mission.name + ": has no key frame");
  std::set<std::size_t> robots;
  for (const Key key : keys) robots.insert(mission.robots.of(key));
  if (robots.size() > 1) {
    throw InputError(mission.name + ": has " + std::to_string(robots.size()) + " robots, but a folder of " +
                     program + " holds only one: write it with --to g2o_pcd, or each robot separately");
  }
  return keys;
}

/// Counts parts of a mission that neither program can store.
void count_left_out(const Mission& mission, std::size_t frames, Problems& left_out) {
  count_description(mission, left_out);
  const PoseGraph& graph = mission.graph;
  left_out.add("landmark left out", mission.name, graph.nodes().size() - frames);
  left_out.add("range left out", mission.name, graph.ranges().size());
  left_out.add("gravity left out", mission.name, graph.gravities().size());
  left_out.add("ground truth left out", mission.name, mission.ground_truth.size());
  left_out.add("reference pose left out", mission.name, mission.reference.size());
  left_out.add("key left out", mission.name, frames);
}

/// Rows of a 4×4 matrix.
std::string matrix_text(const Eigen::Isometry3d& T) {
  std::string out;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      if (column > 0) out += ' ';
      text::append(out, T(row, column));
    }
    out += '\n';
  }
  return out;
}

std::string key_frame_text(const Node& node, std::size_t id, double distance_m) {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  std::string out = "stamp " + std::to_string(node.stamp_ns / kSecond_ns) + " " +
                    std::to_string(node.stamp_ns % kSecond_ns) + "\nestimate\n" + matrix_text(node.pose) +
                    "odom\n" + matrix_text(node.pose) + "accum_distance ";
  text::append(out, distance_m);
  return out + "\nid " + std::to_string(id) + "\n";
}

}  // namespace

ConvertResult write_hdl_graph_slam(const Mission& mission, const fs::path& folder,
                                   const ConvertOptions& options) {
  if (mission.graph.planar())
    throw InputError(mission.name + ": has a 2D graph, but hdl_graph_slam reads only 3D graphs");
  ConvertResult result;
  const std::vector<Key> keys = frames_of_one_robot(mission, "hdl_graph_slam");
  count_left_out(mission, keys.size(), result.left_out);
  std::map<Key, Key> id_of;
  for (const Key key : keys) id_of.emplace(key, id_of.size());

  PoseGraph graph;
  double distance_m = 0.0;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    Node node = mission.graph.node(keys[i]);
    if (node.stamp_ns < 0)
      throw InputError(mission.name + ": node " + key_name(node.key) +
                       " has a stamp before 1970, which hdl_graph_slam cannot store");
    if (i > 0) distance_m += (node.pose.translation() - graph.nodes().back().pose.translation()).norm();
    make_folder(folder / six_digits(i));
    write_file(folder / six_digits(i) / "data", key_frame_text(node, i, distance_m));
    node.key = i;
    graph.add_node(node);
  }
  // Priors are edges from a fixed node that is not a key frame.
  Node anchor;
  anchor.key = keys.size();
  const bool anchored = !mission.graph.priors().empty();
  if (anchored) graph.add_node(anchor);
  for (const PriorFactor& prior : mission.graph.priors()) {
    if (const auto id = id_of.find(prior.key); id != id_of.end())
      graph.add_edge({anchor.key, id->second, prior.pose, prior.information});
  }
  for (Edge edge : mission.graph.edges()) {
    if (id_of.count(edge.from) == 0 || id_of.count(edge.to) == 0) {
      result.left_out.add("edge left out", mission.name + ": to a landmark");
      continue;
    }
    edge.from = id_of.at(edge.from);
    edge.to = id_of.at(edge.to);
    graph.add_edge(edge);
  }
  result.scans = write_scans(mission, mission.scans->keys(), options, [&](Key key, const PointCloud& cloud) {
    const auto id = id_of.find(key);
    if (id == id_of.end()) return;
    write_file(folder / six_digits(id->second) / "cloud.pcd", points::pcd_text(cloud, options.encoding),
               Flush::kLater);
  });
  const std::string anchor_id = anchored ? std::to_string(anchor.key) : "-1";
  write_file(folder / "special_nodes.csv",
             "anchor_node " + anchor_id + "\nanchor_edge " + (anchored ? "0" : "-1") + "\nfloor_node -1\n");
  flush_file_system(folder);
  std::string graph_text = g2o_text(graph, {});
  if (anchored) graph_text += "FIX " + anchor_id + "\n";
  write_file(folder / "graph.g2o", graph_text);
  return result;
}

ConvertResult write_hba(const Mission& mission, const fs::path& folder, const ConvertOptions& options) {
  ConvertResult result;
  std::vector<Key> keys = frames_of_one_robot(mission, "HBA");
  count_left_out(mission, keys.size(), result.left_out);
  result.left_out.add("edge left out", mission.name, mission.graph.edges().size());
  result.left_out.add("prior left out", mission.name, mission.graph.priors().size());
  result.left_out.add("stamp left out", mission.name, keys.size());
  if (!mission.scans->empty()) {
    // The program reads a cloud for every pose.
    const auto bare =
        std::stable_partition(keys.begin(), keys.end(), [&](Key key) { return mission.scans->has(key); });
    for (auto key = bare; key != keys.end(); ++key)
      result.left_out.add("node without scan left out", key_name(*key));
    keys.erase(bare, keys.end());
  }
  make_folder(mission.scans->empty() ? folder : folder / "pcd");
  std::map<Key, std::size_t> row_of;
  for (const Key key : keys) row_of.emplace(key, row_of.size());
  std::mutex mutex;
  std::set<Key> written;
  result.scans = write_scans(mission, mission.scans->keys(), options, [&](Key key, const PointCloud& cloud) {
    const auto row = row_of.find(key);
    if (row == row_of.end()) return;
    write_file(folder / "pcd" / (std::to_string(row->second) + ".pcd"),
               points::pcd_text(cloud, options.encoding), Flush::kLater);
    const std::lock_guard<std::mutex> lock(mutex);
    written.insert(key);
  });
  for (const Key key : keys) {
    if (!mission.scans->empty() && written.count(key) == 0)
      result.left_out.add("cloud of a pose left out", key_name(key) + ": its scan cannot be read");
  }
  std::string out;
  for (const Key key : keys) {
    const Eigen::Isometry3d& pose = mission.graph.node(key).pose;
    const Eigen::Quaterniond q = Eigen::Quaterniond(pose.linear()).normalized();
    const Eigen::Vector3d t = pose.translation();
    bool first = true;
    for (const double value : {t.x(), t.y(), t.z(), q.w(), q.x(), q.y(), q.z()}) {
      if (!first) out += ' ';
      text::append(out, value);
      first = false;
    }
    out += '\n';
  }
  flush_file_system(folder);
  write_file(folder / "pose.json", out);
  return result;
}

}  // namespace loopwise::parts
