// SPDX-License-Identifier: BSD-3-Clause
#include "submap_errors.hpp"

#include <algorithm>
#include <vector>

#include <Eigen/Cholesky>

namespace loopwise {
namespace {

/// Cosine of the angle within which two normals agree.
constexpr float kSameSurface = 0.7F;

/// Source points that are looked at.
constexpr std::size_t kMemberPoints = 600;

/// Gauss-Newton Hessians of the point-to-plane distances, by the member that holds the points.
struct Hessians {
  std::vector<Matrix6d> of_source, of_target;
  Matrix6d sum = Matrix6d::Zero();
  std::size_t points = 0;
};

/// Number of the part of a submap's cloud that holds a point.
class PartOfPoint {
 public:
  explicit PartOfPoint(const Submap& submap) {
    for (const Part& part : submap.parts())
      ends_.push_back((ends_.empty() ? 0 : ends_.back()) + part.features->cloud.size());
  }
  [[nodiscard]] std::size_t operator()(std::size_t point) const {
    return static_cast<std::size_t>(std::upper_bound(ends_.begin(), ends_.end(), point) - ends_.begin());
  }

 private:
  std::vector<std::size_t> ends_;
};

Hessians hessians_of_members(const Submap& source, const Submap& target,
                             const Eigen::Isometry3d& T_target_source, const ClosureTestOptions& options) {
  const PointCloud &from = source.cloud(), &to = target.cloud();
  const PartOfPoint source_part(source), target_part(target);
  Hessians out;
  out.of_source.assign(source.parts().size(), Matrix6d::Zero());
  out.of_target.assign(target.parts().size(), Matrix6d::Zero());
  out.points = std::min(from.size(), kMemberPoints);
  for (std::size_t k = 0; k < out.points; ++k) {
    const std::size_t i = k * from.size() / out.points;
    const Eigen::Vector3d y = T_target_source * from.points[i].cast<double>();
    const auto nearest =
        target.tree().nearest(y.cast<float>(), static_cast<float>(options.overlap_distance_m));
    if (!nearest) continue;
    const Eigen::Vector3f& n = to.normals[nearest->index];
    const Eigen::Vector3f m = T_target_source.linear().cast<float>() * from.normals[i];
    if (n.isZero() || (!m.isZero() && n.dot(m) < kSameSurface)) continue;
    Vector6d j;
    j << n.cast<double>(), y.cross(n.cast<double>());
    const Matrix6d own = j * j.transpose();
    out.sum += own;
    out.of_source[source_part(i)] += own;
    out.of_target[target_part(nearest->index)] += own;
  }
  return out;
}

/// The Hessian of a direction that the points hardly constrain, see max_sigma_m. It keeps H⁻¹ bounded.
Matrix6d least_hessian(const AlignmentFigures& figures, const ClosureTestOptions& options) {
  const double sigma = std::max(figures.plane_rmse_m, options.point_sigma_m);
  Vector6d deviations;
  deviations << Eigen::Vector3d::Constant(options.max_sigma_m),
      Eigen::Vector3d::Constant(options.max_sigma_rad);
  return (sigma * sigma * options.points_per_sample * deviations.cwiseAbs2().cwiseInverse()).asDiagonal();
}

const Matrix6d& covariance_of_member(const std::vector<SubmapMember>& members, Key key) {
  return std::find_if(members.begin(), members.end(), [&](const SubmapMember& m) { return m.key == key; })
      ->covariance;
}

}  // namespace

Matrix6d submap_errors(const Submap& source, const Submap& target, const RegistrationTask& task,
                       const Eigen::Isometry3d& T_target_source, const AlignmentFigures& figures,
                       const ClosureTestOptions& options) {
  Matrix6d out = Matrix6d::Zero();
  if (source.parts().size() == 1 && target.parts().size() == 1) return out;
  const Hessians hessians = hessians_of_members(source, target, T_target_source, options);
  const Eigen::LDLT<Matrix6d> all(hessians.sum + least_hessian(figures, options) *
                                                     static_cast<double>(hessians.points) /
                                                     static_cast<double>(source.cloud().size()));
  // Adds the steps of the odometry on one side of the centre, each with all members beyond it.
  const auto add = [&](const Submap& submap, const std::vector<SubmapMember>& members,
                       const std::vector<Matrix6d>& of_part, bool after, const Matrix6d& to_target) {
    const std::vector<Part>& parts = submap.parts();
    const auto beyond = [&](std::size_t i) { return i > 0 && (parts[i].key > parts[0].key) == after; };
    Matrix6d held = Matrix6d::Zero(), known = Matrix6d::Zero();
    for (std::size_t i = 1; i < parts.size(); ++i) {
      if (beyond(i)) held += of_part[i];
    }
    for (std::size_t i = 1; i < parts.size(); ++i) {
      if (!beyond(i)) continue;
      const Matrix6d& covariance = covariance_of_member(members, parts[i].key);
      const Matrix6d moves = all.solve(held) * to_target;
      out += moves * (covariance - known) * moves.transpose();
      known = covariance;
      held -= of_part[i];
    }
  };
  for (const bool after : {false, true}) {
    add(target, task.target, hessians.of_target, after, Matrix6d::Identity());
    add(source, task.source, hessians.of_source, after, se3::adjoint(T_target_source));
  }
  return 0.5 * (out + out.transpose());
}

}  // namespace loopwise
