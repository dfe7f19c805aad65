// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/acceptance.hpp>

#include <algorithm>
#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "cell.hpp"

namespace loopwise {
namespace {

constexpr std::array<double, 7> kDistances_m{2.5,  5.0,  7.5, 10.0,
                                             15.0, 20.0, 30.0};  // upper ends of the bins
constexpr double kDistanceStrength = 10.0;  // computed candidates that the guess by distance stands for
constexpr double kPlacesStrength = 4.0;     // and that by a bin of distance
constexpr double kReach_m = 15.0;           // scale of the first guess: lidar scans overlap less far apart

std::size_t bin_of(double distance_m) {
  return static_cast<std::size_t>(std::upper_bound(kDistances_m.begin(), kDistances_m.end(), distance_m) -
                                  kDistances_m.begin());
}

/// Before anything is known.
double first_guess(std::size_t bin) {
  const double middle = bin == 0                     ? 0.5 * kDistances_m[0]
                        : bin == kDistances_m.size() ? 1.5 * kDistances_m.back()
                                                     : 0.5 * (kDistances_m[bin - 1] + kDistances_m[bin]);
  return 0.5 * std::exp(-middle / kReach_m);
}

}  // namespace

AcceptanceModel::AcceptanceModel(double cell_m) : cell_m_(cell_m) {
  if (!(cell_m > 0.0) || !std::isfinite(cell_m)) throw OptionError("cell_m must be finite and > 0");
}

void AcceptanceModel::add(double distance_m, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                          bool accepted) {
  for (Share* share : {&by_distance_[bin_of(distance_m)], &by_places_[places(from, to)]}) {
    share->count += 1.0;
    share->accepted += accepted ? 1.0 : 0.0;
  }
}

double AcceptanceModel::probability(double distance_m, const Eigen::Vector3d& from,
                                    const Eigen::Vector3d& to) const {
  const std::size_t bin = bin_of(distance_m);
  const Share& distance = by_distance_[bin];
  double p =
      (distance.accepted + kDistanceStrength * first_guess(bin)) / (distance.count + kDistanceStrength);
  const auto here = by_places_.find(places(from, to));
  if (here != by_places_.end()) {
    p = (here->second.accepted + kPlacesStrength * p) / (here->second.count + kPlacesStrength);
  }
  return p;
}

/// The same whichever of the two is named first.
std::uint64_t AcceptanceModel::places(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  const std::uint64_t a = detail::cell_of(from, cell_m_), b = detail::cell_of(to, cell_m_);
  return combine_seeds(std::min(a, b), std::max(a, b));
}

}  // namespace loopwise
