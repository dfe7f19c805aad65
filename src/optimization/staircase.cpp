// SPDX-License-Identifier: BSD-3-Clause
#include "staircase.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <Eigen/Dense>

#include "dual_matrix.hpp"

namespace loopwise::detail {
namespace {

/// The dual certificate at a critical point of any rank.
struct DualTest {
  bool certified = false;
  bool negligible = false;         // the cost is zero up to rounding, so nothing has to be proved
  bool lost_in_rounding = false;   // the rounding error of the bound is larger than the requested gap
  double lower_bound = 0.0;        // of the cost
  double tolerance = 0.0;          // of the eigenvalue
  DualMatrix::Eigenpair negative;  // if not certified
};

/// Computes the eigenvalue below −shift, and a lower bound on the cost that a Cholesky factor proves.
void find_negative(DualMatrix& dual, double shift, double first, const std::function<double(double)>& bound,
                   const StopToken& stop, DualTest& out) {
  double larger = std::max({10.0 * shift, first, 1e-16 * dual.spectral_bound()});
  while (!dual.positive_with(larger)) {
    if (stop.stop_requested() || !(larger < 10.0 * dual.spectral_bound())) return;
    larger *= 10.0;
  }
  out.negative = dual.smallest_eigenpair(larger);
  out.lower_bound = bound(larger);
  // A Ritz value is an upper bound on the eigenvalue and proves nothing, so a factor has to prove the bound.
  const double closer = -1.001 * out.negative.value;
  if (closer > shift && closer < larger && dual.positive_with(closer)) out.lower_bound = bound(closer);
  out.lost_in_rounding = -out.negative.value <= std::max(shift, dual.largest_rounding());
}

DualTest test(DualMatrix& dual, const ChordalProblem& problem, const LiftedPoses& X, double cost,
              const CertificateOptions& options, const StopToken& stop) {
  DualTest out;
  if (problem.negligible(X)) {  // no cost is below 0
    out.certified = out.negligible = true;
    return out;
  }
  dual.set(X);
  const double dimension = 3.0 * static_cast<double>(problem.poses());
  const auto bound = [&](double shift) {
    const double proven = 0.5 * (dual.trace_of_multipliers() - dimension * shift - dual.rounding());
    return std::min(cost, std::max(0.0, proven));
  };
  // The shift and rounding share the gap; 0.1 % remains for the rounding of the sums.
  const double gap = 2.0 * options.relative_gap * cost;
  out.lost_in_rounding = dual.rounding() > 0.5 * gap;
  const double shift = std::max(0.999 * gap - dual.rounding(), 0.5 * gap) / dimension;
  out.tolerance = shift + dual.largest_rounding();
  if (!dual.positive_with(shift)) {
    find_negative(dual, shift, 10.0 * dual.rounding() / dimension, bound, stop, out);
    return out;
  }
  out.lower_bound = bound(shift);
  // The factor proves a bound for any multipliers, but the bound is close only if X is critical and rounding
  // is small.
  out.certified = cost - out.lower_bound <= options.relative_gap * cost;
  return out;
}

/// X with one more row, moved along the eigenvector by the length with the lowest cost found.
LiftedPoses lifted_along(const ChordalProblem& problem, const LiftedPoses& X, const Eigen::VectorXd& v) {
  LiftedPoses base = LiftedPoses::Zero(X.rows() + 1, X.cols());
  base.topRows(X.rows()) = X;
  const double cost = problem.cost(X);
  double largest = 0.0;
  for (Eigen::Index at = 0; at < v.size(); at += 4) largest = std::max(largest, v.segment<3>(at).norm());
  LiftedPoses best = base;
  double lowest = cost;
  for (double length = 1.0 / largest; length * largest > 1e-6; length *= 0.5) {
    LiftedPoses moved = base;
    moved.bottomRows<1>() = length * v.transpose();
    orthonormalize(moved);
    const double moved_cost = problem.cost(moved);
    if (moved_cost < lowest) {
      lowest = moved_cost;
      best = std::move(moved);
    } else if (lowest < cost) {
      break;
    }
  }
  return best;
}

/// Poses near a point of higher rank: its three strongest directions, with each rotation projected to SO(3).
LiftedPoses rounded(const LiftedPoses& Y) {
  Eigen::MatrixXd rotations(Y.rows(), Y.cols() / 4 * 3);
  for (Eigen::Index i = 0; i < Y.cols() / 4; ++i) rotations.middleCols<3>(3 * i) = Y.middleCols<3>(4 * i);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(rotations * rotations.transpose());
  Eigen::MatrixXd directions = eigen.eigenvectors().rightCols<3>();
  LiftedPoses X = directions.transpose() * Y;
  Eigen::Index mirrored = 0;
  for (Eigen::Index at = 0; at < X.cols(); at += 4)
    mirrored += X.middleCols<3>(at).determinant() < 0.0 ? 1 : 0;
  if (2 * mirrored > X.cols() / 4) X.row(0) = -X.row(0).eval();
  for (Eigen::Index at = 0; at < X.cols(); at += 4) {
    const Eigen::Matrix3d block = X.middleCols<3>(at);
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(block, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Matrix3d u = svd.matrixU();
    if ((u * svd.matrixV().transpose()).determinant() < 0.0) u.col(2) = -u.col(2);
    X.middleCols<3>(at) = u * svd.matrixV().transpose();
  }
  return X;
}

/// Minimises from the poses near a point of higher rank and keeps them if they cost less. \returns whether
/// they are certified, which ends the search
bool round_back(DualMatrix& dual, const ChordalProblem& problem, const LiftedPoses& X,
                const CertificateOptions& options, const StopToken& stop, DualOutcome& out) {
  CriticalPoint back = descend(problem, rounded(X), options.max_steps, stop);
  out.steps += back.steps;
  if (back.cost >= (1.0 - options.relative_gap) * out.best_cost) return false;
  out.status = CertificateStatus::kImprovable;
  out.best = std::move(back.X);
  out.best_cost = back.cost;
  const DualTest at_poses = test(dual, problem, out.best, out.best_cost, options, stop);
  out.lower_bound = std::max(out.lower_bound, at_poses.lower_bound);
  return at_poses.certified;
}

/// Searches from a critical point that is not certified for poses of lower cost and for a better bound.
void climb(DualMatrix& dual, const ChordalProblem& problem, DualTest current,
           const CertificateOptions& options, const StopToken& stop, DualOutcome& out) {
  LiftedPoses X = out.critical.X;
  for (int rank = 4; rank <= options.max_rank && !out.relaxation_solved && !stop.stop_requested(); ++rank) {
    if (current.negative.vector.size() == 0 || current.negative.value >= 0.0) break;
    CriticalPoint point =
        descend(problem, lifted_along(problem, X, current.negative.vector), options.max_steps, stop);
    out.steps += point.steps;
    out.rank = rank;
    X = std::move(point.X);
    // To return to poses is cheap, and they are often optimal long before the relaxation is solved.
    out.relaxation_solved = round_back(dual, problem, X, options, stop, out);
    if (out.relaxation_solved) break;
    current = test(dual, problem, X, point.cost, options, stop);
    out.lower_bound = std::max(out.lower_bound, current.lower_bound);
    out.relaxation_solved = current.certified;
  }
}

}  // namespace

DualOutcome certify_component(const ChordalProblem& problem, const LiftedPoses& start,
                              const CertificateOptions& options, const StopToken& stop) {
  DualOutcome out;
  out.critical = descend(problem, start, options.max_steps, stop);
  out.steps = out.critical.steps;
  out.best = out.critical.X;
  out.best_cost = out.critical.cost;
  DualMatrix dual(problem);
  DualTest first = test(dual, problem, out.critical.X, out.critical.cost, options, stop);
  out.lower_bound = first.lower_bound;
  out.negligible = first.negligible;
  out.lost_in_rounding = first.lost_in_rounding;
  out.eigenvalue_tolerance = first.tolerance;
  if (first.certified) {
    out.status = CertificateStatus::kCertified;
    out.relaxation_solved = true;
    return out;
  }
  out.min_eigenvalue = first.negative.value;
  // A direction that may be caused by rounding is of no use.
  if (!first.lost_in_rounding) climb(dual, problem, std::move(first), options, stop, out);
  return out;
}

}  // namespace loopwise::detail
