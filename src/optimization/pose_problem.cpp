// SPDX-License-Identifier: BSD-3-Clause
#include "pose_problem.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/auxiliary_factors.hpp>

namespace loopwise::detail {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Factors per task. The order of summation depends on this, so it affects the result.
constexpr std::size_t kFactorsPerTask = 256;
/// Number of tasks whose linearisations are in memory at the same time.
constexpr std::size_t kTasksPerWave = 64;

/// Adds the blocks and gradients of ranges and gravity.
/// \param hessian null for the gradient alone
void linearize_auxiliary(const PoseProblem& problem, const SystemStructure& structure,
                         const std::vector<Pose>& poses, BlockMatrix* hessian, Eigen::VectorXd& gradient) {
  const auto add = [&](std::uint32_t variable, const Matrix6d& H, const Vector6d& g) {
    if (hessian != nullptr) hessian->add(hessian->diagonal_slot(variable), H);
    gradient.segment<6>(6 * static_cast<Eigen::Index>(variable)) += g;
  };
  const std::vector<std::uint32_t>& variable = structure.freedom.variable;
  std::size_t pair = structure.first_range_pair;
  for (const PoseProblem::Ranging& range : problem.ranges()) {
    const std::uint32_t a = variable[range.from], b = variable[range.to];
    const LinearizedRange l =
        loopwise::linearize(range.factor, isometry(poses[range.from]), isometry(poses[range.to]));
    if (a != Freedom::kFixed) add(a, l.J_from.transpose() * l.J_from, l.J_from.transpose() * l.r);
    if (b != Freedom::kFixed) add(b, l.J_to.transpose() * l.J_to, l.J_to.transpose() * l.r);
    if (a == Freedom::kFixed || b == Freedom::kFixed) continue;
    if (hessian != nullptr) {
      hessian->add(hessian->pair_slot(pair), Matrix6d(l.J_to.transpose() * l.J_from));
    }
    ++pair;
  }
  for (const PoseProblem::Levelling& gravity : problem.gravities()) {
    const std::uint32_t v = variable[gravity.node];
    if (v == Freedom::kFixed) continue;
    const LinearizedGravity l = loopwise::linearize(gravity.factor, isometry(poses[gravity.node]));
    add(v, l.J.transpose() * l.J, l.J.transpose() * l.r);
  }
}

/// Sets the rows of z, roll and pitch to the identity. Nothing couples them to the plane, so the other rows
/// of H, its determinant and its pivots are those of the two-dimensional problem.
void pin_to_plane(BlockMatrix& hessian) {
  std::vector<double>& values = hessian.values();
  const auto set = [&](const BlockMatrix::Slot& slot, bool diagonal) {
    for (const int r : planar::kAcross) {
      for (const int c : planar::kAcross) {
        values[slot.offset + static_cast<std::size_t>(c) * slot.stride + static_cast<std::size_t>(r)] =
            diagonal && r == c ? 1.0 : 0.0;
      }
    }
  };
  for (std::size_t v = 0; v < hessian.variables(); ++v) set(hessian.diagonal_slot(v), true);
  for (std::size_t pair = 0; pair < hessian.pairs().size(); ++pair) set(hessian.pair_slot(pair), false);
}

}  // namespace

PoseProblem::PoseProblem(const PoseGraph& graph)
    : nodes_(graph.nodes().size()), edges_(graph.edges().size()), planar_(graph.planar()) {
  const std::size_t count = edges_ + graph.priors().size();
  from_.reserve(count);
  to_.reserve(count);
  inverse_.reserve(count);
  information_.reserve(count);
  weight.reserve(count);
  for (std::size_t k = 0; k < edges_; ++k) {
    const Edge& edge = graph.edges()[k];
    from_.push_back(static_cast<std::uint32_t>(graph.ends(k).from));
    to_.push_back(static_cast<std::uint32_t>(graph.ends(k).to));
    inverse_.push_back(inverse(edge.T_from_to));
    information_.push_back(edge.information);
    weight.push_back(edge.weight);
  }
  for (const PriorFactor& prior : graph.priors()) {
    from_.push_back(static_cast<std::uint32_t>(nodes_));
    to_.push_back(static_cast<std::uint32_t>(graph.index_of(prior.key)));
    inverse_.push_back(inverse(prior.pose));
    information_.push_back(prior.information);
    weight.push_back(1.0);
  }
  for (const RangeFactor& range : graph.ranges()) {
    ranges_.push_back({static_cast<std::uint32_t>(graph.index_of(range.from)),
                       static_cast<std::uint32_t>(graph.index_of(range.to)), range});
  }
  for (const GravityFactor& gravity : graph.gravities()) {
    gravities_.push_back({static_cast<std::uint32_t>(graph.index_of(gravity.key)), gravity});
  }
}

std::vector<Pose> PoseProblem::poses_of(const std::vector<Eigen::Isometry3d>& poses) const {
  std::vector<Pose> out(nodes_ + 1);
  for (std::size_t i = 0; i < nodes_; ++i) {
    // Rotations from files are rounded; normalisation makes R orthogonal and leaves orthogonal matrices
    // unchanged.
    const Matrix3d R = poses[i].linear();
    const bool orthogonal = (R.transpose() * R - Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-14;
    out[i].R = orthogonal ? R : Eigen::Quaterniond(R).normalized().toRotationMatrix();
    out[i].t = poses[i].translation();
  }
  return out;
}

std::vector<Eigen::Isometry3d> PoseProblem::isometries(const std::vector<Pose>& poses) const {
  std::vector<Eigen::Isometry3d> out(nodes_, Eigen::Isometry3d::Identity());
  for (std::size_t i = 0; i < nodes_; ++i) out[i] = isometry(poses[i]);
  return out;
}

Vector6d PoseProblem::residual(std::size_t k, const std::vector<Pose>& poses) const {
  return log_of_product(inverse_[k], between(poses[from_[k]], poses[to_[k]]));
}

double PoseProblem::squared_residual(std::size_t k, const std::vector<Pose>& poses) const {
  const Vector6d r = residual(k, poses);
  return r.dot(information_[k] * r);
}

double PoseProblem::auxiliary_cost(const std::vector<Pose>& poses) const {
  double sum = 0.0;
  for (const Ranging& range : ranges_) {
    const double r = linearize(range.factor, isometry(poses[range.from]), isometry(poses[range.to])).r;
    sum += r * r;
  }
  for (const Levelling& gravity : gravities_) {
    sum += linearize(gravity.factor, isometry(poses[gravity.node])).r.squaredNorm();
  }
  return 0.5 * sum;
}

double PoseProblem::cost(const std::vector<Pose>& poses, ThreadPool& pool,
                         std::vector<Vector6d>& residuals) const {
  residuals.resize(factors());
  const std::size_t tasks = (factors() + kFactorsPerTask - 1) / kFactorsPerTask;
  std::vector<double> sums(tasks, 0.0);
  pool.for_each(tasks, [&](std::size_t task) {
    const std::size_t end = std::min(factors(), (task + 1) * kFactorsPerTask);
    double sum = 0.0;
    for (std::size_t k = task * kFactorsPerTask; k < end; ++k) {
      if (weight[k] <= 0.0) continue;
      residuals[k] = residual(k, poses);
      sum += weight[k] * residuals[k].dot(information_[k] * residuals[k]);
    }
    sums[task] = sum;
  });
  return 0.5 * std::accumulate(sums.begin(), sums.end(), 0.0) + auxiliary_cost(poses);
}

Freedom find_freedom(const PoseProblem& problem) {
  const std::size_t n = problem.nodes();
  DisjointSets joined(n);  // by active factors; the fixed node is not included
  std::vector<char> touched(n, 0), anchored(n, 0);
  for (std::size_t k = 0; k < problem.factors(); ++k) {
    if (problem.weight[k] <= 0.0) continue;
    touched[problem.to(k)] = 1;
    if (problem.from(k) == n) continue;
    touched[problem.from(k)] = 1;
    joined.join(problem.from(k), problem.to(k));
  }
  for (std::size_t k = problem.edges(); k < problem.factors(); ++k) anchored[joined.root(problem.to(k))] = 1;

  Freedom freedom;
  freedom.variable.assign(n + 1, Freedom::kFixed);
  freedom.component.assign(n, Freedom::kFixed);
  for (std::uint32_t i = 0; i < n; ++i) {
    if (touched[i] == 0) continue;
    freedom.component[i] = joined.root(i);
    if (freedom.component[i] == i && anchored[i] == 0) {
      freedom.held.push_back(i);
      continue;
    }
    freedom.variable[i] = static_cast<std::uint32_t>(freedom.nodes.size());
    freedom.nodes.push_back(i);
  }
  return freedom;
}

SystemStructure::SystemStructure(const PoseProblem& problem) : freedom(find_freedom(problem)) {
  for (std::size_t k = 0; k < problem.factors(); ++k) {
    if (problem.weight[k] <= 0.0) continue;
    const std::uint32_t a = freedom.variable[problem.from(k)], b = freedom.variable[problem.to(k)];
    if (a == Freedom::kFixed && b == Freedom::kFixed) continue;
    active.push_back(static_cast<std::uint32_t>(k));
    if (a == Freedom::kFixed || b == Freedom::kFixed) {
      pair_of.push_back(Freedom::kFixed);
    } else {
      pair_of.push_back(static_cast<std::uint32_t>(pairs.size()));
      pairs.emplace_back(b, a);
    }
  }
  first_range_pair = pairs.size();
  for (const PoseProblem::Ranging& range : problem.ranges()) {
    const std::uint32_t a = freedom.variable[range.from], b = freedom.variable[range.to];
    if (a != Freedom::kFixed && b != Freedom::kFixed) pairs.emplace_back(b, a);
  }
}

void linearize(const PoseProblem& problem, const SystemStructure& structure, const std::vector<Pose>& poses,
               const std::vector<Vector6d>& residuals, ThreadPool& pool, BlockMatrix& hessian,
               Eigen::VectorXd& gradient) {
  hessian.set_zero();
  gradient.setZero();
  const std::vector<std::uint32_t>& active = structure.active;
  const std::size_t wave = kFactorsPerTask * (pool.num_threads() > 1 ? kTasksPerWave : 1);
  std::vector<Contribution> buffer(std::min(wave, active.size()));
  const auto variables = static_cast<std::uint32_t>(structure.freedom.nodes.size());
  const auto owners = static_cast<std::uint32_t>(pool.num_threads());
  const std::vector<std::uint32_t>& variable = structure.freedom.variable;

  for (std::size_t begin = 0; begin < active.size(); begin += wave) {
    const std::size_t end = std::min(active.size(), begin + wave);
    const std::size_t tasks = (end - begin + kFactorsPerTask - 1) / kFactorsPerTask;
    pool.for_each(tasks, [&](std::size_t task) {
      const std::size_t stop = std::min(end, begin + (task + 1) * kFactorsPerTask);
      for (std::size_t i = begin + task * kFactorsPerTask; i < stop; ++i) {
        const std::size_t k = active[i];
        const Pose e = between(poses[problem.to(k)], poses[problem.from(k)]);
        linearize_factor(residuals[k], e, problem.information(k), problem.weight[k],
                         variable[problem.from(k)] != Freedom::kFixed, buffer[i - begin]);
      }
    });
    // Every owner adds to its own columns in the order of the factors, so the sums equal those of one thread.
    pool.for_each(owners, [&](std::size_t owner) {
      const auto first = static_cast<std::uint32_t>(std::uint64_t{variables} * owner / owners);
      const auto last = static_cast<std::uint32_t>(std::uint64_t{variables} * (owner + 1) / owners);
      const auto mine = [&](std::uint32_t column) { return column >= first && column < last; };
      for (std::size_t i = begin; i < end; ++i) {
        const std::size_t k = active[i];
        const Contribution& c = buffer[i - begin];
        const std::uint32_t from = variable[problem.from(k)], to = variable[problem.to(k)];
        if (to != Freedom::kFixed && mine(hessian.position(to))) {
          hessian.add(hessian.diagonal_slot(to), c.to_to);
          gradient.segment<6>(6 * static_cast<Eigen::Index>(to)) += c.g_to;
        }
        if (from != Freedom::kFixed && mine(hessian.position(from))) {
          hessian.add(hessian.diagonal_slot(from), c.from_from);
          gradient.segment<6>(6 * static_cast<Eigen::Index>(from)) += c.g_from;
        }
        const std::uint32_t pair = structure.pair_of[i];
        if (pair != Freedom::kFixed && mine(hessian.pair_column(pair))) {
          hessian.add(hessian.pair_slot(pair), c.to_from);
        }
      }
    });
  }
  linearize_auxiliary(problem, structure, poses, &hessian, gradient);
  if (problem.planar()) pin_to_plane(hessian);
}

void NormalEquations::set_structure(const PoseProblem& problem) {
  SystemStructure structure(problem);
  const bool same = analysed_ && structure.pairs == structure_.pairs &&
                    structure.freedom.nodes.size() == cholesky_.variables();
  structure_ = std::move(structure);
  if (same) return;
  analysed_ = false;  // if an allocation fails below, the next call starts again
  const std::size_t variables = structure_.freedom.nodes.size();
  cholesky_.analyze(variables, structure_.pairs);
  // Not by resize(): Eigen frees the old memory first and keeps its pointer if the new allocation fails.
  gradient_ = Eigen::VectorXd(Eigen::VectorXd::Zero(static_cast<Eigen::Index>(6 * variables)));
  analysed_ = true;
  ++analyses_;
}

void NormalEquations::linearize(const PoseProblem& problem, const std::vector<Pose>& poses,
                                const std::vector<Vector6d>& residuals, ThreadPool& pool) {
  detail::linearize(problem, structure_, poses, residuals, pool, cholesky_.matrix(), gradient_);
}

void NormalEquations::linearize_gradient(const PoseProblem& problem, const std::vector<Pose>& poses,
                                         const std::vector<Vector6d>& residuals) {
  gradient_.setZero();
  const std::vector<std::uint32_t>& variable = structure_.freedom.variable;
  for (const std::size_t k : structure_.active) {
    const std::uint32_t from = variable[problem.from(k)], to = variable[problem.to(k)];
    const Pose e = between(poses[problem.to(k)], poses[problem.from(k)]);
    const FactorGradient g = factor_gradient(residuals[k], e, problem.information(k), problem.weight[k]);
    if (to != Freedom::kFixed) gradient_.segment<6>(6 * static_cast<Eigen::Index>(to)) += g.to;
    if (from != Freedom::kFixed) gradient_.segment<6>(6 * static_cast<Eigen::Index>(from)) += g.from;
  }
  linearize_auxiliary(problem, structure_, poses, nullptr, gradient_);
}

std::vector<Pose> NormalEquations::moved(const std::vector<Pose>& poses, const Eigen::VectorXd& step) const {
  std::vector<Pose> out = poses;
  const std::vector<std::uint32_t>& nodes = structure_.freedom.nodes;
  for (std::size_t v = 0; v < nodes.size(); ++v) {
    const auto xi = step.segment<6>(6 * static_cast<Eigen::Index>(v));
    Pose& pose = out[nodes[v]];
    pose = moved_by(pose, xi);
  }
  return out;
}

}  // namespace loopwise::detail
