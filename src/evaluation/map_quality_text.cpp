// SPDX-License-Identifier: BSD-3-Clause
#include <string>

#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/evaluation/text_tables.hpp>

namespace loopwise {
namespace {

/// Formats a number; a rounded zero has no sign.
std::string signed_text(double value, int digits) {
  const std::string text = fixed(value, digits);
  const bool is_zero = text.find_first_not_of("-0.") == std::string::npos;
  return is_zero ? fixed(0.0, digits) : text;
}

std::string line_of(const char* what, const Displacement& d) {
  return std::string(what) + fixed(d.mean_m, 3) + " m in the mean, median " + fixed(d.median_m, 3) +
         ", worst tenth above " + fixed(d.worst_tenth_m, 3) + "\n";
}

/// Mean and, if it is known, the interval of a difference.
std::string difference_text(bool enough, const PairedComparison& difference) {
  std::string text = signed_text(difference.mean_difference, 3) + " m";
  if (enough) {
    text += ", 95 % interval " + signed_text(difference.difference.low, 3) + " to " +
            signed_text(difference.difference.high, 3);
  }
  return text;
}

std::string near_text(const MapQuality& q) {
  if (q.near.pairs == 0) return "";
  const auto near = [](const NearPairs& n) {
    return std::to_string(n.proven) + " of " + std::to_string(n.pairs) +
           (n.proven > 0 ? ", " + fixed(n.median_m, 3) + " m off in the median" : "");
  };
  return "near         pairs that the estimate alone puts within 3 m and that are proven: " + near(q.near) +
         (q.near_between_robots.pairs > 0 ? "; of two robots " + near(q.near_between_robots) : "") + "\n";
}

}  // namespace

std::string map_quality_text(const MapQuality& q) {
  if (q.revisits.empty()) return "not meaningful: " + q.not_meaningful() + "\n" + near_text(q);
  std::string text = "revisits     " + std::to_string(q.revisits.size()) + " of " + std::to_string(q.pairs) +
                     " pairs of nodes, proven by registration, at " + std::to_string(q.stretches) +
                     " pairs of stretches of path, on " + fixed(100.0 * q.coverage, 0) +
                     " % of the path\ndisplacement of the poses from the registrations:\n";
  text += line_of("  recording  ", q.before) + line_of("  estimate   ", q.after);
  text += "difference   " + difference_text(q.enough(), q.difference) + "\n";
  if (q.planes == 0) {
    text += "thickness    not known: no plane has enough points of both scans\n";
  } else {
    text += "thickness    of surfaces that both scans saw (" + std::to_string(q.planes) +
            " planes): " + fixed(q.thickness_before.mean_m, 3) + " m by the recording, " +
            fixed(q.thickness_after.mean_m, 3) + " m by the estimate, " +
            fixed(q.thickness_registered.mean_m, 3) + " m by the registrations; difference " +
            difference_text(q.enough_planes(), q.thickness_difference) + "\n";
  }
  text += "on surfaces  " + fixed(100.0 * q.share_before, 1) +
          " % of points within 0.12 m of the other scan by the recording's poses, " +
          fixed(100.0 * q.share_after, 1) + " % by the estimate's; " + fixed(100.0 * q.share_registered, 1) +
          " % by the registrations, an upper bound\n";
  return text + near_text(q);
}

std::string map_quality_warning(const MapQuality& q) {
  // In a correct map most pairs are proven, with a median distance of centimetres.
  constexpr std::size_t kSome = 10;
  constexpr double kFewProven = 0.2, kFar_m = 1.0;
  const auto is_wrong = [](const NearPairs& near) {
    const bool few = static_cast<double>(near.proven) < kFewProven * static_cast<double>(near.pairs);
    return near.pairs >= kSome && (few || near.median_m > kFar_m);
  };
  if (is_wrong(q.near_between_robots)) {
    return "registrations contradict the estimate at places that several robots visit: the frames of the "
           "robots may be wrong";
  }
  if (is_wrong(q.near)) {
    return "registrations contradict the estimate at places that are visited twice: its poses may be wrong";
  }
  return {};
}

}  // namespace loopwise
