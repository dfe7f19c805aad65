// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/mission_picture.hpp>

#include <algorithm>

#include <loopwise/evaluation/trajectory_errors.hpp>

#include "drawing.hpp"

namespace loopwise {
namespace {

using namespace drawing;

constexpr double kRow = 22.0;  // of the legend

/// One robot's nodes in the order of their keys.
using Path = std::vector<std::pair<Key, Eigen::Vector2d>>;

/// By odometry, or by `known` if it is given.
std::vector<Path> paths(const Mission& mission, const PosesByKey* known) {
  std::vector<Path> result(mission.robots.size());
  for (const Node& node : mission.graph.nodes()) {
    Eigen::Vector2d p = node.pose.translation().head<2>();
    if (known != nullptr) {
      const auto found = known->find(node.key);
      if (found == known->end()) continue;
      p = found->second.translation().head<2>();
    }
    result[mission.robots.of(node.key)].emplace_back(node.key, p);
  }
  for (Path& path : result) {
    std::sort(path.begin(), path.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  }
  return result;
}

void put_path(std::string& out, const Page& page, const Path& path, const char* colour, const char* style) {
  if (path.empty()) return;
  put(out, "<polyline fill=\"none\" stroke=\"%s\" %s points=\"", colour, style);
  for (const auto& [key, p] : path) put(out, "%.1f,%.1f ", page.x(p.x()), page.y(p.y()));
  out += "\"/>\n";
}

bool out_of_range(const Mission& mission, std::size_t robot, Key key) {
  const double time_s = mission.time_s(mission.graph.node(key).stamp_ns);
  return std::any_of(mission.gaps.begin(), mission.gaps.end(), [&](const CommunicationGap& gap) {
    return gap.robot == robot && gap.begin_s <= time_s && time_s < gap.end_s;
  });
}

}  // namespace

std::string mission_picture_svg(const Mission& mission) {
  const std::vector<Path> odometry = paths(mission, nullptr), truth = paths(mission, &mission.ground_truth),
                          reference = paths(mission, &mission.reference);
  std::vector<Eigen::Vector2d> extent;
  for (const auto* all : {&odometry, &truth, &reference}) {
    for (const Path& path : *all) {
      for (const auto& [key, p] : path) extent.push_back(p);
    }
  }
  const Page page(extent);
  const double legend = kRow * (static_cast<double>(mission.robots.size()) + 3.0);

  std::string out;
  put(out,
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %.0f %.0f\" font-family=\"sans-serif\" "
      "font-size=\"14\">\n<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
      kWidth, page.height() + legend);
  if (!mission.name.empty()) out += "<title>" + escaped(mission.name) + "</title>\n";
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    if (mission.robots[robot].landmarks) continue;
    for (const auto& [key, p] : (truth[robot].empty() ? odometry : truth)[robot]) {
      if (!out_of_range(mission, robot, key)) continue;
      put(out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"4\" fill=\"#bbbbbb\"/>\n", page.x(p.x()), page.y(p.y()));
    }
  }
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    if (mission.robots[robot].landmarks) {
      for (const auto& [key, p] : odometry[robot]) {
        put(out, "<path d=\"M%.1f %.1fl5 5l-5 5l-5 -5z\" fill=\"%s\"><title>", page.x(p.x()),
            page.y(p.y()) - 5.0, robot_colour(robot));
        out += key_name(key) + "</title></path>\n";
      }
      continue;
    }
    put_path(out, page, truth[robot], robot_colour(robot), "stroke-width=\"2\"");
    put_path(out, page, reference[robot], robot_colour(robot),
             "stroke-width=\"1.2\" stroke-dasharray=\"1.5 3\"");
    put_path(out, page, odometry[robot], robot_colour(robot),
             "stroke-width=\"1.2\" stroke-dasharray=\"5 4\"");
  }
  for (const PriorFactor& prior : mission.graph.priors()) {
    put(out, "<rect x=\"%.1f\" y=\"%.1f\" width=\"10\" height=\"10\" fill=\"none\" stroke=\"black\"/>\n",
        page.x(prior.pose.translation().x()) - 5.0, page.y(prior.pose.translation().y()) - 5.0);
  }
  for (const BeaconDrop& beacon : mission.beacons) {
    if (!mission.graph.contains(beacon.drop_key)) continue;
    const auto found = mission.ground_truth.find(beacon.drop_key);
    const Eigen::Vector3d p = found != mission.ground_truth.end()
                                  ? found->second.translation()
                                  : mission.graph.node(beacon.drop_key).pose.translation();
    put(out, "<path d=\"M%.1f %.1f l6 11 h-12 z\" fill=\"%s\" stroke=\"black\"><title>", page.x(p.x()),
        page.y(p.y()) - 7.0, robot_colour(beacon.robot));
    out += escaped(beacon.beacon) + "</title></path>\n";
  }

  double y = page.height() + 0.5 * kRow;
  put_scale_bar(out, page, y);
  bool landmarks = false;
  for (std::size_t robot = 0; robot < mission.robots.size(); ++robot) {
    landmarks = landmarks || mission.robots[robot].landmarks;
    y += kRow;
    put(out, "<path d=\"M%.1f %.1fh24\" stroke=\"%s\" stroke-width=\"2\"/>\n<text x=\"%.1f\" y=\"%.1f\">",
        kMargin, y, robot_colour(robot), kMargin + 32.0, y + 5.0);
    out += escaped(mission.robots[robot].name) + "</text>\n";
  }
  put(out, "<text x=\"%.1f\" y=\"%.1f\">", kMargin, y + kRow + 5.0);
  if (!mission.ground_truth.empty()) out += "solid: truth; ";
  if (!mission.reference.empty()) out += "dotted: optimised by another program; ";
  out += "dashed: odometry; triangle: beacon; square: prior; grey: out of range";
  if (landmarks) out += "; diamond: landmark";
  out += "</text>\n</svg>\n";
  return out;
}

}  // namespace loopwise
