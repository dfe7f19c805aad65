// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise {

/// Status of a critical point of the isotropic chordal cost.
enum class CertificateStatus {
  kCertified,    ///< No poses cost less, within the requested relative gap.
  kImprovable,   ///< Poses that cost less were found.
  kUndecided,    ///< Neither: the relaxation is not tight, or the search for lower poses is incomplete.
  kUnsupported,  ///< The graph has factors that the relaxation does not cover: ranges or gravity.
};
[[nodiscard]] LOOPWISE_EXPORT EnumNames<CertificateStatus> enum_names(CertificateStatus);

/// Precision of a certificate, and effort of the search for lower poses without a certificate.
struct CertificateOptions {
  /// The result is certified if its cost is at most this share above a lower bound on the cost of all poses.
  double relative_gap = 1e-4;
  /// Maximum number of Newton steps of each descent.
  int max_steps = 200;
  /// Maximum rank of the relaxation in which poses of lower cost are sought. 3: no search.
  int max_rank = 5;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("relative_gap", self.relative_gap, between(1e-12, 0.1));
    field("max_steps", self.max_steps, at_least(1));
    field("max_rank", self.max_rank, between(3.0, 6.0));
  }
};

/// Global optimality of an estimate by the isotropic chordal cost
///
///     F = ½ Σ w (κ ‖R_j − R_i R̃‖² + τ ‖t_j − t_i − R_i t̃‖²),   τ = 3 / tr(Ω_t⁻¹),   κ = 3 / (2 tr(Ω_R⁻¹))
///
/// over edges and priors; in a planar graph τ = 2 / tr(Ω_xy⁻¹) and κ = Ω_θ / 2. The certificate is for this
/// cost, at its critical point next to the estimate, not for ½ Σ w rᵀΩr. Both agree to second order in the
/// residuals if Ω_t and Ω_R are multiples of the identity without coupling between them.
struct Certificate {
  /// kImprovable if any component is, otherwise kUndecided if any is.
  CertificateStatus status = CertificateStatus::kUndecided;
  std::string message;  ///< For people; never parse it.
  /// F at the graph's poses. It differs from ½ Σ w rᵀΩr: anisotropic information counts by its mean, and a
  /// single prior of a component does not count.
  double cost_at_estimate = 0.0;
  double cost = 0.0;          ///< F at the critical point reached from them.
  double lower_bound = 0.0;   ///< No poses have a lower F; at least 0.
  double relative_gap = 0.0;  ///< (cost − lower_bound) / cost; 0 if all residuals are rounding errors.
  /// Smallest eigenvalue of the dual certificate matrix, with translations eliminated, over all components.
  /// It is 0 for a certified component, whose eigenvalues are above −eigenvalue_tolerance; the zero
  /// eigenvalue belongs to the poses themselves.
  double min_eigenvalue = 0.0;
  double eigenvalue_tolerance = 0.0;  ///< The largest of all components.
  /// Critical point of F reached from the estimate, one pose per node. A component's first node, or the node
  /// of its only prior, keeps its pose.
  std::vector<Eigen::Isometry3d> poses;
  /// The poses of the lowest F found if the status is kImprovable; otherwise `poses`.
  std::vector<Eigen::Isometry3d> best_poses;
  double best_cost = 0.0;                ///< F at best_poses.
  double rotation_max_rad = 0.0;         ///< Largest angle between the estimate and `poses`.
  double rotation_rms_rad = 0.0;         ///< Root mean square of these angles over all nodes with a factor.
  double translation_max_m = 0.0;        ///< Largest distance between the estimate and `poses`.
  double translation_rms_m = 0.0;        ///< Root mean square of these distances.
  std::size_t components = 0;            ///< Components with at least one factor to certify.
  std::size_t certified_components = 0;  ///< Those of them that are certified.
  /// Factors whose information has rank 1 or 2 in translation or rotation: that part has no isotropic
  /// counterpart and is left out of F. A component with such factors is never certified.
  std::size_t reduced_factors = 0;
  /// Whether lower_bound is the optimum of the relaxation, up to CertificateOptions::relative_gap. If it is,
  /// the status is kUndecided and reduced_factors is 0, the relaxation is not tight: no certificate of this
  /// kind exists.
  bool relaxation_solved = false;
  int rank = 3;          ///< Largest rank of the relaxation that was needed.
  int steps = 0;         ///< Newton steps, of all descents.
  double seconds = 0.0;  ///< Wall time. For reports only.
};

/// Tests whether the graph's poses, the result of an optimisation, are globally optimal: descends to the
/// critical point of F next to them and tests the dual certificate of the semidefinite relaxation (Rosen et
/// al., SE-Sync, IJRR 2019), each component separately. Edges count by their weights; those of weight 0 do
/// not take part. Several priors of a component count as edges from one additional pose; a single prior costs
/// nothing at the optimum. If the certificate fails, relaxations of higher rank search for lower poses.
/// \throws OptionError; Error if a factor of the matrices would be too large
[[nodiscard]] LOOPWISE_EXPORT Certificate certify(const PoseGraph& graph,
                                                  const CertificateOptions& options = {},
                                                  const StopToken& stop = {});

/// An estimate with its certificate, see optimize_certified().
struct CertifiedEstimate {
  std::vector<Eigen::Isometry3d> poses;  ///< One per node, in graph order.
  double cost_before = 0.0;              ///< ½ Σ w rᵀΩr at the graph's poses.
  double cost = 0.0;                     ///< The same at `poses`; never higher.
  bool improved = false;                 ///< Whether `poses` differ from the graph's and have a lower cost.
  /// Whether a certificate found lower poses (kImprovable) from which `improved` started. If not, the graph's
  /// poses were not at a minimum within the optimiser's precision, and minimising continued from them.
  bool lower_minimum = false;
  /// The minimisation that ended at `poses`, if they are `improved`.
  OptimizationResult optimization;
  /// Whether minimising ½ Σ w rᵀΩr from the poses of the certificate reaches the cost of `poses`: they are
  /// then the minimum next to the certified point. False if this was not tested.
  bool same_minimum = false;
  Certificate certificate;  ///< Of `poses`.
};

/// The result of an optimisation and its continuation from the poses of the first as one: it begins as the
/// first and ends as the second, with the steps of both. For CertifiedEstimate::optimization.
[[nodiscard]] LOOPWISE_EXPORT OptimizationResult continued(const OptimizationResult& first,
                                                           OptimizationResult continuation);

/// Certifies the graph's poses, the result of an optimisation, minimises ½ Σ w rᵀΩr from the lowest poses of
/// the certificate, and repeats this with the result if it is lower. The weights of the edges do not change.
/// \throws OptionError; Error if a factor of the matrices would be too large
[[nodiscard]] LOOPWISE_EXPORT CertifiedEstimate optimize_certified(const PoseGraph& graph,
                                                                   const OptimizerOptions& optimizer = {},
                                                                   const CertificateOptions& options = {},
                                                                   const StopToken& stop = {});

}  // namespace loopwise
