// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/marginals.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include <Eigen/Dense>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>

#include "linalg/blas_threads.hpp"
#include "linalg/selected_inverse.hpp"
#include "pose_problem.hpp"

namespace loopwise {
namespace {

constexpr std::uint32_t kHeld = detail::Freedom::kFixed;
/// From this number of pairs on, one selected inversion costs less than columns of the inverse.
constexpr std::size_t kManyPairs = 32;

void add_traces(Marginals& m) {
  m.trace_translation = m.trace_full = 0.0;
  for (const Matrix6d& covariance : m.covariances) {
    m.trace_translation += covariance.topLeftCorner<3, 3>().trace();
    m.trace_full += covariance.trace();
  }
}

/// A with AᵀA = m; m may be semi-definite.
Matrix6d square_root(const Matrix6d& m) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(m);
  return solver.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal() * solver.eigenvectors().transpose();
}

}  // namespace

struct HessianFactor::Impl {
  std::vector<Eigen::Isometry3d> poses;
  std::vector<std::pair<Key, std::size_t>> keys;  // sorted, with node numbers
  std::vector<std::uint32_t> variable;            // by node
  std::vector<std::uint32_t> position;            // by variable, in elimination order
  detail::Panels panels;
  Eigen::Index free_dimension = 0;
  Factorization factorization = Factorization::kMultifrontal;
  double nonzeros = 0.0;
  double log_determinant = 0.0;
  bool planar = false;

  [[nodiscard]] Eigen::Index row(std::size_t node) const {
    return 6 * static_cast<Eigen::Index>(position[variable[node]]);
  }
  [[nodiscard]] bool held(std::size_t node) const { return variable[node] == kHeld; }
  void require_node(std::size_t node) const {
    if (node < variable.size()) return;
    throw InputError("node number " + std::to_string(node) + " is not in the graph, which has " +
                     std::to_string(variable.size()) + " nodes, numbered from 0");
  }

  [[nodiscard]] std::size_t index_of(Key key) const {
    const auto found = std::lower_bound(keys.begin(), keys.end(), std::pair<Key, std::size_t>(key, 0));
    if (found == keys.end() || found->first != key) {
      throw UnknownKeyError("node " + key_name(key) + " is not in the graph");
    }
    return found->second;
  }

  /// Solves with the factor. In a planar graph z, roll and pitch are known exactly.
  template <class Solve>
  void solve_with(Solve&& solve, Eigen::MatrixXd& x) const {
    solve(panels, x);
    if (!planar) return;
    for (Eigen::Index row = 0; row < x.rows(); row += 6) {
      for (const int across : planar::kAcross) x.row(row + across).setZero();
    }
  }

  template <class Solve>
  [[nodiscard]] Eigen::MatrixXd apply(const Eigen::MatrixXd& rhs, Solve&& solve) const {
    if (rhs.rows() != 6 * static_cast<Eigen::Index>(variable.size())) {
      throw InputError(std::to_string(rhs.rows()) + " rows, expected 6 for each of " +
                       std::to_string(variable.size()) + " nodes");
    }
    Eigen::MatrixXd x(free_dimension, rhs.cols());
    for (std::size_t node = 0; node < variable.size(); ++node) {
      if (!held(node)) x.middleRows<6>(row(node)) = rhs.middleRows<6>(6 * static_cast<Eigen::Index>(node));
    }
    solve_with(solve, x);
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(rhs.rows(), rhs.cols());
    for (std::size_t node = 0; node < variable.size(); ++node) {
      if (!held(node)) out.middleRows<6>(6 * static_cast<Eigen::Index>(node)) = x.middleRows<6>(row(node));
    }
    return out;
  }

  /// Columns of Σ of several nodes side by side, rows in elimination order; zero for nodes that are held.
  [[nodiscard]] Eigen::MatrixXd columns(const std::vector<std::size_t>& nodes) const {
    Eigen::MatrixXd x = Eigen::MatrixXd::Zero(free_dimension, 6 * static_cast<Eigen::Index>(nodes.size()));
    for (std::size_t k = 0; k < nodes.size(); ++k) {
      if (!held(nodes[k])) x.block<6, 6>(row(nodes[k]), 6 * static_cast<Eigen::Index>(k)).setIdentity();
    }
    solve_with([](const auto& factor, auto& rhs) { detail::solve(factor, rhs); }, x);
    return x;
  }

  /// Row of a panel's front that holds the first row of a block; −1 if no row does.
  [[nodiscard]] Eigen::Index row_in_panel(std::size_t panel, Eigen::Index row) const {
    const auto block = static_cast<std::uint32_t>(row / 6);
    const std::uint32_t first = panels.first[panel], end = panels.first[panel + 1];
    if (block < end) return block < first ? -1 : 6 * static_cast<Eigen::Index>(block - first);
    const auto rows = panels.rows.begin() + static_cast<std::ptrdiff_t>(panels.row_start[panel]);
    const auto last = panels.rows.begin() + static_cast<std::ptrdiff_t>(panels.row_start[panel + 1]);
    const auto found = std::lower_bound(rows, last, block);
    if (found == last || *found != block) return -1;
    return 6 * (static_cast<Eigen::Index>(end - first) + (found - rows));
  }

  using Pairs = std::vector<std::pair<std::size_t, std::size_t>>;
  /// Joint covariances of the pairs `some`, from the columns of their nodes, a bounded number of columns at a
  /// time.
  void joint_by_columns(const Pairs& pairs, const std::vector<std::size_t>& some,
                        std::vector<Matrix12d>& out) const;
  /// Joint covariances of the pairs whose blocks are in the factor. \returns the other pairs
  [[nodiscard]] std::vector<std::size_t> joint_by_selection(const Pairs& pairs,
                                                            std::vector<Matrix12d>& out) const;
};

void HessianFactor::Impl::joint_by_columns(const Pairs& pairs, const std::vector<std::size_t>& some,
                                           std::vector<Matrix12d>& out) const {
  constexpr std::size_t kNodesAtATime = 64;
  std::map<std::size_t, std::vector<std::size_t>> by_node;  // node: its pairs
  for (const std::size_t k : some) {
    by_node[pairs[k].first].push_back(k);
    if (pairs[k].second != pairs[k].first) by_node[pairs[k].second].push_back(k);
  }
  std::vector<std::size_t> nodes;
  nodes.reserve(by_node.size());
  for (const auto& [node, uses] : by_node) nodes.push_back(node);
  for (std::size_t begin = 0; begin < nodes.size(); begin += kNodesAtATime) {
    const std::size_t end = std::min(nodes.size(), begin + kNodesAtATime);
    const std::vector<std::size_t> now(nodes.begin() + static_cast<std::ptrdiff_t>(begin),
                                       nodes.begin() + static_cast<std::ptrdiff_t>(end));
    const Eigen::MatrixXd x = columns(now);
    for (std::size_t i = 0; i < now.size(); ++i) {
      if (held(now[i])) continue;
      for (const std::size_t k : by_node[now[i]]) {
        const std::size_t ends[2] = {pairs[k].first, pairs[k].second};
        for (int column = 0; column < 2; ++column) {
          if (ends[column] != now[i]) continue;
          for (int r = 0; r < 2; ++r) {
            if (held(ends[r])) continue;
            out[k].block<6, 6>(6 * r, 6 * column) =
                x.block<6, 6>(row(ends[r]), 6 * static_cast<Eigen::Index>(i));
          }
        }
      }
    }
  }
}

std::vector<std::size_t> HessianFactor::Impl::joint_by_selection(const Pairs& pairs,
                                                                 std::vector<Matrix12d>& out) const {
  std::vector<std::size_t> left;
  std::vector<std::pair<Eigen::Index, std::size_t>> wanted;  // first column of the block, pair
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    const auto [a, b] = pairs[k];
    // Pairs with a held node, and pairs of one node, need only diagonal blocks.
    if (a != b && !held(a) && !held(b)) wanted.emplace_back(std::min(row(a), row(b)), k);
  }
  std::sort(wanted.begin(), wanted.end());
  const auto take = [&](std::size_t panel, const double* z) {
    const auto first = 6 * static_cast<Eigen::Index>(panels.first[panel]);
    const auto end = 6 * static_cast<Eigen::Index>(panels.first[panel + 1]);
    const auto height = static_cast<Eigen::Index>(panels.height(panel));
    const auto begin =
        std::lower_bound(wanted.begin(), wanted.end(), std::pair<Eigen::Index, std::size_t>(first, 0));
    for (auto it = begin; it != wanted.end() && it->first < end; ++it) {
      const auto [a, b] = pairs[it->second];
      const bool a_first = row(a) < row(b);
      const Eigen::Index later = a_first ? row(b) : row(a);
      const Eigen::Index within = row_in_panel(panel, later);
      if (within < 0) {
        left.push_back(it->second);
        continue;
      }
      const Matrix6d block = Eigen::Map<const Matrix6d, 0, Eigen::OuterStride<>>(
          z + (it->first - first) * height + within, Eigen::OuterStride<>(height));
      // Rows of the later node, columns of the earlier one.
      if (a_first) {
        out[it->second].bottomLeftCorner<6, 6>() = block;
        out[it->second].topRightCorner<6, 6>() = block.transpose();
      } else {
        out[it->second].topRightCorner<6, 6>() = block;
        out[it->second].bottomLeftCorner<6, 6>() = block.transpose();
      }
    }
  };
  const Eigen::MatrixXd diagonal = detail::selected_inverse(panels, detail::Rounding::kFastest, take);
  std::vector<char> is_left(pairs.size(), 0);
  for (const std::size_t k : left) is_left[k] = 1;
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    if (is_left[k] != 0) continue;
    const auto [a, b] = pairs[k];
    if (!held(a)) out[k].topLeftCorner<6, 6>() = diagonal.middleCols<6>(row(a));
    if (!held(b)) out[k].bottomRightCorner<6, 6>() = diagonal.middleCols<6>(row(b));
    if (a != b || held(a)) continue;
    out[k].topRightCorner<6, 6>() = out[k].topLeftCorner<6, 6>();
    out[k].bottomLeftCorner<6, 6>() = out[k].topLeftCorner<6, 6>();
  }
  return left;
}

HessianFactor::HessianFactor(const PoseGraph& graph, const OptimizerOptions& options)
    : impl_(std::make_unique<Impl>()) {
  validate(options);
  const detail::SingleThreadedBlas guard;
  const detail::PoseProblem problem(graph);
  ThreadPool pool(options.threads);
  detail::NormalEquations equations(options.factorization);
  equations.set_structure(problem);
  const auto poses = problem.poses_of(graph.poses());
  std::vector<Vector6d> residuals;
  if (!std::isfinite(problem.cost(poses, pool, residuals)))
    throw InputError("the cost at the poses is not finite");
  equations.linearize(problem, poses, residuals, pool);
  detail::BlockCholesky& cholesky = equations.hessian();
  const bool definite = cholesky.factorize(&pool);
  const auto [pivot, variable] =
      cholesky.variables() > 0 ? cholesky.smallest_pivot() : std::pair<double, std::size_t>(1.0, 0);
  if (!definite || pivot < detail::kSingularPivot) {
    const Key key = graph.nodes()[equations.freedom().nodes[variable]].key;
    throw InputError("node " + key_name(key) +
                     ": the factors do not determine its pose, so it has no covariance");
  }
  Impl& m = *impl_;
  m.poses = graph.poses();
  m.planar = graph.planar();
  for (std::size_t i = 0; i < graph.nodes().size(); ++i) m.keys.emplace_back(graph.nodes()[i].key, i);
  std::sort(m.keys.begin(), m.keys.end());
  m.variable = equations.freedom().variable;
  m.variable.pop_back();
  m.position.resize(cholesky.variables());
  for (std::size_t v = 0; v < m.position.size(); ++v) m.position[v] = cholesky.position(v);
  m.panels = cholesky.take_panels();
  detail::invert_diagonal(m.panels);
  m.free_dimension = 6 * static_cast<Eigen::Index>(cholesky.variables());
  m.factorization = cholesky.factorization();
  m.nonzeros = cholesky.factor_nonzeros();
  m.log_determinant = detail::log_determinant(m.panels);
}

HessianFactor::~HessianFactor() = default;
HessianFactor::HessianFactor(HessianFactor&&) noexcept = default;
HessianFactor& HessianFactor::operator=(HessianFactor&&) noexcept = default;

Eigen::Index HessianFactor::dimension() const {
  return 6 * static_cast<Eigen::Index>(impl_->variable.size());
}
bool HessianFactor::held(std::size_t node) const {
  impl_->require_node(node);
  return impl_->held(node);
}
double HessianFactor::log_determinant() const {
  return impl_->log_determinant;
}
double HessianFactor::factor_nonzeros() const {
  return impl_->nonzeros;
}
Factorization HessianFactor::factorization() const {
  return impl_->factorization;
}

Eigen::MatrixXd HessianFactor::solve(const Eigen::MatrixXd& rhs) const {
  return impl_->apply(rhs, detail::solve);
}

Eigen::MatrixXd HessianFactor::solve_root(const Eigen::MatrixXd& rhs) const {
  return impl_->apply(rhs, detail::solve_transposed);
}

Eigen::Matrix<double, Eigen::Dynamic, 6> HessianFactor::columns(std::size_t node) const {
  impl_->require_node(node);
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(dimension(), 6);
  rhs.middleRows<6>(6 * static_cast<Eigen::Index>(node)).setIdentity();
  return solve(rhs);
}

Marginals HessianFactor::marginals() const {
  const Eigen::MatrixXd blocks = detail::selected_inverse(impl_->panels, detail::Rounding::kFastest);
  Marginals out;
  out.covariances.assign(impl_->variable.size(), Matrix6d::Zero());
  for (std::size_t node = 0; node < out.covariances.size(); ++node) {
    if (impl_->held(node)) continue;
    const Matrix6d block = blocks.middleCols<6>(impl_->row(node));
    Matrix6d& covariance = out.covariances[node];
    covariance = 0.5 * (block + block.transpose());
    if (!impl_->planar) continue;
    for (const int across : planar::kAcross) {
      covariance.row(across).setZero();
      covariance.col(across).setZero();
    }
  }
  add_traces(out);
  return out;
}

std::vector<Matrix12d> HessianFactor::joint(
    const std::vector<std::pair<std::size_t, std::size_t>>& pairs) const {
  const Impl& m = *impl_;
  std::vector<std::size_t> all(pairs.size());
  for (std::size_t k = 0; k < pairs.size(); ++k) {
    if (std::max(pairs[k].first, pairs[k].second) >= m.variable.size()) {
      throw InputError("pair " + std::to_string(k) + ": no such node number");
    }
    all[k] = k;
  }
  std::vector<Matrix12d> out(pairs.size(), Matrix12d::Zero());
  if (pairs.size() < kManyPairs) {
    m.joint_by_columns(pairs, all, out);
  } else {
    m.joint_by_columns(pairs, m.joint_by_selection(pairs, out), out);
  }
  for (Matrix12d& joint : out) {
    joint = 0.5 * (joint + joint.transpose()).eval();
    if (!m.planar) continue;
    for (const int across : planar::kAcross) {
      for (const int a : {across, across + 6}) {
        joint.row(a).setZero();
        joint.col(a).setZero();
      }
    }
  }
  return out;
}

Marginals HessianFactor::marginals_with(const std::vector<Edge>& edges, const Marginals& base) const {
  const Impl& m = *impl_;
  if (base.covariances.size() != m.variable.size()) {
    throw InputError("the marginals belong to another graph: " + std::to_string(base.covariances.size()) +
                     " nodes, expected " + std::to_string(m.variable.size()));
  }
  std::vector<std::size_t> nodes;
  std::map<std::size_t, Eigen::Index> slot;
  const auto slot_of = [&](std::size_t node) {
    const auto [found, fresh] = slot.emplace(node, 6 * static_cast<Eigen::Index>(nodes.size()));
    if (fresh) nodes.push_back(node);
    return found->second;
  };
  // With J the stacked Jacobians scaled by Ω½: Σ' = Σ − ΣJᵀ(I + JΣJᵀ)⁻¹JΣ.
  struct Row {
    Eigen::Index from, to;
    Matrix6d J_from, J_to;
  };
  std::vector<Row> rows;
  for (const Edge& edge : edges) {
    if (edge.weight <= 0.0) continue;
    if (edge.from == edge.to)
      throw InputError("edge of " + key_name(edge.from) + ": both ends are the same node");
    const std::size_t from = m.index_of(edge.from), to = m.index_of(edge.to);
    const Vector6d r = edge_residual(edge, m.poses[from], m.poses[to]);
    const Matrix6d root = square_root(edge.weight * edge.information);
    const Matrix6d J = se3::right_jacobian_inverse(r);
    rows.push_back({slot_of(from), slot_of(to),
                    -root * J * se3::adjoint(m.poses[to].inverse() * m.poses[from]), root * J});
  }
  if (rows.empty()) return base;
  const Eigen::MatrixXd columns = m.columns(nodes);
  const auto k = 6 * static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd SJt(m.free_dimension, k);  // Σ Jᵀ
  for (std::size_t e = 0; e < rows.size(); ++e) {
    SJt.middleCols<6>(6 * static_cast<Eigen::Index>(e)) =
        columns.middleCols<6>(rows[e].from) * rows[e].J_from.transpose() +
        columns.middleCols<6>(rows[e].to) * rows[e].J_to.transpose();
  }
  const auto rows_at = [&](std::size_t node) -> Eigen::MatrixXd {
    if (m.held(node)) return Eigen::MatrixXd::Zero(6, k);
    return SJt.middleRows<6>(m.row(node));
  };
  Eigen::MatrixXd S = Eigen::MatrixXd::Identity(k, k);
  for (std::size_t e = 0; e < rows.size(); ++e) {
    S.middleRows<6>(6 * static_cast<Eigen::Index>(e)) +=
        rows[e].J_from * rows_at(nodes[static_cast<std::size_t>(rows[e].from / 6)]) +
        rows[e].J_to * rows_at(nodes[static_cast<std::size_t>(rows[e].to / 6)]);
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(0.5 * (S + S.transpose()));
  const Eigen::MatrixXd G =
      factor.matrixL().solve(SJt.transpose());  // Gᵀ G is subtracted from the covariance
  Marginals out = base;
  for (std::size_t node = 0; node < out.covariances.size(); ++node) {
    if (m.held(node)) continue;
    const auto g = G.middleCols<6>(m.row(node));
    out.covariances[node] -= g.transpose() * g;
  }
  add_traces(out);
  return out;
}

Marginals marginals(const PoseGraph& graph, const OptimizerOptions& options) {
  const detail::SingleThreadedBlas guard;
  return HessianFactor(graph, options).marginals();
}

}  // namespace loopwise
