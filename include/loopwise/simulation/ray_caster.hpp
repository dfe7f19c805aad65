// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <optional>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/simulation/world.hpp>

namespace loopwise {

/// First intersection of a ray with the mesh.
struct RayHit {
  float distance_m;        ///< From the ray's origin, m.
  Eigen::Vector3f normal;  ///< Unit length, towards the ray's origin.
};

/// Rays against a mesh, by Embree with a fixed instruction set and in its robust mode, so that the hits do
/// not depend on the processor. Thread-safe. Takes a copy of the mesh.
class LOOPWISE_EXPORT RayCaster {
 public:
  /// \throws Error if Embree cannot build the scene.
  explicit RayCaster(const TriangleMesh& mesh);
  ~RayCaster();
  RayCaster(const RayCaster&) = delete;
  RayCaster& operator=(const RayCaster&) = delete;

  /// `direction` is of unit length. \returns empty if there is no surface within `max_distance_m`.
  [[nodiscard]] std::optional<RayHit> cast(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction,
                                           float max_distance_m) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace loopwise
