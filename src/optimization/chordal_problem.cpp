// SPDX-License-Identifier: BSD-3-Clause
#include "chordal_problem.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Dense>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise::detail {
namespace {

constexpr int kMaxRank = 6;

/// Vectors of a pose's 4p entries as columns, one for each of its 4p − 6 degrees of freedom.
using Basis = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 4 * kMaxRank, 4 * kMaxRank - 6>;

/// Tangent directions at a pose: R[e_k]×, directions orthogonal to the span of R, and the translation.
Basis tangent_basis(const Eigen::Ref<const Eigen::MatrixXd>& pose) {
  const Eigen::Index p = pose.rows();
  Basis basis = Basis::Zero(4 * p, 4 * p - 6);
  const Eigen::MatrixXd R = pose.leftCols<3>();
  Eigen::Index at = 0;
  for (int k = 0; k < 3; ++k, ++at) {
    const Eigen::MatrixXd turned = R * se3::skew(Eigen::Vector3d::Unit(k));
    for (int c = 0; c < 3; ++c) basis.col(at).segment(c * p, p) = turned.col(c);
  }
  if (p > 3) {
    const Eigen::MatrixXd complement =
        Eigen::MatrixXd(R.householderQr().householderQ() * Eigen::MatrixXd::Identity(p, p)).rightCols(p - 3);
    for (Eigen::Index m = 0; m < p - 3; ++m) {
      for (int c = 0; c < 3; ++c) basis.col(at++).segment(c * p, p) = complement.col(m);
    }
  }
  for (Eigen::Index m = 0; m < p; ++m) basis(3 * p + m, at++) = 1.0;
  return basis;
}

/// The Hessian of the cost in tangent coordinates of all poses but the first: S between tangent directions.
class NewtonSystem {
 public:
  NewtonSystem(const ChordalProblem& problem, Eigen::Index rank)
      : problem_(problem),
        width_(static_cast<int>(4 * rank - 6)),
        hessian_(width_, Factorization::kAutomatic),
        basis_(problem.poses()) {
    std::vector<BlockCholesky::Pair> pairs;
    for (const ChordalTerm& term : problem.terms()) {
      if (term.from != 0 && term.to != 0) pairs.emplace_back(term.from - 1, term.to - 1);
    }
    hessian_.analyze(problem.poses() - 1, pairs);
    damping_.resize(static_cast<Eigen::Index>(hessian_.variables()) * width_);
  }

  /// Computes the system at X, with G = X Q.
  void linearize(const LiftedPoses& X, const LiftedPoses& G) {
    const Eigen::Index p = X.rows();
    for (std::size_t i = 0; i < basis_.size(); ++i) {
      basis_[i] = tangent_basis(X.middleCols(4 * static_cast<Eigen::Index>(i), 4));
    }
    gradient_.resize(damping_.size());
    for (std::size_t i = 1; i < basis_.size(); ++i) {
      const Eigen::MatrixXd g = G.middleCols(4 * static_cast<Eigen::Index>(i), 4);
      const Eigen::Map<const Eigen::VectorXd> flat(g.data(), 4 * p);
      gradient_.segment(row(i), width_) = basis_[i].transpose() * flat;
    }
    hessian_.matrix().set_zero();
    std::size_t pair = 0;
    problem_.dual_blocks(
        problem_.multipliers(X, G),
        [&](std::size_t i, const Eigen::Matrix4d& block) {
          if (i == 0) return;
          add(hessian_.matrix().diagonal_slot(i - 1), between(i, i, block, p));
          // Possibly no term depends on the rotation (a point landmark) or on the position.
          const double turn = problem_.scale()[i], shift = block(3, 3);
          damping_.segment(row(i), width_ - p).setConstant(turn > 0.0 ? turn : 1.0);
          damping_.segment(row(i + 1) - p, p).setConstant(shift > 0.0 ? shift : 1.0);
        },
        [&](std::size_t k, const Eigen::Matrix4d& block) {
          const ChordalTerm& term = problem_.terms()[k];
          if (term.from == 0 || term.to == 0) return;
          add(hessian_.matrix().pair_slot(pair++), between(term.from, term.to, block, p));
        });
    diagonal_ = hessian_.matrix().diagonal();
  }

  [[nodiscard]] const Eigen::VectorXd& gradient() const { return gradient_; }

  /// (H + damping·D)⁻¹ (−g), or nothing if that matrix is not positive definite.
  [[nodiscard]] bool step(double damping, Eigen::VectorXd& out) {
    hessian_.matrix().set_diagonal(diagonal_ + damping * damping_);
    if (!hessian_.factorize() || !(hessian_.smallest_pivot().first > 0.0)) return false;
    out = -gradient_;
    hessian_.solve(out);
    return out.allFinite();
  }

  [[nodiscard]] LiftedPoses moved(const LiftedPoses& X, const Eigen::VectorXd& step) const {
    LiftedPoses out = X;
    const Eigen::Index p = X.rows();
    for (std::size_t i = 1; i < basis_.size(); ++i) {
      const Eigen::VectorXd change = basis_[i] * step.segment(row(i), width_);
      out.middleCols(4 * static_cast<Eigen::Index>(i), 4) +=
          Eigen::Map<const Eigen::MatrixXd>(change.data(), p, 4);
    }
    orthonormalize(out);
    return out;
  }

 private:
  [[nodiscard]] Eigen::Index row(std::size_t pose) const {
    return (static_cast<Eigen::Index>(pose) - 1) * width_;
  }

  /// tr(B_k S_ij C_lᵀ) over the tangent directions B of pose i and C of pose j.
  [[nodiscard]] Eigen::MatrixXd between(std::size_t i, std::size_t j, const Eigen::Matrix4d& block,
                                        Eigen::Index p) const {
    Basis carried(4 * p, width_);
    for (int r = 0; r < 4; ++r) {
      auto rows = carried.middleRows(r * p, p);
      rows.setZero();
      for (int c = 0; c < 4; ++c) {
        if (block(r, c) != 0.0) rows += block(r, c) * basis_[j].middleRows(c * p, p);
      }
    }
    return basis_[i].transpose() * carried;
  }

  void add(const BlockCholesky::Slot& slot, const Eigen::MatrixXd& m) { hessian_.matrix().add(slot, m); }

  const ChordalProblem& problem_;
  int width_;
  BlockCholesky hessian_;
  std::vector<Basis> basis_;
  Eigen::VectorXd gradient_, diagonal_, damping_;
};

}  // namespace

ChordalProblem::ChordalProblem(std::size_t poses, std::vector<ChordalTerm> terms)
    : poses_(poses), terms_(std::move(terms)), diagonal_(poses, Eigen::Matrix4d::Zero()), scale_(poses) {
  DisjointSets joined(poses);
  for (const ChordalTerm& term : terms_) {
    const Eigen::Vector4d w(term.kappa, term.kappa, term.kappa, term.tau);
    diagonal_[term.from] += term.measured * w.asDiagonal() * term.measured.transpose();
    diagonal_[term.to].diagonal() += w;
    if (term.tau > 0.0) joined.join(term.from, term.to);
  }
  parts_.resize(poses);
  std::vector<std::uint32_t> number(poses, UINT32_MAX);
  std::uint32_t count = 0;
  for (std::size_t i = 0; i < poses; ++i) {
    scale_[i] = diagonal_[i].topLeftCorner<3, 3>().trace() / 3.0;
    std::uint32_t& part = number[joined.root(i)];
    if (part == UINT32_MAX) part = count++;
    parts_[i] = part;
  }
}

std::vector<BlockCholesky::Pair> ChordalProblem::pairs() const {
  std::vector<BlockCholesky::Pair> out;
  out.reserve(terms_.size());
  for (const ChordalTerm& term : terms_) out.emplace_back(term.from, term.to);
  return out;
}

double ChordalProblem::cost(const LiftedPoses& X) const {
  double sum = 0.0;
  for (const ChordalTerm& term : terms_) {
    const auto from = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.from));
    const auto to = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.to));
    const Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRank, 4> error = to - from * term.measured;
    sum += term.kappa * error.leftCols<3>().squaredNorm() + term.tau * error.col(3).squaredNorm();
  }
  return 0.5 * sum;
}

bool ChordalProblem::negligible(const LiftedPoses& X) const {
  constexpr double kSquared = 1e-20;
  return std::all_of(terms_.begin(), terms_.end(), [&](const ChordalTerm& term) {
    const auto from = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.from));
    const auto to = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.to));
    const Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRank, 4> error = to - from * term.measured;
    const double length =
        from.col(3).squaredNorm() + to.col(3).squaredNorm() + term.measured.col(3).head<3>().squaredNorm();
    return (term.kappa == 0.0 || error.leftCols<3>().squaredNorm() <= 3.0 * kSquared) &&
           (term.tau == 0.0 || error.col(3).squaredNorm() <= kSquared * length);
  });
}

LiftedPoses ChordalProblem::gradient(const LiftedPoses& X) const {
  LiftedPoses G = LiftedPoses::Zero(X.rows(), X.cols());
  for (const ChordalTerm& term : terms_) {
    const auto from = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.from));
    const auto to = X.middleCols<4>(4 * static_cast<Eigen::Index>(term.to));
    Eigen::Matrix<double, Eigen::Dynamic, 4, 0, kMaxRank, 4> error = to - from * term.measured;
    error.leftCols<3>() *= term.kappa;
    error.col(3) *= term.tau;
    G.middleCols<4>(4 * static_cast<Eigen::Index>(term.to)) += error;
    G.middleCols<4>(4 * static_cast<Eigen::Index>(term.from)) -= error * term.measured.transpose();
  }
  return G;
}

std::vector<Eigen::Matrix3d> ChordalProblem::multipliers(const LiftedPoses& X, const LiftedPoses& G) const {
  std::vector<Eigen::Matrix3d> out(poses_);
  for (std::size_t i = 0; i < poses_; ++i) {
    const auto at = 4 * static_cast<Eigen::Index>(i);
    const Eigen::Matrix3d m = X.middleCols<3>(at).transpose() * G.middleCols<3>(at);
    out[i] = 0.5 * (m + m.transpose());
  }
  return out;
}

void orthonormalize(LiftedPoses& X) {
  for (Eigen::Index at = 0; at < X.cols(); at += 4) {
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(X.middleCols<3>(at),
                                                Eigen::ComputeThinU | Eigen::ComputeThinV);
    X.middleCols<3>(at) = svd.matrixU() * svd.matrixV().transpose();
  }
}

CriticalPoint descend(const ChordalProblem& problem, LiftedPoses X, int max_steps, const StopToken& stop) {
  // Avoids a singular matrix if no term depends on a direction, such as the rotation of a point landmark.
  constexpr double kLeastDamping = 1e-12, kRaisedDamping = 1e-6, kMostDamping = 1e6;
  // A decrease below this share of the cost is lost in rounding; the descent then compares gradients.
  constexpr double kVisible = 1e-11;
  CriticalPoint out;
  NewtonSystem system(problem, X.rows());
  double cost = problem.cost(X);
  LiftedPoses G = problem.gradient(X);
  system.linearize(X, G);
  double gradient = system.gradient().lpNorm<Eigen::Infinity>();
  double damping = kLeastDamping;
  bool raised = false;  // since the last step; smaller damping is then not tried at once
  const auto raise = [&] {
    raised = true;
    damping = std::max(10.0 * damping, kRaisedDamping);
    return damping <= kMostDamping;
  };
  Eigen::VectorXd step;
  while (out.steps < max_steps && !stop.stop_requested()) {
    if (gradient == 0.0) break;
    if (!system.step(damping, step)) {
      if (!raise()) break;
      continue;
    }
    ++out.steps;
    LiftedPoses next = system.moved(X, step);
    const double next_cost = problem.cost(next);
    const double predicted = -0.5 * step.dot(system.gradient());
    const bool visible = predicted > kVisible * cost && !problem.negligible(X);
    if (visible && !(next_cost < cost)) {
      if (!raise()) break;
      continue;
    }
    LiftedPoses next_G = problem.gradient(next);
    system.linearize(next, next_G);
    const double next_gradient = system.gradient().lpNorm<Eigen::Infinity>();
    out.converged = !visible && !(next_gradient < 0.5 * gradient);
    if (out.converged && next_gradient >= gradient) break;
    X = std::move(next);
    G = std::move(next_G);
    cost = next_cost;
    gradient = next_gradient;
    if (out.converged) break;
    if (!raised) damping = 0.1 * damping < kRaisedDamping ? kLeastDamping : 0.1 * damping;
    raised = false;
  }
  out.converged = out.converged || gradient == 0.0;
  out.X = std::move(X);
  out.cost = cost;
  out.gradient = gradient;
  return out;
}

}  // namespace loopwise::detail
