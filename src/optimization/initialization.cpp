// SPDX-License-Identifier: BSD-3-Clause
#include "initialization.hpp"

#include <algorithm>
#include <cmath>
#include <deque>

#include <Eigen/SVD>

#include <loopwise/core/planar.hpp>

#include "minimize.hpp"

namespace loopwise {
namespace detail {
namespace {

/// Chains poses along edges from the known nodes, then from priors, then from the first remaining node.
std::vector<Eigen::Isometry3d> chain(const PoseGraph& graph, std::vector<Eigen::Isometry3d> poses,
                                     std::vector<char> known) {
  std::deque<std::size_t> fresh;
  // Closures are followed only after the odometry from all known nodes.
  std::deque<std::pair<std::size_t, std::size_t>> closures;  // edge, known end
  const auto place = [&](std::size_t node, const Eigen::Isometry3d& pose) {
    poses[node] = se3::normalized(pose);
    known[node] = 1;
    fresh.push_back(node);
  };
  const auto follow = [&](std::size_t e, std::size_t node) {
    const Edge& edge = graph.edges()[e];
    const auto ends = graph.ends(e);
    const bool forward = ends.from == node;
    const std::size_t other = forward ? ends.to : ends.from;
    if (known[other] == 0) place(other, poses[node] * (forward ? edge.T_from_to : edge.T_from_to.inverse()));
  };
  const auto spread = [&] {
    while (!fresh.empty() || !closures.empty()) {
      if (fresh.empty()) {
        const auto [e, node] = closures.front();
        closures.pop_front();
        follow(e, node);
        continue;
      }
      const std::size_t node = fresh.front();
      fresh.pop_front();
      for (const std::size_t e : graph.edges_of(node)) {
        const Edge& edge = graph.edges()[e];
        if (edge.weight <= 0.0) continue;
        if (edge.kind == EdgeKind::kOdometry) {
          follow(e, node);
        } else {
          closures.emplace_back(e, node);
        }
      }
    }
  };
  for (std::size_t node = 0; node < poses.size(); ++node) {
    if (known[node] != 0) fresh.push_back(node);
  }
  spread();
  for (const PriorFactor& prior : graph.priors()) {
    const std::size_t node = graph.index_of(prior.key);
    if (known[node] == 0) place(node, prior.pose);
  }
  spread();
  for (std::size_t node = 0; node < poses.size(); ++node) {
    if (known[node] != 0) continue;
    place(node, poses[node]);
    spread();
  }
  return poses;
}

/// Nearest rotation in the Frobenius norm.
Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& m) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  if ((u * svd.matrixV().transpose()).determinant() < 0.0) u.col(2) = -u.col(2);
  return u * svd.matrixV().transpose();
}

/// The chordal relaxation (Martinec and Pajdla, CVPR 2007; Carlone et al., ICRA 2015, §IV-B). Let y_i be the
/// stacked columns of R_iᵀ; every edge requires y_to = Zᵀ y_from. This is one linear system of 3×3 blocks
/// with three right-hand sides; its solutions are projected on SO(3). A second linear system gives the
/// translations.
class Chordal {
 public:
  Chordal(const PoseProblem& problem, const OptimizerOptions& options)
      : problem_(problem), freedom_(find_freedom(problem)), cholesky_(3, options.factorization) {
    std::vector<BlockCholesky::Pair> pairs;
    for (std::size_t k = 0; k < problem.factors(); ++k) {
      const std::uint32_t a = variable(problem.from(k)), b = variable(problem.to(k));
      if (problem.weight[k] <= 0.0 || a == Freedom::kFixed || b == Freedom::kFixed) continue;
      pairs.emplace_back(b, a);
    }
    cholesky_.analyze(freedom_.nodes.size(), pairs);
  }

  bool solve(std::vector<Eigen::Isometry3d>& poses, int& factorizations) {
    return freedom_.nodes.empty() ||
           (rotations(poses, factorizations) && translations(poses, factorizations));
  }

 private:
  [[nodiscard]] std::uint32_t variable(std::uint32_t node) const { return freedom_.variable[node]; }

  void add(const BlockCholesky::Slot& slot, const Eigen::Matrix3d& m) { cholesky_.matrix().add(slot, m); }

  template <class Body>
  void each_factor(Body&& body) {
    std::size_t pair = 0;
    for (std::size_t k = 0; k < problem_.factors(); ++k) {
      if (problem_.weight[k] <= 0.0) continue;
      const std::uint32_t a = variable(problem_.from(k)), b = variable(problem_.to(k));
      if (a == Freedom::kFixed && b == Freedom::kFixed) continue;
      const bool both = a != Freedom::kFixed && b != Freedom::kFixed;
      body(k, a, b, both ? &cholesky_.matrix().pair_slot(pair++) : nullptr);
    }
  }

  bool rotations(std::vector<Eigen::Isometry3d>& poses, int& factorizations) {
    cholesky_.matrix().set_zero();
    const auto n = static_cast<Eigen::Index>(freedom_.nodes.size());
    Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(3 * n, 3);
    each_factor([&](std::size_t k, std::uint32_t a, std::uint32_t b, const BlockCholesky::Slot* slot) {
      const Eigen::Matrix3d Zt = problem_.inverse_measurement(k).R;  // of the measured rotation
      const double w = problem_.weight[k] * problem_.information(k).bottomRightCorner<3, 3>().trace() / 3.0;
      const Eigen::Matrix3d wI = w * Eigen::Matrix3d::Identity();
      if (b != Freedom::kFixed) add(cholesky_.matrix().diagonal_slot(b), wI);
      if (a != Freedom::kFixed) add(cholesky_.matrix().diagonal_slot(a), wI);
      if (slot != nullptr) {
        add(*slot, -w * Zt);
      } else if (a == Freedom::kFixed) {
        rhs.middleRows<3>(3 * b) += w * Zt * fixed_rotation(poses, problem_.from(k)).transpose();
      } else {
        rhs.middleRows<3>(3 * a) += w * Zt.transpose() * fixed_rotation(poses, problem_.to(k)).transpose();
      }
    });
    ++factorizations;
    if (!cholesky_.factorize() || cholesky_.smallest_pivot().first < kSingularPivot) return false;
    cholesky_.solve(rhs);
    for (Eigen::Index v = 0; v < n; ++v) {
      const Eigen::Matrix3d m = rhs.middleRows<3>(3 * v).transpose();
      if (!m.allFinite()) return false;
      poses[freedom_.nodes[static_cast<std::size_t>(v)]].linear() = nearest_rotation(m);
    }
    return true;
  }

  bool translations(std::vector<Eigen::Isometry3d>& poses, int& factorizations) {
    cholesky_.matrix().set_zero();
    const auto n = static_cast<Eigen::Index>(freedom_.nodes.size());
    Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(3 * n, 1);
    each_factor([&](std::size_t k, std::uint32_t a, std::uint32_t b, const BlockCholesky::Slot* slot) {
      const Pose& inverse = problem_.inverse_measurement(k);
      const Eigen::Matrix3d R = fixed_rotation(poses, problem_.from(k));
      const Eigen::Vector3d d = R * -(inverse.R.transpose() * inverse.t);  // measured t_to − t_from
      const Eigen::Matrix3d w = problem_.weight[k] * problem_.information(k).topLeftCorner<3, 3>().trace() /
                                3.0 * Eigen::Matrix3d::Identity();
      if (b != Freedom::kFixed) {
        add(cholesky_.matrix().diagonal_slot(b), w);
        rhs.middleRows<3>(3 * b) +=
            w * (a == Freedom::kFixed ? Eigen::Vector3d(fixed_place(poses, problem_.from(k)) + d) : d);
      }
      if (a != Freedom::kFixed) {
        add(cholesky_.matrix().diagonal_slot(a), w);
        rhs.middleRows<3>(3 * a) +=
            w * (b == Freedom::kFixed ? Eigen::Vector3d(fixed_place(poses, problem_.to(k)) - d)
                                      : Eigen::Vector3d(-d));
      }
      if (slot != nullptr) add(*slot, -w);
    });
    ++factorizations;
    if (!cholesky_.factorize() || cholesky_.smallest_pivot().first < kSingularPivot) return false;
    cholesky_.solve(rhs);
    if (!rhs.allFinite()) return false;
    for (Eigen::Index v = 0; v < n; ++v) {
      poses[freedom_.nodes[static_cast<std::size_t>(v)]].translation() = rhs.middleRows<3>(3 * v);
    }
    return true;
  }

  [[nodiscard]] Eigen::Matrix3d fixed_rotation(const std::vector<Eigen::Isometry3d>& poses,
                                               std::uint32_t node) const {
    return node == problem_.nodes() ? Eigen::Matrix3d::Identity() : Eigen::Matrix3d(poses[node].linear());
  }
  [[nodiscard]] Eigen::Vector3d fixed_place(const std::vector<Eigen::Isometry3d>& poses,
                                            std::uint32_t node) const {
    return node == problem_.nodes() ? Eigen::Vector3d::Zero() : Eigen::Vector3d(poses[node].translation());
  }

  const PoseProblem& problem_;
  Freedom freedom_;
  BlockCholesky cholesky_;
};

}  // namespace

std::vector<Eigen::Isometry3d> extended(const PoseGraph& graph, std::vector<Eigen::Isometry3d> poses,
                                        std::vector<char> known) {
  return chain(graph, std::move(poses), std::move(known));
}

std::vector<Pose> first_estimate(Initialization kind, const PoseGraph& graph, const PoseProblem& problem,
                                 const OptimizerOptions& options, int& factorizations) {
  const auto chained = [&] {
    return problem.poses_of(chain(graph, graph.poses(), std::vector<char>(graph.nodes().size(), 0)));
  };
  if (kind == Initialization::kOdometry) return chained();
  if (kind != Initialization::kChordal) return problem.poses_of(graph.poses());
  std::vector<Eigen::Isometry3d> poses = graph.poses();
  if (Chordal(problem, options).solve(poses, factorizations)) {
    if (graph.planar()) std::transform(poses.begin(), poses.end(), poses.begin(), planar::flattened);
    return problem.poses_of(poses);
  }
  return chained();  // without information on rotation or translation there is no linear system
}

std::vector<FirstEstimate> ranked_estimates(const PoseGraph& graph, const PoseProblem& problem,
                                            const OptimizerOptions& options, bool chordal,
                                            const std::function<double(const std::vector<Pose>&)>& cost,
                                            int& factorizations) {
  // Noise alone costs half of the redundant degrees of freedom. From a few times this cost, descent reaches
  // the minimum.
  constexpr double kGoodStart = 4.0;
  const double redundant = graph.degrees_of_freedom() *
                           (static_cast<double>(problem.factors()) - static_cast<double>(problem.nodes()));
  std::vector<FirstEstimate> out;
  const auto add = [&](Initialization kind) {
    FirstEstimate estimate{kind, first_estimate(kind, graph, problem, options, factorizations), 0.0};
    estimate.cost = cost(estimate.poses);
    if (!out.empty() && !std::isfinite(out.front().cost)) out.clear();
    if (std::isfinite(estimate.cost) || out.empty()) out.push_back(std::move(estimate));
  };
  add(Initialization::kFile);
  if (out.front().cost <= kGoodStart * 0.5 * std::max(redundant, 1.0)) return out;
  add(Initialization::kOdometry);
  if (chordal) add(Initialization::kChordal);
  std::stable_sort(out.begin(), out.end(),
                   [](const FirstEstimate& a, const FirstEstimate& b) { return a.cost < b.cost; });
  return out;
}

}  // namespace detail

std::vector<Eigen::Isometry3d> initial_poses(const PoseGraph& graph, Initialization initialization) {
  const detail::PoseProblem problem(graph);
  const OptimizerOptions options;
  int factorizations = 0;
  if (initialization != Initialization::kAuto) {
    return problem.isometries(
        detail::first_estimate(initialization, graph, problem, options, factorizations));
  }
  ThreadPool pool(1);
  std::vector<Vector6d> residuals;
  const auto cost = [&](const std::vector<detail::Pose>& poses) {
    return problem.cost(poses, pool, residuals);
  };
  return problem.isometries(
      detail::ranked_estimates(graph, problem, options, true, cost, factorizations).front().poses);
}

}  // namespace loopwise
