// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/closure_tests.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <sstream>

#include <Eigen/Eigenvalues>

#include "normal_bins.hpp"

namespace loopwise {
namespace {

/// Cosine of the angle within which two normals agree.
constexpr float kAgreeingShare = 0.7F;

/// By how much the required consistency rises as the overlap falls from full_overlap to nothing. Few points
/// agree by chance more often than many.
constexpr double kSmallOverlapConsistency = 0.15;

/// max_sigma of each coordinate. In these units, a free direction has variance 1 or more.
Vector6d units(const ClosureTestOptions& options) {
  Vector6d out;
  out << Eigen::Vector3d::Constant(options.max_sigma_m), Eigen::Vector3d::Constant(options.max_sigma_rad);
  return out;
}

Eigen::SelfAdjointEigenSolver<Matrix6d> scaled_information(const Matrix6d& hessian,
                                                           const AlignmentFigures& figures,
                                                           const ClosureTestOptions& options) {
  const double sigma = std::max(figures.plane_rmse_m, options.point_sigma_m);
  const Vector6d unit = units(options);
  const Matrix6d told = hessian - options.normal_sigma_rad * options.normal_sigma_rad * figures.normal_noise;
  const Matrix6d information = unit.asDiagonal() * told * unit.asDiagonal();
  return Eigen::SelfAdjointEigenSolver<Matrix6d>(0.5 * (information + information.transpose()) /
                                                 (sigma * sigma * options.points_per_sample));
}

/// Reads the nearest neighbour of a point from the two nearest points in its cloud. `near` is set to whether
/// any point is within overlap_distance_m.
PlaneNeighbour plane_neighbour(const PointCloud& cloud, const KdTree& tree, std::size_t i,
                               const ClosureTestOptions& options, std::vector<Neighbour>& found, bool& near) {
  near = false;
  const auto reach = static_cast<float>(options.overlap_distance_m);
  tree.nearest(cloud.points[i], 2, found);
  if (found.size() < 2) return PlaneNeighbour::kNone;
  const Neighbour& other = found[found.front().index == i ? 1 : 0];
  near = other.sq_distance_m2 <= reach * reach;
  const Eigen::Vector3f& n = cloud.normals[other.index];
  if (!near || n.dot(cloud.normals[i]) < kAgreeingShare) return PlaneNeighbour::kNone;
  const float distance = std::abs(n.dot(cloud.points[i] - cloud.points[other.index]));
  return distance < static_cast<float>(options.plane_distance_m) ? PlaneNeighbour::kOnPlane
                                                                 : PlaneNeighbour::kOffPlane;
}

/// Counts neighbours of one cloud.
struct PlaneCount {
  std::size_t on = 0, off = 0;
  void add(PlaneNeighbour of_point) {
    if (of_point == PlaneNeighbour::kOnPlane) ++on;
    if (of_point == PlaneNeighbour::kOffPlane) ++off;
  }
  /// The share on the plane, with `before` as what twenty further points would say.
  [[nodiscard]] double share(double before) const {
    constexpr double kWeight = 20.0;
    return (static_cast<double>(on) + kWeight * before) / (static_cast<double>(on + off) + kWeight);
  }
};

template <class Figure>
std::string beyond(const char* what, Figure found, const char* relation, Figure bound, const char* unit) {
  std::ostringstream out;
  out.exceptions(std::ios::badbit);  // a failed allocation throws instead of cutting the message
  out.precision(4);
  out << what << " " << found << unit << ", must be " << relation << " " << bound << unit;
  return out.str();
}

}  // namespace

AlignmentFigures measure_alignment(const PointCloud& source, const PointCloud& target,
                                   const KdTree& target_tree, const Eigen::Isometry3d& T_to_from,
                                   const ClosureTestOptions& options, const PlaneExpectation* expectation) {
  AlignmentFigures figures;
  if (source.empty() || target.empty()) return figures;
  constexpr double kFullDirection = 0.05;  // share of the points
  const double sq_overlap = options.overlap_distance_m * options.overlap_distance_m;
  const double sq_range = options.fitness_range_m * options.fitness_range_m;
  const auto reach = static_cast<float>(std::max(options.fitness_range_m, options.overlap_distance_m));
  const bool with_normals = source.has_normals();
  std::array<std::size_t, kNormalBins> of_direction{}, agreeing{};
  double sum_sq = 0.0, sum_sq_plane = 0.0;
  std::size_t overlapping = 0, on_plane = 0;
  PlaneCount of_source, of_target;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
  const std::size_t measured =
      options.measured_points == 0
          ? source.size()
          : std::min(source.size(), static_cast<std::size_t>(options.measured_points));
  for (std::size_t k = 0; k < measured; ++k) {
    const std::size_t i = k * source.size() / measured;
    const Eigen::Vector3d y = T_to_from * source.points[i].cast<double>();
    const std::size_t bin = with_normals ? normal_bin(source.normals[i]) : kUnknownNormal;
    ++of_direction[bin];
    const std::optional<Neighbour> nearest = target_tree.nearest(y.cast<float>(), reach);
    const double sq_distance = nearest ? static_cast<double>(nearest->sq_distance_m2) : sq_range;
    sum_sq += std::min(sq_distance, sq_range);
    if (!nearest || sq_distance > sq_overlap) continue;
    ++overlapping;
    const Eigen::Vector3d n = target.normals[nearest->index].cast<double>();
    const Eigen::Vector3d m =
        bin == kUnknownNormal ? n : Eigen::Vector3d(T_to_from.linear() * source.normals[i].cast<double>());
    if (!n.isZero() && n.dot(m) < static_cast<double>(kAgreeingShare)) continue;
    ++agreeing[bin];
    if (n.isZero()) continue;
    const double distance = n.dot(y - target.points[nearest->index].cast<double>());
    Vector6d j;
    j << n, y.cross(n);
    figures.hessian.noalias() += j * j.transpose();
    j << m, y.cross(m);
    figures.source_hessian.noalias() += j * j.transpose();
    sum += y;
    moment.noalias() += y * y.transpose();
    sum_sq_plane += distance * distance;
    if (std::abs(distance) < options.plane_distance_m) ++on_plane;
    ++figures.plane_points;
    if (expectation == nullptr) continue;
    of_source.add(expectation->source[i]);
    of_target.add(expectation->target[nearest->index]);
  }
  const auto planes = static_cast<double>(figures.plane_points);
  figures.normal_noise.topLeftCorner<3, 3>().diagonal().setConstant(planes);
  figures.normal_noise.topRightCorner<3, 3>() = -se3::skew(sum);
  figures.normal_noise.bottomLeftCorner<3, 3>() = se3::skew(sum);
  figures.normal_noise.bottomRightCorner<3, 3>() = moment.trace() * Eigen::Matrix3d::Identity() - moment;

  const auto n = static_cast<double>(measured);
  const double scale = static_cast<double>(source.size()) / n;
  figures.hessian *= scale;
  figures.source_hessian *= scale;
  figures.normal_noise *= scale;
  figures.fitness_m2 = sum_sq / n;
  figures.overlap = static_cast<double>(overlapping) / n;
  if (figures.plane_points > 0) {
    figures.plane_rmse_m = std::sqrt(sum_sq_plane / planes);
    figures.on_plane = static_cast<double>(on_plane) / planes;
  }
  if (expectation != nullptr) {
    figures.expected_on_plane =
        0.5 * (of_source.share(expectation->on_plane) + of_target.share(expectation->on_plane));
  }
  double weights = 0.0;
  for (std::size_t bin = 0; bin < kNormalBins; ++bin) {
    if (of_direction[bin] == 0) continue;
    const auto count = static_cast<double>(of_direction[bin]);
    const double weight = std::min(1.0, count / (kFullDirection * n));
    figures.balanced_overlap += weight * static_cast<double>(agreeing[bin]) / count;
    weights += weight;
  }
  figures.balanced_overlap /= weights;
  return figures;
}

SurfaceShare surface_share(const PointCloud& cloud, const KdTree& tree, const ClosureTestOptions& options) {
  constexpr std::size_t kLookedAt = 1000;
  const std::size_t looked_at = std::min(cloud.size(), kLookedAt);
  std::size_t near = 0;
  PlaneCount count;
  std::vector<Neighbour> found;
  for (std::size_t k = 0; k < looked_at; ++k) {
    bool is_near = false;
    count.add(plane_neighbour(cloud, tree, k * cloud.size() / looked_at, options, found, is_near));
    if (is_near) ++near;
  }
  constexpr double kLeastOverlap = 0.05;
  SurfaceShare share;
  if (near > 0)
    share.overlap = std::max(kLeastOverlap, static_cast<double>(near) / static_cast<double>(looked_at));
  if (count.on > 0)
    share.on_plane = static_cast<double>(count.on) / static_cast<double>(count.on + count.off);
  return share;
}

std::vector<PlaneNeighbour> plane_neighbours(const PointCloud& cloud, const KdTree& tree,
                                             const ClosureTestOptions& options) {
  std::vector<PlaneNeighbour> out(cloud.size());
  std::vector<Neighbour> found;
  bool is_near = false;
  for (std::size_t i = 0; i < out.size(); ++i) {
    out[i] = plane_neighbour(cloud, tree, i, options, found, is_near);
  }
  return out;
}

double consistency(const AlignmentFigures& figures) {
  constexpr double kWeight = 5.0, kHalf = 0.5, kLeast = 0.05;
  const double overlap = std::clamp(figures.overlap / figures.expected_overlap, kLeast, kHalf);
  return figures.on_plane / figures.expected_on_plane - kWeight * figures.contradiction * kHalf / overlap;
}

double missing_overlap(const AlignmentFigures& figures, const ClosureTestOptions& options) {
  return std::clamp(1.0 - figures.overlap / (figures.expected_overlap * options.full_overlap), 0.0, 1.0);
}

int free_directions(const AlignmentFigures& figures, const ClosureTestOptions& options) {
  const auto free = [&](const Matrix6d& hessian) {
    return static_cast<int>(
        (scaled_information(hessian, figures, options).eigenvalues().array() <= 1.0).count());
  };
  return std::max(free(figures.hessian), free(figures.source_hessian));
}

Matrix6d closure_covariance(const AlignmentFigures& figures, const ClosureTestOptions& options) {
  const auto solver = scaled_information(figures.hessian, figures, options);
  const Vector6d unit = units(options);
  const Vector6d variances = solver.eigenvalues().cwiseMax(1.0).cwiseInverse();
  const Matrix6d basis = unit.asDiagonal() * solver.eigenvectors();
  Matrix6d covariance = basis * variances.asDiagonal() * basis.transpose();
  covariance.diagonal().head<3>().array() += options.min_sigma_m * options.min_sigma_m;
  covariance.diagonal().tail<3>().array() += options.min_sigma_rad * options.min_sigma_rad;
  return 0.5 * (covariance + covariance.transpose());
}

void widen_covariance(Matrix6d& covariance, const Eigen::Vector3d& direction, double sigma_m) {
  Vector6d d = Vector6d::Zero();
  d.head<3>() = direction;
  const double missing = sigma_m * sigma_m - d.dot(covariance * d);
  if (missing <= 0.0) return;
  covariance += missing * (d * d.transpose());
  covariance = (0.5 * (covariance + covariance.transpose())).eval();
}

Vector6d moved_from_guess(const Eigen::Isometry3d& guess_from_to, const Eigen::Isometry3d& T_from_to) {
  return se3::log(guess_from_to.inverse() * T_from_to);
}

void judge_alignment(RegistrationResult& result, const Eigen::Isometry3d& T_from_to,
                     const AlignmentFigures& figures, bool converged,
                     const std::optional<Eigen::Isometry3d>& guess_from_to,
                     const ClosureTestOptions& options) {
  const auto reject = [&](RejectionReason reason, std::string message) {
    result.reason = reason;
    result.message = std::move(message);
  };
  if (!T_from_to.matrix().allFinite() || !figures.hessian.allFinite()) {
    return reject(RejectionReason::kNotConverged, "the refinement reached values that are not finite");
  }
  result.T_from_to = se3::normalized(T_from_to);
  result.gicp_fitness_m2 = figures.fitness_m2;
  result.overlap = figures.overlap;
  if (!converged) return reject(RejectionReason::kNotConverged, "the refinement did not converge");
  if (!(figures.fitness_m2 <= options.max_fitness_m2)) {
    return reject(RejectionReason::kGicpFitness,
                  beyond("mean squared distance", figures.fitness_m2, "<=", options.max_fitness_m2, " m^2"));
  }
  const double overlap = figures.overlap / figures.expected_overlap;
  if (!(overlap >= options.min_overlap)) {
    return reject(RejectionReason::kLowOverlap, beyond("overlap", overlap, ">=", options.min_overlap, ""));
  }
  const double missing = missing_overlap(figures, options);
  const double balanced = figures.balanced_overlap / figures.expected_overlap;
  const double min_balanced = options.min_balanced_overlap * (1.0 - missing);
  if (!(balanced >= min_balanced)) {
    return reject(RejectionReason::kLowOverlap,
                  beyond("overlap balanced over directions", balanced, ">=", min_balanced, ""));
  }
  const double min_consistency = options.min_consistency + kSmallOverlapConsistency * missing;
  if (options.min_consistency > 0.0 && !(consistency(figures) >= min_consistency)) {
    return reject(RejectionReason::kInconsistent,
                  beyond("consistency", consistency(figures), ">=", min_consistency, ""));
  }
  const int free = free_directions(figures, options);
  if (free > options.max_free_directions) {
    return reject(RejectionReason::kDegenerate,
                  beyond("free directions:", free, "<=", options.max_free_directions, ""));
  }
  if (guess_from_to) {
    const Vector6d moved = moved_from_guess(*guess_from_to, *result.T_from_to);
    const double rotation_rad = moved.tail<3>().norm();
    if (!(moved.head<3>().norm() <= options.max_translation_m)) {
      return reject(RejectionReason::kTransformThreshold,
                    beyond("moved by", moved.head<3>().norm(), "<=", options.max_translation_m, " m"));
    }
    if (!(rotation_rad <= options.max_rotation_rad)) {
      return reject(RejectionReason::kTransformThreshold,
                    beyond("turned by", rotation_rad, "<=", options.max_rotation_rad, " rad"));
    }
  }
  result.reason = RejectionReason::kNone;
  result.message.clear();
  LoopClosure closure;
  closure.from = result.candidate.from;
  closure.to = result.candidate.to;
  closure.T_from_to = *result.T_from_to;
  closure.covariance = closure_covariance(figures, options);
  result.closure = closure;
}

}  // namespace loopwise
