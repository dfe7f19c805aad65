// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <unordered_map>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// How likely a candidate becomes a closure once it is computed, learned from what came of others: from those
/// whose nodes were as far apart, and from those between the same two places. Shares of few are drawn towards
/// the wider group, which is the mean of a beta-binomial model: between two places p = (s + a·p_d)/(n + a),
/// with s of n accepted there and p_d that of the distance, itself drawn towards a first guess that falls
/// with it.
class LOOPWISE_EXPORT AcceptanceModel {
 public:
  /// \throws OptionError unless `cell_m`, the size of a place, is finite and > 0.
  explicit AcceptanceModel(double cell_m);

  /// A computed candidate between two positions, which the estimate before had `distance_m` apart.
  void add(double distance_m, const Eigen::Vector3d& from, const Eigen::Vector3d& to, bool accepted);

  /// In (0, 1). Before anything is known 0.5·exp(−distance / 15 m).
  [[nodiscard]] double probability(double distance_m, const Eigen::Vector3d& from,
                                   const Eigen::Vector3d& to) const;

 private:
  struct Share {
    double accepted = 0.0, count = 0.0;
  };
  [[nodiscard]] std::uint64_t places(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;

  double cell_m_;
  std::array<Share, 8> by_distance_{};
  std::unordered_map<std::uint64_t, Share> by_places_;
};

}  // namespace loopwise
