// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/normals.hpp>

#include <string>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise {
namespace {

/// Neighbours count as one line if the second largest eigenvalue is below this share of the largest: its
/// width is then less than a thousandth of its length.
constexpr double kMinSpreadRatio = 1e-6;

template <class Points>
std::vector<Eigen::Vector3f> normals_of(const Points& points, const KdTree& tree, int neighbours,
                                        const Eigen::Vector3d& sensor) {
  std::vector<Eigen::Vector3f> normals(tree.cloud_size(), Eigen::Vector3f::Zero());
  std::vector<Neighbour> found;
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  for (std::size_t i = 0; i < normals.size(); ++i) {
    const Eigen::Vector3f point = points[i];
    tree.nearest(point, static_cast<std::size_t>(neighbours), found);
    if (found.size() < 3) continue;
    // Positions relative to the point itself keep their digits even if the cloud is far from the origin.
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
    for (const Neighbour& neighbour : found) {
      const Eigen::Vector3d d = (points[neighbour.index] - point).template cast<double>();
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
    if (normal.dot(point.template cast<double>() - sensor) > 0.0) normal = -normal;
    normals[i] = normal.cast<float>();
  }
  return normals;
}

}  // namespace

namespace detail {

void check_tree(const char* what, const KdTree& tree, PointView points) {
  if (tree.cloud_size() == points.size()) return;
  throw InputError(std::string(what) + ": the tree is of a cloud of " + std::to_string(tree.cloud_size()) +
                   " points, but the cloud has " + std::to_string(points.size()) +
                   ": build the tree from the same cloud");
}

}  // namespace detail

std::vector<Eigen::Vector3f> estimate_normals(PointView points, const KdTree& tree, int neighbours,
                                              const Eigen::Vector3d& sensor) {
  detail::check_bounds("normal_neighbours", neighbours, at_least(3.0));
  detail::check_tree("estimate_normals", tree, points);
  return detail::with_points(points,
                             [&](const auto& array) { return normals_of(array, tree, neighbours, sensor); });
}

}  // namespace loopwise
