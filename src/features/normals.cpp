// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/normals.hpp>

#include <Eigen/Eigenvalues>

#include <loopwise/core/options.hpp>

namespace loopwise {
namespace {

/// Neighbours count as one line if the second largest eigenvalue is below this share of the largest: its
/// width is then less than a thousandth of its length.
constexpr double kMinSpreadRatio = 1e-6;

}  // namespace

std::vector<Eigen::Vector3f> estimate_normals(const std::vector<Eigen::Vector3f>& points, const KdTree& tree,
                                              int neighbours) {
  detail::check_bounds("normal_neighbours", neighbours, at_least(3.0));
  std::vector<Eigen::Vector3f> normals(points.size(), Eigen::Vector3f::Zero());
  std::vector<Neighbour> found;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  for (std::size_t i = 0; i < points.size(); ++i) {
    tree.nearest(points[i], static_cast<std::size_t>(neighbours), found);
    if (found.size() < 3) continue;
    // Positions relative to the point itself keep their digits even if the cloud is far from the origin.
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (const Neighbour& neighbour : found) {
      const Eigen::Vector3d d = (points[neighbour.index] - points[i]).cast<double>();
      mean += d;
      moment.noalias() += d * d.transpose();
    }
    const auto n = static_cast<double>(found.size());
    mean /= n;
    solver.computeDirect(moment / n - mean * mean.transpose());
    const Eigen::Vector3d& spread = solver.eigenvalues();
    if (!(spread.z() > 0.0) || !(spread.y() > kMinSpreadRatio * spread.z())) continue;
    Eigen::Vector3d normal = solver.eigenvectors().col(0).normalized();
    if (!normal.allFinite()) continue;
    if (normal.dot(points[i].cast<double>()) > 0.0) normal = -normal;
    normals[i] = normal.cast<float>();
  }
  return normals;
}

}  // namespace loopwise
