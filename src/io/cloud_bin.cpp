// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "cloud_points.hpp"

namespace loopwise::points {
namespace {

/// Fewer points do not suffice to recognise a layout.
constexpr std::size_t kMinSampled = 20;
constexpr std::size_t kMaxSampled = 2000;
constexpr double kMaxImplausible = 0.05;  // share of the points

Layout layout_of(BinLayout name, const std::string& file) {
  Layout layout;
  const auto put = [&layout](std::initializer_list<const char*> names, Scalar scalar) {
    for (const char* field : names) layout.fields.push_back({field, scalar, 1, 0});
  };
  switch (name) {
    case BinLayout::kXyz:
      put({"x", "y", "z"}, Scalar::kFloat32);
      break;
    case BinLayout::kAuto:
    case BinLayout::kXyzi:
      put({"x", "y", "z", "intensity"}, Scalar::kFloat32);
      break;
    case BinLayout::kXyzir:
      put({"x", "y", "z", "intensity", "ring"}, Scalar::kFloat32);
      break;
    case BinLayout::kXyzirt:
      put({"x", "y", "z", "intensity", "ring", "time"}, Scalar::kFloat32);
      break;
    case BinLayout::kXyzDouble:
      put({"x", "y", "z"}, Scalar::kFloat64);
      break;
    case BinLayout::kXyziDouble:
      put({"x", "y", "z", "intensity"}, Scalar::kFloat64);
      break;
    case BinLayout::kHeliprOuster:
      put({"x", "y", "z", "intensity"}, Scalar::kFloat32);
      put({"t"}, Scalar::kUint32);
      put({"reflectivity", "ring", "ambient"}, Scalar::kUint16);
      break;
    case BinLayout::kHeliprVelodyne:
      put({"x", "y", "z", "intensity"}, Scalar::kFloat32);
      put({"ring"}, Scalar::kUint16);
      put({"time"}, Scalar::kFloat32);
      break;
    case BinLayout::kHeliprAvia:
      put({"x", "y", "z"}, Scalar::kFloat32);
      put({"intensity", "tag", "line"}, Scalar::kUint8);
      put({"t"}, Scalar::kUint32);
      break;
    case BinLayout::kHeliprAeva:
    case BinLayout::kHeliprAevaIntensity:
      put({"x", "y", "z", "reflectivity", "velocity"}, Scalar::kFloat32);
      put({"t"}, Scalar::kInt32);
      put({"line"}, Scalar::kUint8);
      if (name == BinLayout::kHeliprAevaIntensity) put({"intensity"}, Scalar::kFloat32);
      break;
  }
  layout.pack(file);
  return layout;
}

/// Whether a field may have the value. Misread bits give numbers that are far too large or far too small. A
/// level beam of a simulated lidar also gives a small number: its sine is a rounding error, 1e-16 of the
/// range.
bool is_plausible(const std::string& field, double value) {
  constexpr double kTiny = 1e-20, kFarthest_m = 1e7, kBrightest = 1e6, kRings = 1024.0;
  if (std::isnan(value)) return true;  // no echo
  if (value != 0.0 && std::abs(value) < kTiny) return false;
  if (field == "x" || field == "y" || field == "z") return std::abs(value) <= kFarthest_m;
  if (field == "intensity" || field == "reflectivity") return value >= 0.0 && value <= kBrightest;
  if (field == "ring" || field == "line") return value >= 0.0 && value < kRings && value == std::floor(value);
  if (field == "velocity") return std::abs(value) < kRings;
  return std::isfinite(value);
}

struct LayoutFit {
  double implausible = 0.0;  ///< Share of the points with a value that a field cannot have.
  double step_m = 0.0;       ///< Median distance of successive points, small for a true layout.
};

LayoutFit layout_fit(const Layout& layout, std::string_view contents) {
  const std::size_t count = contents.size() / layout.point_size;
  const std::size_t sampled = std::min(count, kMaxSampled);
  const auto value = [&](std::size_t point, const Field& field) {
    return load(field.scalar, contents.data() + point * layout.point_size + field.offset, big_endian_host());
  };
  const auto position = [&](std::size_t point) {
    return Eigen::Vector3d(value(point, layout.fields[0]), value(point, layout.fields[1]),
                           value(point, layout.fields[2]));
  };
  std::size_t implausible = 0;
  std::vector<double> steps;
  for (std::size_t k = 0; k < sampled; ++k) {
    // Random points: a regular stride would always meet the same field of another layout.
    const std::size_t point = sampled == count ? k : static_cast<std::size_t>(mix64(k) % count);
    implausible +=
        std::all_of(layout.fields.begin(), layout.fields.end(),
                    [&](const Field& field) { return is_plausible(field.name, value(point, field)); })
            ? 0
            : 1;
    if (point + 1 == count) continue;
    const double step = (position(point + 1) - position(point)).norm();
    if (std::isfinite(step)) steps.push_back(step);
  }
  LayoutFit fit;
  fit.implausible = sampled == 0 ? 0.0 : static_cast<double>(implausible) / static_cast<double>(sampled);
  fit.step_m = std::numeric_limits<double>::infinity();
  if (!steps.empty()) {
    const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
    std::nth_element(steps.begin(), middle, steps.end());
    fit.step_m = *middle;
  }
  return fit;
}

/// The layout that fits the bytes best and gives the smoothest sweep; kAuto if no layout fits.
BinLayout best_fit(const std::string& file, std::string_view contents) {
  BinLayout best = BinLayout::kAuto;
  double least_m = std::numeric_limits<double>::infinity();
  for (const auto& [name, word] : enum_names(BinLayout::kAuto)) {
    if (name == BinLayout::kAuto) continue;
    const Layout layout = layout_of(name, file);
    if (contents.size() % layout.point_size != 0) continue;
    const LayoutFit fit = layout_fit(layout, contents);
    if (fit.implausible > kMaxImplausible || !(fit.step_m < least_m)) continue;
    best = name;
    least_m = fit.step_m;
  }
  return best;
}

/// Remedy for a file that does not fit xyzi.
std::string advice(const std::string& file, std::string_view contents) {
  const BinLayout best = best_fit(file, contents);
  if (best == BinLayout::kAuto) {
    return "the file is cut short, or its points have another layout: select it with --bin-layout or "
           "mission.bin_layout";
  }
  return "it looks like " + enum_name(best) + " (" + std::to_string(layout_of(best, file).point_size) +
         " bytes a point): read it with --bin-layout " + enum_name(best) + " or mission.bin_layout";
}

std::string percent(double share) {
  return std::to_string(std::lround(100.0 * share)) + " %";
}

}  // namespace

CloudFile read_bin(const std::string& name, std::string_view contents, BinLayout bin_layout) {
  const Layout layout = layout_of(bin_layout, name);
  const bool guessed = bin_layout == BinLayout::kAuto;
  const std::string word = enum_name(guessed ? BinLayout::kXyzi : bin_layout);
  CloudBuilder builder(name, layout.has_normals(), layout.has_intensity());
  if (contents.empty()) builder.add_problem("empty file", name);
  if (contents.size() % layout.point_size != 0) {
    throw InputError(
        name + ": " + std::to_string(contents.size()) + " bytes are not a multiple of the point size of " +
        std::to_string(layout.point_size) + " bytes (" + word +
        "): " + (guessed ? advice(name, contents) : "the file is cut short or has another layout"));
  }
  const std::size_t count = contents.size() / layout.point_size;
  const double implausible = count < kMinSampled ? 0.0 : layout_fit(layout, contents).implausible;
  if (implausible > kMaxImplausible) {
    const std::string why =
        percent(implausible) + " of the points have values that are impossible for x, y, z and intensity";
    if (guessed) throw InputError(name + ": " + why + " (" + word + "): " + advice(name, contents));
    builder.add_problem("points that do not fit the layout", name + ": " + why + " (" + word + ")");
  }
  read_binary(layout, contents, count, true, big_endian_host(), builder);
  return builder.finish();
}

}  // namespace loopwise::points
