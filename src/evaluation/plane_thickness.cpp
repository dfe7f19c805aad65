// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/plane_thickness.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <utility>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr double kCell_m = 1.0;
constexpr std::size_t kLeastPoints = 4;  // of each scan
/// A cell is flat if its points scatter this much less along the normal than along any direction across it.
constexpr double kFlat = 0.3;

using Cell = std::array<std::int64_t, 3>;
using Points = std::vector<Eigen::Vector3d>;

Cell cell_of(const Eigen::Vector3d& p) {
  Cell cell{};
  for (int axis = 0; axis < 3; ++axis)
    cell[static_cast<std::size_t>(axis)] = static_cast<std::int64_t>(std::floor(p[axis] / kCell_m));
  return cell;
}

SurfacePoints moments_of(const Points& points) {
  SurfacePoints moments;
  const auto count = static_cast<double>(points.size());
  for (const Eigen::Vector3d& p : points) moments.mean += p / count;
  for (const Eigen::Vector3d& p : points) {
    const Eigen::Vector3d d = p - moments.mean;
    moments.covariance += d * d.transpose() / count;
  }
  return moments;
}

/// Both scans in one frame, with the same weight.
Eigen::Matrix3d pooled_covariance(const SharedPlane& plane, const Eigen::Isometry3d& T_from_to) {
  const Eigen::Matrix3d R = T_from_to.linear();
  const Eigen::Vector3d apart = plane.from.mean - T_from_to * plane.to.mean;
  return 0.5 * (plane.from.covariance + R * plane.to.covariance * R.transpose()) +
         0.25 * apart * apart.transpose();
}

std::shared_ptr<const PointCloud> scan_of(const ScanStore& scans, Key key) {
  try {
    return scans.load(key);
  } catch (const Error&) {
    return nullptr;  // the store has counted the problem
  }
}

}  // namespace

double SharedPlane::thickness_m(const Eigen::Isometry3d& T_from_to) const {
  return std::sqrt(std::max(0.0, normal.dot(pooled_covariance(*this, T_from_to) * normal)));
}

std::vector<SharedPlane> shared_planes(const PointCloud& from, const PointCloud& to,
                                       const Eigen::Isometry3d& T_from_to) {
  constexpr float kFar_m = 1e6F;  // such points are invalid, and casts to cells would be undefined
  std::map<Cell, std::pair<Points, Points>> cells;
  for (const Eigen::Vector3f& p : from.points) {
    if (!(p.norm() < kFar_m)) continue;
    cells[cell_of(p.cast<double>())].first.push_back(p.cast<double>());
  }
  for (const Eigen::Vector3f& p : to.points) {
    if (!(p.norm() < kFar_m)) continue;
    // Other cells have too few points for a plane.
    const auto cell = cells.find(cell_of(T_from_to * p.cast<double>()));
    if (cell != cells.end()) cell->second.second.push_back(p.cast<double>());
  }
  std::vector<SharedPlane> planes;
  for (const auto& [cell, points] : cells) {
    if (points.first.size() < kLeastPoints || points.second.size() < kLeastPoints) continue;
    SharedPlane plane;
    plane.from = moments_of(points.first);
    plane.to = moments_of(points.second);
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(pooled_covariance(plane, T_from_to));
    const Eigen::Vector3d& values = solver.eigenvalues();  // ascending
    if (!(values[0] < kFlat * kFlat * values[1])) continue;
    plane.normal = solver.eigenvectors().col(0);
    planes.push_back(plane);
  }
  return planes;
}

std::vector<std::vector<SharedPlane>> shared_planes(const Mission& mission,
                                                    const std::vector<ProvenRevisit>& revisits,
                                                    const StopToken& stop) {
  std::vector<std::vector<SharedPlane>> planes(revisits.size());
  for (std::size_t i = 0; i < revisits.size() && !stop.stop_requested(); ++i) {
    const auto from = scan_of(*mission.scans, revisits[i].from), to = scan_of(*mission.scans, revisits[i].to);
    if (from && to) planes[i] = shared_planes(*from, *to, revisits[i].T_from_to);
  }
  return planes;
}

}  // namespace loopwise
