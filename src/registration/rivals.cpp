// SPDX-License-Identifier: BSD-3-Clause
#include "rivals.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>

#include <loopwise/core/se3.hpp>

#include "../core/constants.hpp"
#include "sort_falling.hpp"

namespace loopwise {
namespace {

constexpr std::size_t kPoints = 200;  // of each side; their pairs vote
constexpr int kCompassBins = 120;     // of the compass, 3 degrees each

/// Surface points about a common centre, with the vertical as z.
struct Elements {
  std::vector<Eigen::Vector3f> points, normals;
};

Elements draw(const Side& side, const Eigen::Isometry3d& T) {
  const PointCloud& cloud = side.submap.cloud();
  const Eigen::Matrix3f R = T.linear().cast<float>();
  Elements out;
  for (std::size_t k = 0; k < std::min(kPoints, side.order.size()); ++k) {
    out.points.push_back((T * cloud.points[side.order[k]].cast<double>()).cast<float>());
    out.normals.push_back(R * cloud.normals[side.order[k]]);
  }
  return out;
}

/// The mean normal of floors and ceilings, which face up or down within 30 degrees of z; z if there are no
/// such surfaces.
Eigen::Vector3d vertical_of(const Side& side) {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (const std::uint32_t i : side.order) {
    const Eigen::Vector3f& n = side.submap.cloud().normals[i];
    if (std::abs(n.z()) > 0.866F) sum += n.z() > 0.0F ? n : Eigen::Vector3f(-n);
  }
  return sum.isZero() ? Eigen::Vector3d::UnitZ() : sum.cast<double>().normalized();
}

/// Number of steep surfaces that face each direction of the compass, smoothed over three bins.
using Compass = std::array<float, kCompassBins>;

Compass compass(const Elements& elements) {
  Compass counts{}, smooth{};
  for (const Eigen::Vector3f& n : elements.normals) {
    if (std::abs(n.z()) > 0.7F) continue;
    const float turn = std::atan2(n.y(), n.x()) / (2.0F * kPiFloat) + 1.0F;
    counts[static_cast<std::size_t>(turn * kCompassBins) % kCompassBins] += 1.0F;
  }
  for (std::size_t i = 0; i < kCompassBins; ++i) {
    smooth[i] =
        counts[i] + 0.5F * (counts[(i + 1) % kCompassBins] + counts[(i + kCompassBins - 1) % kCompassBins]);
  }
  return smooth;
}

struct Turn {
  Eigen::Matrix3f R = Eigen::Matrix3f::Identity();
  float agreement = 0.0F;
};

/// Adds turns about the vertical, or half turns about a level axis, that align the surface directions of both
/// sides: the highest peaks of the correlation.
void add_turns(const Compass& source, const Compass& target, bool half_turns, std::size_t most,
               std::vector<Turn>& turns) {
  float own = 0.0F;  // at the found pose
  for (std::size_t i = 0; i < kCompassBins; ++i) own += source[i] * target[i];
  std::array<float, kCompassBins> correlation{};
  for (std::size_t shift = 0; shift < kCompassBins; ++shift) {
    for (std::size_t i = 0; i < kCompassBins; ++i) {
      // A half turn about the axis at azimuth ψ/2 carries azimuth α to ψ − α.
      const std::size_t from = half_turns ? (2 * kCompassBins - 1 - i) % kCompassBins : i;
      correlation[shift] += source[from] * target[(i + shift) % kCompassBins];
    }
  }
  std::vector<Turn> found;
  for (std::size_t shift = 0; shift < kCompassBins; ++shift) {
    const float here = correlation[shift];
    if (2.0F * here < own) continue;
    if (shift == 0 && !half_turns) continue;  // the turn of the found pose, which is always used
    if (here < correlation[(shift + 1) % kCompassBins] ||
        here <= correlation[(shift + kCompassBins - 1) % kCompassBins])
      continue;
    const float angle = 2.0F * kPiFloat * static_cast<float>(shift) / kCompassBins;
    Turn turn;
    turn.agreement = here;
    turn.R = Eigen::AngleAxisf(angle, Eigen::Vector3f::UnitZ()).toRotationMatrix();
    if (half_turns) turn.R = turn.R * Eigen::Vector3f(1.0F, -1.0F, -1.0F).asDiagonal();
    found.push_back(turn);
  }
  sort_falling(found, [](const Turn& turn) { return turn.agreement; });
  if (found.size() > most) found.resize(most);
  turns.insert(turns.end(), found.begin(), found.end());
}

/// Votes for translations on a grid.
class Votes {
 public:
  void add(const Eigen::Vector3f& t) {
    const Eigen::Vector3f at = t / kCellM + middle();
    if (!(at.minCoeff() >= 0.0F) || std::max(at.x(), at.y()) >= kAcross || at.z() >= kUp) return;
    ++(*cells_)[index(static_cast<std::size_t>(at.x()), static_cast<std::size_t>(at.y()),
                      static_cast<std::size_t>(at.z()))];
  }
  struct Peak {
    Eigen::Vector3f t = Eigen::Vector3f::Zero();
    std::uint32_t count = 0;
  };
  /// The cubes of two by two by two cells with the most votes, at least two cells apart. Empties the cells.
  [[nodiscard]] std::vector<Peak> take_peaks(std::size_t most) {
    // Sums over cubes, by adding the next cell along each axis in turn.
    Cells& sums = *cells_;
    for (const std::size_t step : {std::size_t{1}, index(0, 1, 0), index(0, 0, 1)}) {
      for (std::size_t i = 0; i + step < kCells; ++i) {
        sums[i] = static_cast<std::uint16_t>(sums[i] + sums[i + step]);
      }
    }
    std::array<std::uint16_t, kCells / kAcross> rows{};  // the fullest of each row along x
    for (std::size_t row = 0; row < rows.size(); ++row) {
      std::uint16_t fullest = 0;
      for (std::size_t x = 0; x < kAcross; ++x) fullest = std::max(fullest, sums[row * kAcross + x]);
      rows[row] = fullest;
    }
    const std::uint32_t largest = *std::max_element(rows.begin(), rows.end());
    const std::uint32_t least = std::max(4U, (largest + 2) / 3);
    std::vector<Peak> all;
    for (std::size_t row = 0; row < rows.size(); ++row) {
      if (rows[row] < least) continue;
      for (std::size_t x = 0; x < kAcross; ++x) {
        const std::uint32_t sum = sums[row * kAcross + x];
        if (sum < least) continue;
        const Eigen::Vector3f corner(static_cast<float>(x + 1), static_cast<float>(row % kAcross + 1),
                                     static_cast<float>(row / kAcross + 1));
        all.push_back({kCellM * (corner - middle()), sum});
      }
    }
    sums.fill(0);
    sort_falling(all, [](const Peak& peak) { return peak.count; });
    std::vector<Peak> chosen;
    for (const Peak& peak : all) {
      if (chosen.size() == most) break;
      const auto near = [&](const Peak& other) {
        return (other.t - peak.t).cwiseAbs().maxCoeff() < 2 * kCellM;
      };
      if (std::none_of(chosen.begin(), chosen.end(), near)) chosen.push_back(peak);
    }
    return chosen;
  }

 private:
  static constexpr std::size_t kAcross = 64, kUp = 16, kCells = kAcross * kAcross * kUp;
  static constexpr float kCellM = 0.75F;
  using Cells = std::array<std::uint16_t, kCells>;
  static constexpr std::size_t index(std::size_t x, std::size_t y, std::size_t z) {
    return (z * kAcross + y) * kAcross + x;
  }
  static Eigen::Vector3f middle() { return {kAcross / 2, kAcross / 2, kUp / 2}; }
  std::unique_ptr<Cells> cells_ = std::make_unique<Cells>();
};

}  // namespace

std::vector<Eigen::Isometry3d> find_rivals(const Side& source, const Side& target,
                                           const Eigen::Isometry3d& found, double max_turn_rad,
                                           std::size_t peaks,
                                           const std::function<bool(const Eigen::Isometry3d&)>& allowed) {
  Eigen::Isometry3d T_level_target = Eigen::Isometry3d::Identity();
  T_level_target.linear() =
      Eigen::Quaterniond::FromTwoVectors(vertical_of(target), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T_level_target.translation() = -(T_level_target.linear() * (found * source.centre));
  const Elements from = draw(source, T_level_target * found), to = draw(target, T_level_target);

  std::vector<Turn> turns(1);
  const Compass from_compass = compass(from), to_compass = compass(to);
  add_turns(from_compass, to_compass, false, 6, turns);
  if (max_turn_rad > kPi - 0.01) add_turns(from_compass, to_compass, true, 4, turns);

  struct Candidate {
    Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
    std::uint32_t votes = 0;
  };
  std::vector<Candidate> candidates;
  Votes votes;
  for (const Turn& turn : turns) {
    if (Eigen::AngleAxisf(turn.R).angle() > static_cast<float>(max_turn_rad)) continue;
    for (std::size_t i = 0; i < from.points.size(); ++i) {
      const Eigen::Vector3f p = turn.R * from.points[i], n = turn.R * from.normals[i];
      for (std::size_t j = 0; j < to.points.size(); ++j) {
        if (n.dot(to.normals[j]) > 0.95F) votes.add(to.points[j] - p);
      }
    }
    for (const Votes::Peak& peak : votes.take_peaks(peaks)) {
      Eigen::Isometry3d moved = Eigen::Isometry3d::Identity();
      moved.linear() = turn.R.cast<double>();
      moved.translation() = peak.t.cast<double>();
      const Eigen::Isometry3d T = T_level_target.inverse() * moved * T_level_target * found;
      const bool same = peak.t.norm() < 1.5F && se3::rotation_angle(moved) < 0.1;
      if (!same && allowed(T)) candidates.push_back({T, peak.count});
    }
  }
  sort_falling(candidates, [](const Candidate& candidate) { return candidate.votes; });
  std::vector<Eigen::Isometry3d> rivals;
  for (const Candidate& candidate : candidates) rivals.push_back(candidate.T_target_source);
  return rivals;
}

}  // namespace loopwise
