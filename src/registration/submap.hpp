// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// A scan that takes part in a registration.
struct Part {
  Key key = 0;
  Eigen::Isometry3d T_center_part = Eigen::Isometry3d::Identity();
  std::shared_ptr<const ScanFeatures> features;
};

/// One side of a registration: its scans, and their union in the centre's frame.
class LOOPWISE_EXPORT Submap {
 public:
  /// Loads the features of the members, in order, until there are `enough_points` points (0: all members).
  /// Returns nothing if the first member, which is the node itself, is missing; `result` then has the reason.
  /// Other members that cannot be read are left out, see incomplete().
  [[nodiscard]] static std::optional<Submap> load(FeatureCache& cache,
                                                  const std::vector<SubmapMember>& members,
                                                  std::size_t enough_points, RegistrationResult& result);

  /// Whether a requested member is left out.
  [[nodiscard]] bool incomplete() const { return incomplete_; }
  [[nodiscard]] const std::vector<Part>& parts() const { return parts_; }
  /// Points and normals of all parts, part by part, in the centre's frame.
  [[nodiscard]] const PointCloud& cloud() const {
    return union_ ? union_->cloud : parts_.front().features->cloud;
  }
  /// Size of all data that the submap keeps alive.
  [[nodiscard]] std::size_t bytes() const {
    std::size_t sum = union_ ? union_->cloud.bytes() + union_->tree.bytes() : 0;
    for (const Part& part : parts_) sum += part.features->bytes();
    return sum;
  }
  [[nodiscard]] const KdTree& tree() const { return union_ ? union_->tree : parts_.front().features->tree; }

 private:
  struct Union {
    PointCloud cloud;
    KdTree tree;
  };
  bool incomplete_ = false;
  std::vector<Part> parts_;
  std::shared_ptr<const Union>
      union_;  // null for a single part at the centre, whose cached scan is used directly
};

}  // namespace loopwise
