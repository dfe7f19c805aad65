// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/simulation/map_svg.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <ostream>
#include <string>

namespace loopwise {
namespace {

constexpr double kWidth = 1000.0;  ///< Of the drawing, user units.
constexpr double kMargin = 40.0;

/// Okabe and Ito's colours, which readers with any colour vision tell apart.
constexpr std::array<const char*, 7> kColours{"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                              "#e69f00", "#56b4e9", "#000000"};

std::string number(double x) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%.1f", x);
  return text.data();
}

std::string escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      default:
        out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
  return out;
}

struct Frame {
  double low_x = std::numeric_limits<double>::infinity(), low_y = low_x;
  double high_x = -low_x, high_y = -low_x;
  double scale = 1.0;

  void include(const Eigen::Vector3d& p) {
    low_x = std::min(low_x, p.x());
    high_x = std::max(high_x, p.x());
    low_y = std::min(low_y, p.y());
    high_y = std::max(high_y, p.y());
  }
  [[nodiscard]] std::string at(const Eigen::Vector3d& p) const {
    return number(kMargin + (p.x() - low_x) * scale) + "," + number(kMargin + (high_y - p.y()) * scale);
  }
  [[nodiscard]] double x(const Eigen::Vector3d& p) const { return kMargin + (p.x() - low_x) * scale; }
  [[nodiscard]] double y(const Eigen::Vector3d& p) const { return kMargin + (high_y - p.y()) * scale; }
};

/// 1, 2 or 5 times a power of ten, at most `x`.
double round_length(double x) {
  const double power = std::pow(10.0, std::floor(std::log10(x)));
  for (const double factor : {5.0, 2.0}) {
    if (factor * power <= x) return factor * power;
  }
  return power;
}

}  // namespace

void write_map_svg(std::ostream& out, const Mission& mission) {
  Frame frame;
  for (const Node& node : mission.graph.nodes()) frame.include(node.pose.translation());
  for (const auto& [key, pose] : mission.ground_truth) frame.include(pose.translation());
  if (!std::isfinite(frame.low_x)) frame.include(Eigen::Vector3d::Zero());
  const double extent = std::max({frame.high_x - frame.low_x, frame.high_y - frame.low_y, 1.0});
  frame.scale = (kWidth - 2.0 * kMargin) / extent;
  const double width = 2.0 * kMargin + std::max(320.0, (frame.high_x - frame.low_x) * frame.scale);
  const double legend = 22.0 * (static_cast<double>(mission.robots.size()) + 3.0);
  const double height = 2.0 * kMargin + (frame.high_y - frame.low_y) * frame.scale + legend;

  out << "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" << number(width) << "\" height=\""
      << number(height) << "\" viewBox=\"0 0 " << number(width) << " " << number(height)
      << "\" font-family=\"sans-serif\" font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" "
         "fill=\"white\"/>\n";
  if (!mission.name.empty()) out << "<title>" << escaped(mission.name) << "</title>\n";

  const auto colour = [](std::size_t robot) { return kColours[robot % kColours.size()]; };
  const auto is_out = [&mission](std::size_t robot, double time_s) {
    return std::any_of(mission.gaps.begin(), mission.gaps.end(), [&](const CommunicationGap& gap) {
      return gap.robot == robot && gap.begin_s <= time_s && time_s < gap.end_s;
    });
  };
  for (const bool truth : {true, false}) {
    for (std::size_t r = 0; r < mission.robots.size(); ++r) {
      std::string points, marks;
      for (const Node& node : mission.graph.nodes()) {
        if (mission.robots.of(node.key) != r) continue;
        Eigen::Vector3d p = node.pose.translation();
        if (truth) {
          const auto found = mission.ground_truth.find(node.key);
          if (found == mission.ground_truth.end()) continue;
          p = found->second.translation();
          if (is_out(r, mission.time_s(node.stamp_ns))) {
            marks += "<circle cx=\"" + number(frame.x(p)) + "\" cy=\"" + number(frame.y(p)) +
                     "\" r=\"3\" fill=\"#999999\"/>\n";
          }
        }
        points += (points.empty() ? "" : " ") + frame.at(p);
      }
      if (points.empty()) continue;
      out << marks << "<polyline fill=\"none\" stroke=\"" << colour(r) << "\" points=\"" << points << "\" "
          << (truth ? "stroke-width=\"2\"" : "stroke-width=\"1\" stroke-dasharray=\"5 3\" opacity=\"0.8\"")
          << "/>\n";
    }
  }
  for (const PriorFactor& prior : mission.graph.priors()) {
    const Eigen::Vector3d p = prior.pose.translation();
    out << "<rect x=\"" << number(frame.x(p) - 5.0) << "\" y=\"" << number(frame.y(p) - 5.0)
        << "\" width=\"10\" height=\"10\" fill=\"none\" stroke=\"black\"/>\n";
  }
  for (const BeaconDrop& beacon : mission.beacons) {
    if (!mission.graph.contains(beacon.drop_key)) continue;
    const auto found = mission.ground_truth.find(beacon.drop_key);
    const Eigen::Vector3d p = found != mission.ground_truth.end()
                                  ? found->second.translation()
                                  : mission.graph.node(beacon.drop_key).pose.translation();
    const double x = frame.x(p), y = frame.y(p);
    out << "<path d=\"M" << number(x) << " " << number(y - 7.0) << " l6 11 h-12 z\" fill=\""
        << colour(beacon.robot) << "\" stroke=\"black\"><title>" << escaped(beacon.beacon)
        << "</title></path>\n";
  }

  double y = height - legend;
  const double bar = round_length(0.3 * extent);
  out << "<path d=\"M" << number(kMargin) << " " << number(y) << " h" << number(bar * frame.scale)
      << "\" stroke=\"black\" stroke-width=\"3\"/>\n<text x=\"" << number(kMargin + bar * frame.scale + 8.0)
      << "\" y=\"" << number(y + 5.0) << "\">" << bar << " m</text>\n";
  for (std::size_t r = 0; r < mission.robots.size(); ++r) {
    y += 22.0;
    out << "<path d=\"M" << number(kMargin) << " " << number(y) << " h24\" stroke=\"" << colour(r)
        << "\" stroke-width=\"2\"/>\n<text x=\"" << number(kMargin + 32.0) << "\" y=\"" << number(y + 5.0)
        << "\">" << escaped(mission.robots[r].name) << "</text>\n";
  }
  y += 22.0;
  out << "<text x=\"" << number(kMargin) << "\" y=\"" << number(y + 5.0)
      << "\">solid: truth; dashed: odometry; triangle: beacon; square: start; grey: out of "
         "range</text>\n</svg>\n";
}

}  // namespace loopwise
