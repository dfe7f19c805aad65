// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_ceres.hpp"

#include <memory>

#include <ceres/ceres.h>
#include <Eigen/Cholesky>

#include <loopwise/core/se3.hpp>

namespace loopwise::bench {
namespace {

using Block = Eigen::Matrix<double, 7, 1>;  // translation, quaternion x y z w

Eigen::Isometry3d to_pose(const double* p) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = Eigen::Map<const Eigen::Vector3d>(p);
  T.linear() = Eigen::Map<const Eigen::Quaterniond>(p + 3).toRotationMatrix();
  return T;
}

/// T ⊕ ξ = T·Exp(ξ). Cost functions give Jacobians in ξ, padded by a column of zeros: the manifold's own
/// Jacobian is then the identity above a row of zeros.
class RightPerturbation final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* delta, double* out) const override {
    const Eigen::Isometry3d T = to_pose(x) * se3::exp(Eigen::Map<const Vector6d>(delta));
    Eigen::Map<Block> moved(out);
    moved << T.translation(), Eigen::Quaterniond(T.linear()).normalized().coeffs();
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 7, 6, Eigen::RowMajor>> J(jacobian);
    J.setZero();
    J.topRows<6>().setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* out) const override {
    Eigen::Map<Vector6d> difference(out);
    difference = se3::log(to_pose(x).inverse() * to_pose(y));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 6, 7, Eigen::RowMajor>> J(jacobian);
    J.setZero();
    J.leftCols<6>().setIdentity();
    return true;
  }
};

using PaddedJacobian = Eigen::Map<Eigen::Matrix<double, 6, 7, Eigen::RowMajor>>;

class EdgeCost final : public ceres::SizedCostFunction<6, 7, 7> {
 public:
  explicit EdgeCost(const Edge& edge)
      : inverse_(edge.T_from_to.inverse()),
        root_(Eigen::LLT<Matrix6d>(edge.weight * edge.information).matrixU()) {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    const Eigen::Isometry3d a = to_pose(x[0]), b = to_pose(x[1]);
    const Vector6d r = se3::log(inverse_ * a.inverse() * b);
    Eigen::Map<Vector6d> whitened(residual);
    whitened.noalias() = root_ * r;
    if (jacobians == nullptr) return true;
    const Matrix6d J = root_ * se3::right_jacobian_inverse(r);
    if (jacobians[0] != nullptr) {
      PaddedJacobian out(jacobians[0]);
      out.leftCols<6>().noalias() = -J * se3::adjoint(b.inverse() * a);
      out.col(6).setZero();
    }
    if (jacobians[1] != nullptr) {
      PaddedJacobian out(jacobians[1]);
      out.leftCols<6>() = J;
      out.col(6).setZero();
    }
    return true;
  }

 private:
  Eigen::Isometry3d inverse_;
  Matrix6d root_;
};

class PriorCost final : public ceres::SizedCostFunction<6, 7> {
 public:
  explicit PriorCost(const PriorFactor& prior)
      : inverse_(prior.pose.inverse()), root_(Eigen::LLT<Matrix6d>(prior.information).matrixU()) {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    const Vector6d r = se3::log(inverse_ * to_pose(x[0]));
    Eigen::Map<Vector6d> whitened(residual);
    whitened.noalias() = root_ * r;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    PaddedJacobian out(jacobians[0]);
    out.leftCols<6>().noalias() = root_ * se3::right_jacobian_inverse(r);
    out.col(6).setZero();
    return true;
  }

 private:
  Eigen::Isometry3d inverse_;
  Matrix6d root_;
};

struct Model {
  std::vector<Block> blocks;
  RightPerturbation manifold;
  std::unique_ptr<ceres::Problem> problem;

  explicit Model(const PoseGraph& graph) {
    ceres::Problem::Options options;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem = std::make_unique<ceres::Problem>(options);
    for (const Node& node : graph.nodes()) {
      Block block;
      block << node.pose.translation(), Eigen::Quaterniond(node.pose.linear()).normalized().coeffs();
      blocks.push_back(block);
    }
    for (Block& block : blocks) problem->AddParameterBlock(block.data(), 7, &manifold);
    for (std::size_t e = 0; e < graph.edges().size(); ++e) {
      if (graph.edges()[e].weight <= 0.0) continue;
      problem->AddResidualBlock(new EdgeCost(graph.edges()[e]), nullptr, blocks[graph.ends(e).from].data(),
                                blocks[graph.ends(e).to].data());
    }
    for (const PriorFactor& prior : graph.priors()) {
      problem->AddResidualBlock(new PriorCost(prior), nullptr, blocks[graph.index_of(prior.key)].data());
    }
  }
};

}  // namespace

CeresOutcome ceres_optimize(const PoseGraph& graph) {
  Model model(graph);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-10;
  options.gradient_tolerance = 1e-12;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, model.problem.get(), &summary);
  CeresOutcome out;
  out.cost = summary.final_cost;
  out.iterations = static_cast<int>(summary.iterations.size());
  for (const Block& block : model.blocks) out.poses.push_back(to_pose(block.data()));
  return out;
}

double ceres_marginal_trace(const PoseGraph& graph) {
  Model model(graph);
  ceres::Covariance::Options options;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.algorithm_type = ceres::SPARSE_QR;
  options.num_threads = 1;
  ceres::Covariance covariance(options);
  std::vector<std::pair<const double*, const double*>> wanted;
  for (const Block& block : model.blocks) wanted.emplace_back(block.data(), block.data());
  if (!covariance.Compute(wanted, model.problem.get())) return -1.0;
  double trace = 0.0;
  for (const Block& block : model.blocks) {
    Eigen::Matrix<double, 6, 6, Eigen::RowMajor> m;
    if (!covariance.GetCovarianceBlockInTangentSpace(block.data(), block.data(), m.data())) return -1.0;
    trace += m.trace();
  }
  return trace;
}

}  // namespace loopwise::bench
