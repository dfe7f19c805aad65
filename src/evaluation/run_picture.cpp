// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/run_picture.hpp>

#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "drawing.hpp"

namespace loopwise {
namespace {

using namespace drawing;

constexpr double kLegend = 90.0;
constexpr const char* kReference = "stroke=\"#555\" stroke-width=\"1.5\" stroke-dasharray=\"1.5 3\"";

void put_path(std::string& out, const Page& page, const std::map<Key, Eigen::Vector2d>& path,
              const char* style) {
  if (path.empty()) return;
  out += "<polyline fill=\"none\" ";
  out += style;
  out += " points=\"";
  for (const auto& [key, p] : path) put(out, "%.1f,%.1f ", page.x(p.x()), page.y(p.y()));
  out += "\"/>\n";
}

/// One point per cell of a few pixels, lowest index first.
std::vector<Eigen::Vector2d> thinned(const PointCloud& map, const Page& page) {
  constexpr double kCell = 2.0;
  std::set<std::pair<int, int>> seen;
  std::vector<Eigen::Vector2d> points;
  for (const Eigen::Vector3f& p : map.points) {
    const Eigen::Vector2d at = map.origin.head<2>() + p.head<2>().cast<double>();
    const std::pair<int, int> cell{static_cast<int>(page.x(at.x()) / kCell),
                                   static_cast<int>(page.y(at.y()) / kCell)};
    if (seen.insert(cell).second) points.push_back(at);
  }
  constexpr std::size_t kMost = 12000;
  if (points.size() <= kMost) return points;
  std::vector<Eigen::Vector2d> some;
  for (std::size_t i = 0; i < kMost; ++i) some.push_back(points[i * points.size() / kMost]);
  return some;
}

using Paths = std::vector<std::map<Key, Eigen::Vector2d>>;  // by robot

/// The poses of the picture, seen from above.
struct Ways {
  Paths optimized, odometry, truth, reference;
  std::vector<Eigen::Vector2d> extent;  ///< Bounds of the robots' paths and the map.
};

Ways ways_of(const Mission& mission, const ReplayResult& result, const PointCloud& map) {
  const std::vector<Node>& nodes = result.graph.nodes();
  const std::size_t robots = mission.robots.size();
  Ways ways{Paths(robots), Paths(robots), Paths(robots), Paths(robots), {}};
  const auto flat = [](const Eigen::Isometry3d& pose) {
    return Eigen::Vector2d(pose.translation().head<2>());
  };
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Key key = nodes[i].key;
    const std::size_t robot = mission.robots.of(key);
    ways.extent.push_back(ways.optimized[robot][key] = flat(nodes[i].pose));
    ways.extent.push_back(ways.odometry[robot][key] = flat(result.odometry[i]));
    if (const auto known = mission.ground_truth.find(key); known != mission.ground_truth.end()) {
      ways.truth[robot][key] = flat(known->second);
    }
    if (const auto known = mission.reference.find(key); known != mission.reference.end()) {
      ways.reference[robot][key] = flat(known->second);
    }
  }
  // The middle 99 % of the map, so that a few far points do not shrink the rest.
  for (const int axis : {0, 1}) {
    std::vector<float> values;
    for (const Eigen::Vector3f& p : map.points) values.push_back(p[axis]);
    if (values.empty()) break;
    std::sort(values.begin(), values.end());
    for (const double share : {0.005, 0.995}) {
      const auto place = static_cast<std::size_t>(share * static_cast<double>(values.size() - 1));
      Eigen::Vector2d corner = ways.extent.empty() ? Eigen::Vector2d::Zero() : ways.extent.front();
      corner[axis] = map.origin[axis] + static_cast<double>(values[place]);
      ways.extent.push_back(corner);
    }
  }
  return ways;
}

void put_map(std::string& out, const Page& page, const PointCloud& map) {
  out +=
      "<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n<path stroke=\"#9aa3ab\" stroke-width=\"1.6\" "
      "stroke-linecap=\"round\" d=\"";
  for (const Eigen::Vector2d& p : thinned(map, page)) {
    const double x = page.x(p.x()), y = page.y(p.y());
    if (x >= 0.0 && x <= kWidth && y >= 0.0 && y <= page.height()) put(out, "M%.1f %.1fh0", x, y);
  }
  out += "\"/>\n";
}

void put_closures(std::string& out, const Page& page, const ReplayResult& result) {
  for (const ComputedCandidate& computed : result.computed) {
    if (!computed.result.verified()) continue;
    const Eigen::Vector3d a = result.graph.node(computed.result.candidate.from).pose.translation();
    const Eigen::Vector3d b = result.graph.node(computed.result.candidate.to).pose.translation();
    put(out,
        "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\" stroke-width=\"1\" "
        "opacity=\"0.5\"/>\n",
        page.x(a.x()), page.y(a.y()), page.x(b.x()), page.y(b.y()),
        computed.weight > 0.5 ? "#35a35f" : "#d1342f");
  }
}

void put_ways(std::string& out, const Page& page, const Ways& ways) {
  for (std::size_t robot = 0; robot < ways.optimized.size(); ++robot) {
    const char* colour = robot_colour(robot);
    std::string style;
    put(style, "stroke=\"%s\" stroke-width=\"1.2\" stroke-dasharray=\"5 4\" opacity=\"0.8\"", colour);
    put_path(out, page, ways.odometry[robot], style.c_str());
    put_path(out, page, ways.reference[robot], kReference);
    put_path(out, page, ways.truth[robot], "stroke=\"black\" stroke-width=\"4\" opacity=\"0.25\"");
    style.clear();
    put(style, "stroke=\"%s\" stroke-width=\"2\"", colour);
    put_path(out, page, ways.optimized[robot], style.c_str());
  }
}

void put_legend(std::string& out, const Page& page, const Mission& mission) {
  const double y = page.height() + 10.0;
  double x = kMargin;
  const auto entry = [&](const char* line_style, const std::string& label) {
    put(out, "<line x1=\"%.0f\" y1=\"%.0f\" x2=\"%.0f\" y2=\"%.0f\" ", x, y, x + 36.0, y);
    out += line_style;
    put(out, "/>\n<text x=\"%.0f\" y=\"%.0f\">", x + 44.0, y + 5.0);
    out += escaped(label) + "</text>\n";
    x += 64.0 + 9.0 * static_cast<double>(label.size());
  };
  for (std::size_t robot = 0; robot < std::min<std::size_t>(mission.robots.size(), kRobotColours.size());
       ++robot) {
    std::string style;
    put(style, "stroke=\"%s\" stroke-width=\"3\"", kRobotColours[robot]);
    entry(style.c_str(), mission.robots[robot].name);
  }
  entry("stroke=\"#555\" stroke-width=\"1.5\" stroke-dasharray=\"5 4\"", "odometry");
  if (!mission.ground_truth.empty()) entry("stroke=\"black\" stroke-width=\"5\" opacity=\"0.25\"", "truth");
  if (!mission.reference.empty()) entry(kReference, "optimised by another program");
  entry("stroke=\"#35a35f\" stroke-width=\"2\"", "closure");
  entry("stroke=\"#d1342f\" stroke-width=\"2\"", "left out");
  put_scale_bar(out, page, y + 40.0);
}

}  // namespace

std::string run_picture_svg(const Mission& mission, const ReplayResult& result, const PointCloud& map) {
  const Ways ways = ways_of(mission, result, map);
  const Page page(ways.extent);
  std::string out;
  put(out,
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %.0f %.0f\" font-family=\"sans-serif\" "
      "font-size=\"16\">\n",
      kWidth, page.height() + kLegend);
  put_map(out, page, map);
  put_closures(out, page, result);
  put_ways(out, page, ways);
  put_legend(out, page, mission);
  out += "</svg>\n";
  return out;
}

}  // namespace loopwise
