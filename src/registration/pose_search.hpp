// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <list>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/clock.hpp>
#include <loopwise/registration/fast_registrar.hpp>

#include "gicp.hpp"
#include "side.hpp"

namespace loopwise {

/// Whether two poses of a cloud with the middle `centre` are distinct, and not one pose with different
/// errors.
[[nodiscard]] bool far_apart(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b,
                             const Eigen::Vector3d& centre);

/// Refines, compares and judges poses T_target_source of one pair.
class PoseSearch {
 public:
  /// All arguments must outlive the object.
  PoseSearch(const Side& source, const Side& target, const RegistrationTask& task,
             const FastRegistrarOptions& options, RegistrationResult& result);

  /// Whether the refinement of a start can end within the bounds about the guess. It moves a pose by at most
  /// the coarse reach and 5 degrees.
  [[nodiscard]] bool allowed(const Eigen::Isometry3d& start) const {
    return within_bounds(start, options_.coarse_reach_m, kSlackRad);
  }

  [[nodiscard]] bool empty() const { return poses_.empty(); }

  /// Refines a start from coarse to fine and keeps the pose. Returns the share of points on the target's
  /// surfaces, relative to the share that is expected at a true pose; 0 if the pose left the allowed region.
  double refine(const Eigen::Isometry3d& start);

  /// The same with a third of the points and without a result: for many starts of which few are right.
  void refine_coarsely(const Eigen::Isometry3d& start);

  /// Judges the best pose, and compares it with its rivals if it passes. May be called again after further
  /// poses are refined; poses that fail the tests by far are dropped. Returns false if the time ran out; the
  /// result is then invalid.
  [[nodiscard]] bool decide(const Deadline& deadline);

 private:
  static constexpr double kSlackRad = 5.0 * 3.14159265358979323846 / 180.0;

  struct Pose {
    Eigen::Isometry3d T_target_source = Eigen::Isometry3d::Identity();
    double share = 0.0;         // on surfaces, relative to the share expected at a true pose
    std::optional<double> fit;  // see fit_of()
    AlignmentFigures figures;   // with few points; computed with `fit`
    bool refused = false;       // by the tests
  };
  struct Judgement {
    Eigen::Isometry3d T_target_source =
        Eigen::Isometry3d::Identity();  // refined with all points, if it may pass
    AlignmentFigures figures;
    RegistrationResult result;
    [[nodiscard]] Vector6d offset_to(const Eigen::Isometry3d& other_target_source) const;
  };

  [[nodiscard]] bool within_bounds(const Eigen::Isometry3d& T_target_source, double slack_m,
                                   double slack_rad) const;
  [[nodiscard]] double expected_on_plane() const;
  [[nodiscard]] double share_of(const Eigen::Isometry3d& T_target_source, std::size_t points) const;
  [[nodiscard]] GicpResult gicp(const Eigen::Isometry3d& start, const std::vector<GicpPass>& passes) const;
  [[nodiscard]] std::vector<GicpPass> settle_pass() const;
  [[nodiscard]] std::size_t few_points() const { return static_cast<std::size_t>(options_.score_points) / 3; }
  [[nodiscard]] std::vector<GicpPass> quick_passes() const;
  [[nodiscard]] AlignmentFigures figures_of(const Eigen::Isometry3d& T_target_source,
                                            const ClosureTestOptions& tests,
                                            const PlaneExpectation* expectation = nullptr) const;
  void add(const Pose& pose);
  double fit_of(Pose& pose) const;
  [[nodiscard]] Pose* best_in_detail();
  [[nodiscard]] Judgement judge(Pose& pose) const;
  [[nodiscard]] bool refuse_hopeless();
  void refuse_if_sliding(Judgement& judged) const;
  bool refuse_if_sliding(Judgement& judged, double min_overlap, double sigma_m, double max_sigma_m) const;
  [[nodiscard]] bool clearly_slides(const Pose& pose, Judgement& judged) const;
  void widen(Judgement& found) const;
  [[nodiscard]] bool attracts(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) const;
  [[nodiscard]] std::vector<Eigen::Isometry3d> starts_of_rivals(const Eigen::Isometry3d& best) const;
  [[nodiscard]] bool add_rivals(Pose& best, const Judgement& found, const Deadline& deadline);
  [[nodiscard]] bool differs(const Pose& pose, const Judgement& found) const;
  [[nodiscard]] bool favours(const Pose& pose, const Judgement& found) const;
  void refuse_if_ambiguous(Pose& best, Judgement& found);

  const Side& source_;
  const Side& target_;
  const RegistrationTask& task_;
  const FastRegistrarOptions& options_;
  const ClosureTestOptions least_;  // the tests with the smallest overlap that may suffice
  RegistrationResult& result_;
  std::vector<GicpPass> passes_, fine_pass_;
  std::list<Pose> poses_;            // by falling share; references stay valid
  mutable FollowedPoints followed_;  // of the source; only spares searches
};

}  // namespace loopwise
