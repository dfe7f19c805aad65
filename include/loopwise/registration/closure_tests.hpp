// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Measurement, tests and covariance of an alignment, for every registrar.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/registration_result.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/kd_tree.hpp>

namespace loopwise {

/// Bounds of the tests of a closure, and parameters of its covariance.
struct ClosureTestOptions {
  /// Scans with fewer points are not aligned.
  int min_points = 20;
  /// Source points, evenly sampled, with which an alignment is measured. 0: all.
  int measured_points = 4000;
  /// Closures are rejected if the mean squared distance of all source points to the target is larger, m².
  double max_fitness_m2 = 0.9;
  /// Larger distances of points count as this distance, m, because scans of long range overlap only in part.
  /// LAMP has no such limit.
  double fitness_range_m = 1.5;
  /// A source point overlaps if a target point is within this distance, m.
  double overlap_distance_m = 0.5;
  /// Minimum share of overlapping source points, relative to the same share of neighbours within the target.
  double min_overlap = 0.4;
  /// Minimum overlap with equal weight for every direction of surfaces. Ground on ground alone is then not
  /// enough.
  double min_balanced_overlap = 0.25;
  /// Below this overlap, min_balanced_overlap falls in proportion and min_consistency rises, by up to 0.15.
  double full_overlap = 0.4;
  /// A point lies on a surface of the target if its distance along the normal is less than this, m.
  double plane_distance_m = 0.08;
  /// Minimum consistency: the share of overlapping points that lie on a surface, relative to the same share
  /// of their neighbours within their own scans, minus five times the share of points in space that the other
  /// scan saw as free, beyond what each scan shows of its own points. If less than half of the points
  /// overlap, the weight of free space grows in proportion. 0: no test.
  double min_consistency = 0.0;
  /// Closures with more unconstrained directions, whose standard deviation reaches max_sigma_m or
  /// max_sigma_rad, are rejected. A round tunnel has two.
  int max_free_directions = 2;
  /// Closures are rejected if their translation differs by more than this from the relative pose of the
  /// graph, m.
  double max_translation_m = 20.0;
  /// Closures are rejected if their rotation differs by more than this from the relative pose of the graph,
  /// rad.
  double max_rotation_rad = 50.0 * 3.14159265358979323846 / 180.0;
  /// Minimum standard deviation of the distance of a point to the plane of the target, m.
  double point_sigma_m = 0.05;
  /// Standard deviation of a normal, rad. Information that this noise alone explains does not count.
  double normal_sigma_rad = 0.05;
  /// Neighbouring points share their error: this many count as one independent measurement.
  double points_per_sample = 4.0;
  /// Added to the standard deviation of the translation in each direction, for errors that scans do not show,
  /// m.
  double min_sigma_m = 0.003;
  /// Added to the standard deviation of the rotation about each axis, for errors that scans do not show, rad.
  double min_sigma_rad = 0.002;
  /// Standard deviation of the translation in a direction that is not constrained, m.
  double max_sigma_m = 10.0;
  /// Standard deviation of the rotation about an axis that is not constrained, rad.
  double max_sigma_rad = 1.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("min_points", self.min_points, at_least(4.0));
    field("measured_points", self.measured_points, at_least(0.0));
    field("max_fitness_m2", self.max_fitness_m2, above(0.0));
    field("fitness_range_m", self.fitness_range_m, above(0.0));
    field("overlap_distance_m", self.overlap_distance_m, above(0.0));
    field("min_overlap", self.min_overlap, between(0.0, 1.0));
    field("min_balanced_overlap", self.min_balanced_overlap, between(0.0, 1.0));
    field("full_overlap", self.full_overlap, between(0.01, 1.0));
    field("plane_distance_m", self.plane_distance_m, above(0.0));
    field("min_consistency", self.min_consistency, between(0.0, 1.0));
    field("max_free_directions", self.max_free_directions, between(0.0, 6.0));
    field("max_translation_m", self.max_translation_m, above(0.0));
    field("max_rotation_rad", self.max_rotation_rad, above(0.0));
    field("point_sigma_m", self.point_sigma_m, above(0.0));
    field("normal_sigma_rad", self.normal_sigma_rad, between(0.0, 1.0));
    field("points_per_sample", self.points_per_sample, at_least(1.0));
    field("min_sigma_m", self.min_sigma_m, above(0.0));
    field("min_sigma_rad", self.min_sigma_rad, above(0.0));
    field("max_sigma_m", self.max_sigma_m, above(0.0));
    field("max_sigma_rad", self.max_sigma_rad, above(0.0));
  }
};

/// Figures of an alignment.
struct AlignmentFigures {
  /// Mean squared distance to the target of all source points, see fitness_range_m.
  double fitness_m2 = 0.0;
  double overlap = 0.0;  ///< Share of source points with a target point within overlap_distance_m.
  /// The overlap by points with agreeing normals (within 45°), as a mean over directions of the source's
  /// surfaces. Directions with less than 5 % of the points count in proportion.
  double balanced_overlap = 0.0;
  double on_plane = 0.0;           ///< Share of these points within plane_distance_m.
  double expected_on_plane = 1.0;  ///< The share among neighbours within the clouds, see PlaneNeighbours.
  double expected_overlap = 1.0;   ///< Overlap of neighbours within the target, see surface_share().
  /// Share of points in free space of the other scan, summed over source and target, beyond the share of
  /// points of each scan in what its other points show as free; 0 if not measured.
  double contradiction = 0.0;
  double plane_rmse_m = 0.0;  ///< Over overlapping points with agreeing normals, along the target's normals.
  std::size_t plane_points = 0;  ///< Number of these points.
  /// Gauss-Newton Hessian of ½ Σ (point-to-plane distance)² over T_from_to's right perturbation
  /// [translation, rotation]: with y = T_to_from·p and the target's normal n, J = −nᵀG, G = [I, −[y]×].
  Matrix6d hessian = Matrix6d::Zero();
  Matrix6d source_hessian = Matrix6d::Zero();  ///< The same with the known normals of the source.
  Matrix6d normal_noise =
      Matrix6d::Zero();  ///< Σ GᵀG: the contribution of random normals of variance 1 to the Hessian.
};

/// Figures of a correct alignment, estimated from neighbours within a cloud.
struct SurfaceShare {
  /// Share of points with a neighbour within overlap_distance_m: low for sparse scans of long range. At least
  /// 0.05.
  double overlap = 1.0;
  /// Share of the neighbours with agreeing normals that are within plane_distance_m of each other's plane:
  /// low for leaves and rubble. 1 without such neighbours.
  double on_plane = 1.0;
};
/// Measures 1000 points.
[[nodiscard]] LOOPWISE_EXPORT SurfaceShare surface_share(const PointCloud& cloud, const KdTree& tree,
                                                         const ClosureTestOptions& options);

/// How a point relates to its nearest neighbour within its own cloud.
enum class PlaneNeighbour : std::uint8_t {
  kNone,      ///< No neighbour within overlap_distance_m with an agreeing normal.
  kOffPlane,  ///< The point is not within plane_distance_m of the neighbour's plane.
  kOnPlane    ///< The point is within plane_distance_m of the neighbour's plane.
};

/// The same as surface_share() for every point. An overlap is often the far end of a scan, where points are
/// noisier and fewer than in the whole scan.
[[nodiscard]] LOOPWISE_EXPORT std::vector<PlaneNeighbour> plane_neighbours(const PointCloud& cloud,
                                                                           const KdTree& tree,
                                                                           const ClosureTestOptions& options);

/// plane_neighbours() of both clouds, and the share among all points. Neither vector is owned.
struct PlaneExpectation {
  const std::vector<PlaneNeighbour>& source;  ///< By point of the source.
  const std::vector<PlaneNeighbour>& target;  ///< By point of the target.
  double on_plane = 1.0;  ///< Counts as twenty points, so that a few points do not decide.
};

/// Measures source points against a target with normals under T_to_from (source to target). One
/// nearest-neighbour search per point. With `expectation`, expected_on_plane is the share among the
/// neighbours of those points that overlap; without it, the figure is left at 1.
[[nodiscard]] LOOPWISE_EXPORT AlignmentFigures
measure_alignment(const PointCloud& source, const PointCloud& target, const KdTree& target_tree,
                  const Eigen::Isometry3d& T_to_from, const ClosureTestOptions& options,
                  const PlaneExpectation* expectation = nullptr);

/// Fit of an alignment in detail: on_plane/expected_on_plane − 5·contradiction·max(1, 0.5/overlap), with the
/// overlap relative to the expected one and at least 0.05. Similar corridors overlap, but differ in roughness
/// and openings. Only points that overlap or contradict tell anything, so contradictions weigh more if few
/// points overlap.
[[nodiscard]] LOOPWISE_EXPORT double consistency(const AlignmentFigures& figures);

/// Number of the six directions that the points do not constrain: without a bound, their standard deviation
/// exceeds max_sigma.
[[nodiscard]] LOOPWISE_EXPORT int free_directions(const AlignmentFigures& figures,
                                                  const ClosureTestOptions& options);

/// Covariance of T_from_to from the point-to-plane Hessian: σ²·(points_per_sample)·H⁻¹ with σ the plane
/// distance's root mean square but at least point_sigma_m, plus min_sigma²; each direction (eigenvector of
/// the Hessian scaled by the bounds) is limited by max_sigma. Symmetric positive definite for every symmetric
/// finite input. Errors of the odometry within submaps are not included: the registrars add them.
[[nodiscard]] LOOPWISE_EXPORT Matrix6d closure_covariance(const AlignmentFigures& figures,
                                                          const ClosureTestOptions& options);

/// Raises the standard deviation of the translation along `direction` (unit, in the frame of T_from_to's
/// perturbation) to at least `sigma_m`.
LOOPWISE_EXPORT void widen_covariance(Matrix6d& covariance, const Eigen::Vector3d& direction, double sigma_m);

/// Difference of a pose from the graph's, as [translation, rotation]: log(guess⁻¹ · T_from_to), in the frame
/// of `to`. The last test of judge_alignment() bounds the lengths of both parts.
[[nodiscard]] LOOPWISE_EXPORT Vector6d moved_from_guess(const Eigen::Isometry3d& guess_from_to,
                                                        const Eigen::Isometry3d& T_from_to);

/// Share of full_overlap by which an alignment falls short of it, in [0, 1].
[[nodiscard]] LOOPWISE_EXPORT double missing_overlap(const AlignmentFigures& figures,
                                                     const ClosureTestOptions& options);

/// Fills `result` from an alignment: figures, reason and message, or the closure with its covariance.
/// Tests in order: finite, converged, fitness, overlap, consistency, free directions, distance from the
/// guess.
LOOPWISE_EXPORT void judge_alignment(RegistrationResult& result, const Eigen::Isometry3d& T_from_to,
                                     const AlignmentFigures& figures, bool converged,
                                     const std::optional<Eigen::Isometry3d>& guess_from_to,
                                     const ClosureTestOptions& options);

}  // namespace loopwise
