// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Common parts of the pictures from above: the page, its scale, text that is safe in an SVG.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace loopwise::drawing {

inline constexpr double kWidth = 1000.0;  // of the drawing, pixels
inline constexpr double kMargin = 40.0;
/// Okabe and Ito's colours, which readers with any colour vision can distinguish.
inline constexpr std::array<const char*, 6> kRobotColours{"#0072b2", "#d55e00", "#009e73",
                                                          "#cc79a7", "#e69f00", "#56b4e9"};

[[nodiscard]] inline const char* robot_colour(std::size_t robot) {
  // cppcheck-suppress CastIntegerToAddressAtReturn ; the array holds pointers
  return kRobotColours[robot % kRobotColours.size()];
}

/// Maps the world's x and y to the page.
class Page {
 public:
  explicit Page(const std::vector<Eigen::Vector2d>& points) {
    Eigen::AlignedBox2d box;
    for (const Eigen::Vector2d& p : points) box.extend(p);
    if (box.isEmpty()) box.extend(Eigen::Vector2d(0.0, 0.0));
    low_ = box.min();
    const Eigen::Vector2d size = box.sizes().cwiseMax(1.0);
    scale_ = (kWidth - 2.0 * kMargin) / size.maxCoeff();
    height_ = size.y() * scale_ + 2.0 * kMargin;
    top_ = low_.y() + size.y();
  }
  [[nodiscard]] double x(double world) const { return kMargin + (world - low_.x()) * scale_; }
  [[nodiscard]] double y(double world) const { return kMargin + (top_ - world) * scale_; }
  [[nodiscard]] double height() const { return height_; }
  [[nodiscard]] double scale() const { return scale_; }  ///< Pixels per metre.

 private:
  Eigen::Vector2d low_;
  double top_ = 0.0, scale_ = 1.0, height_ = 0.0;
};

/// Appends formatted numbers. Text from outside goes through escaped() and +=, because it may have any
/// length.
template <class... Values>
void put(std::string& out, const char* format, Values... values) {
  std::array<char, 512> text{};
  std::snprintf(text.data(), text.size(), format, values...);
  out += text.data();
}

/// A bar of a round length (1, 2 or 5 times a power of ten), about a fifth of the width, with its label.
inline void put_scale_bar(std::string& out, const Page& page, double y) {
  const double wanted = kWidth / 5.0 / page.scale();
  double bar = std::pow(10.0, std::floor(std::log10(wanted)));
  for (const double factor : {5.0, 2.0}) {
    if (factor * bar <= wanted) {
      bar *= factor;
      break;
    }
  }
  put(out,
      "<path d=\"M%.1f %.1fh%.1f\" stroke=\"black\" stroke-width=\"3\"/><text x=\"%.1f\" y=\"%.1f\">%g "
      "m</text>\n",
      kMargin, y, bar * page.scale(), kMargin + bar * page.scale() + 10.0, y + 5.0, bar);
}

[[nodiscard]] inline std::string escaped(const std::string& text) {
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

}  // namespace loopwise::drawing
