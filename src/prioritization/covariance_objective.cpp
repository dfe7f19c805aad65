// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/covariance_objective.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <Eigen/Cholesky>
#include <Eigen/Dense>

#include <loopwise/core/error.hpp>

#include "closure_set.hpp"
#include "linalg/dense_kernels.hpp"

namespace loopwise {
namespace {

using detail::ClosureFactor;
using detail::ClosureSet;
using detail::ClosureTerm;
using detail::GainBlocks;
using Matrix12d = Eigen::Matrix<double, 12, 12>;
template <int Width>
using Rows = Eigen::Matrix<double, 6, Width, Eigen::RowMajor>;

/// Up to this number of candidates, the blocks of all pairs are stored: updating them after a move then costs
/// less than the solves for the evaluations (measured, docs/prioritization.md).
constexpr std::size_t kDenseUpTo = 256;
/// Moves between two exact evaluations of the running value.
constexpr std::size_t kValueRefresh = 32;
/// I − S of a closure in the set is the difference of nearly equal matrices. If a pivot is below this,
/// rounding dominates it, and the closure is removed by a new factorisation instead.
constexpr double kLostPivot = 1e-9;
/// Candidates whose columns are solved for together if all columns are needed: L is then read once for the
/// group.
constexpr std::size_t kGroup = 4;
/// Candidates per task of the pool.
constexpr std::size_t kChunk = 64;

/// tr((I − S)⁻¹ M), or nothing if rounding dominates I − S. `removal` receives the factor of I − S.
std::optional<double> loss(const Matrix6d& S, const Matrix6d& M, Eigen::LLT<Matrix6d>& removal) {
  removal.compute(Matrix6d::Identity() - S);
  if (removal.info() != Eigen::Success) return std::nullopt;
  if (removal.matrixLLT().diagonal().cwiseAbs2().minCoeff() < kLostPivot) return std::nullopt;
  return removal.solve(M).trace();
}

/// Whitened blocks of one candidate, from the given factor.
GainBlocks blocks_of(const ClosureSet& closures, const ClosureFactor& factor, std::size_t candidate,
                     TraceKind kind, std::vector<double>& x) {
  const ClosureTerm* term = &closures.terms[candidate];
  factor.closure_columns<6>(&term, x);
  Rows<6> S;
  factor.apply<6>(*term, x, S.data());
  const Matrix6d W = closures.whitener(candidate);
  GainBlocks out;
  out.S = W * S * W.transpose();
  out.S = 0.5 * (out.S + out.S.transpose()).eval();
  out.M = W * Matrix6d(detail::counted_gram<6>(x, kind)) * W.transpose();
  return out;
}

}  // namespace

struct CovarianceObjective::Impl {
  Impl(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates, const ClosureModelOptions& given,
       const ClosureModel& model)
      : options(given), closures(graph, candidates, given, model), pool(given.threads) {
    dense = options.storage == BlockStorage::kDense ||
            (options.storage == BlockStorage::kAutomatic && candidates.size() <= kDenseUpTo);
  }

  ClosureModelOptions options;
  ClosureSet closures;
  ThreadPool pool;
  bool dense = false;
  std::vector<double> x, y;  // scratch columns

  std::optional<double> value;  // of the current set
  std::size_t moves = 0;        // since the value was exact
  struct Change {
    std::size_t out, in;
    double change;
  };
  std::optional<Change> last_swap;  // evaluated for the current set

  // Column mode: blocks of every candidate for the current set, during a greedy choice.
  std::vector<GainBlocks> tracked;
  // Dense mode: S and M of all pairs, only the lower triangles are valid.
  Eigen::MatrixXd S, M;
  std::size_t dense_moves = 0;
  bool dense_fresh = false;

  [[nodiscard]] double exact_value() {
    const ClosureFactor::Traces traces = closures.factor().traces();
    return options.trace == TraceKind::kFull ? traces.full : traces.translation;
  }

  void moved(double change) {
    if (value) *value += change;
    if (++moves >= kValueRefresh) value.reset();
    closures.changed();
    last_swap.reset();
  }

  // ---- columns

  [[nodiscard]] double add_change(std::size_t in) {
    return -blocks_of(closures, closures.factor(), in, options.trace, x).gain();
  }

  [[nodiscard]] double remove_change(std::size_t out) {
    const GainBlocks b = blocks_of(closures, closures.factor(), out, options.trace, x);
    Eigen::LLT<Matrix6d> removal;
    if (const auto lost = loss(b.S, b.M, removal)) return *lost;
    return blocks_of(closures, factor_without(out), out, options.trace, x).gain();
  }

  const ClosureFactor& factor_without(std::size_t out) {
    std::vector<std::size_t> others = closures.set.members();
    others.erase(std::find(others.begin(), others.end(), out));
    return closures.factor_with(others);
  }

  [[nodiscard]] double swap_change(std::size_t out, std::size_t in) {
    const ClosureFactor& factor = closures.factor();
    const ClosureTerm* both[2] = {&closures.terms[out], &closures.terms[in]};
    factor.closure_columns<12>(both, x);
    Eigen::Matrix<double, 12, 12, Eigen::RowMajor> raw;
    factor.apply<12>(*both[0], x, raw.data());
    factor.apply<12>(*both[1], x, raw.data() + 72);
    Matrix12d W = Matrix12d::Zero();
    W.topLeftCorner<6, 6>() = closures.whitener(out);
    W.bottomRightCorner<6, 6>() = closures.whitener(in);
    Matrix12d s = W * raw * W.transpose();
    s = 0.5 * (s + s.transpose()).eval();
    const Matrix12d m = W * detail::counted_gram<12>(x, options.trace) * W.transpose();
    if (const auto change = swap_of_blocks(s, m)) return *change;
    const ClosureFactor& without = factor_without(out);
    const double lost = blocks_of(closures, without, out, options.trace, x).gain();
    return lost - blocks_of(closures, without, in, options.trace, x).gain();
  }

  /// Change of the trace if the first of two candidates leaves and the second one enters.
  [[nodiscard]] static std::optional<double> swap_of_blocks(const Matrix12d& s, const Matrix12d& m) {
    Eigen::LLT<Matrix6d> removal;
    const auto lost = loss(s.topLeftCorner<6, 6>(), m.topLeftCorner<6, 6>(), removal);
    if (!lost) return std::nullopt;
    // Removing the first one increases Σ by ΣJᵀ(I − S)⁻¹JΣ.
    const Matrix6d s_ba = s.bottomLeftCorner<6, 6>(), m_ba = m.bottomLeftCorner<6, 6>();
    const Matrix6d f = removal.solve(s_ba.transpose()).transpose();  // s_ba (I − S)⁻¹
    GainBlocks in;
    in.S = s.bottomRightCorner<6, 6>() + f * s_ba.transpose();
    const Matrix6d cross = f * m_ba.transpose();
    in.M =
        m.bottomRightCorner<6, 6>() + cross + cross.transpose() + f * m.topLeftCorner<6, 6>() * f.transpose();
    return *lost - in.gain();
  }

  void track() {
    if (!tracked.empty()) return;
    const ClosureFactor& factor = closures.factor();
    tracked.assign(closures.terms.size(), {});
    const std::size_t chunks = (tracked.size() + kChunk - 1) / kChunk;
    pool.for_each(chunks, [&](std::size_t chunk) {
      std::vector<double> own;
      for (std::size_t i = chunk * kChunk; i < std::min(tracked.size(), (chunk + 1) * kChunk); ++i) {
        if (!closures.terms.inert(i)) tracked[i] = blocks_of(closures, factor, i, options.trace, own);
      }
    });
  }

  /// Adds `in` by columns and updates the tracked blocks.
  void add_by_columns(std::size_t in) {
    const ClosureFactor& factor = closures.factor();
    const GainBlocks own = blocks_of(closures, factor, in, options.trace, x);  // leaves the columns in x
    const double gain = own.gain();
    if (!tracked.empty()) {
      // Updated blocks must agree with fresh ones. If their errors have accumulated, all blocks are computed
      // again.
      if (std::abs(tracked[in].gain() - gain) > 1e-6 * std::abs(gain)) {
        tracked.clear();
      } else {
        update_tracked(factor, in, own);
      }
    }
    closures.set.add(in);
    moved(-gain);
  }

  /// Let T whiten the columns X = ΣJᵀ such that Σ decreases by X Xᵀ, and Z = ΣPᵀPX − ½ X (XᵀPᵀPX). Then S
  /// decreases by (JX)(JX)ᵀ, and M by (JX)(JZ)ᵀ + (JZ)(JX)ᵀ.
  void update_tracked(const ClosureFactor& factor, std::size_t in, const GainBlocks& own) {
    const Eigen::LLT<Matrix6d> cholesky(Matrix6d::Identity() + own.S);
    const Matrix6d Q = cholesky.matrixL().solve(Matrix6d::Identity());
    const Matrix6d T = closures.whitener(in).transpose() * Q.transpose();
    const Matrix6d half = 0.5 * Q * own.M * Q.transpose();
    const std::size_t n = factor.free_nodes();
    y.assign(x.size(), 0.0);
    const std::size_t trace_values = options.trace == TraceKind::kFull ? 36 : 18;
    for (std::size_t k = 0; k < n; ++k) std::copy_n(x.data() + 36 * k, trace_values, y.data() + 36 * k);
    factor.solve<6>(y);
    std::vector<double> both(2 * x.size());
    for (std::size_t k = 0; k < n; ++k) {
      const Eigen::Map<const Rows<6>> X(x.data() + 36 * k), Y(y.data() + 36 * k);
      Eigen::Map<Rows<12>> out(both.data() + 72 * k);
      const Matrix6d XT = X * T;
      out.leftCols<6>() = XT;
      out.rightCols<6>() = Y * T - XT * half;
    }
    const std::size_t chunks = (tracked.size() + kChunk - 1) / kChunk;
    pool.for_each(chunks, [&](std::size_t chunk) {
      for (std::size_t i = chunk * kChunk; i < std::min(tracked.size(), (chunk + 1) * kChunk); ++i) {
        if (closures.terms.inert(i)) continue;
        Rows<12> J;
        factor.apply<12>(closures.terms[i], both, J.data());
        const Eigen::Matrix<double, 6, 12> WJ = closures.whitener(i) * J;
        const Matrix6d s = WJ.leftCols<6>(), m = WJ.rightCols<6>();
        tracked[i].S.noalias() -= s.lazyProduct(s.transpose());
        const Matrix6d cross = s.lazyProduct(m.transpose());
        tracked[i].M -= cross + cross.transpose();
      }
    });
  }

  // ---- dense

  void hold_all() {
    if (dense_fresh) return;
    const ClosureFactor& factor = closures.factor();
    const auto L = static_cast<Eigen::Index>(closures.terms.size());
    S = Eigen::MatrixXd::Zero(6 * L, 6 * L);
    M = S;
    const std::size_t groups = (closures.terms.size() + kGroup - 1) / kGroup;
    pool.for_each(groups, [&](std::size_t group) {
      constexpr auto kWidth = static_cast<int>(6 * kGroup);
      constexpr std::size_t kRows = 6 * kWidth;
      const std::size_t begin = group * kGroup, end = std::min(begin + kGroup, closures.terms.size());
      std::array<const ClosureTerm*, kGroup> terms{};
      std::array<Matrix6d, kGroup> W;
      for (std::size_t c = begin; c < end; ++c) {
        if (closures.terms.inert(c)) continue;
        terms[c - begin] = &closures.terms[c];
        W[c - begin] = closures.whitener(c).transpose();
      }
      std::vector<double> a, b;
      factor.closure_columns<kWidth>(terms.data(), a);
      b.assign(a.size(), 0.0);
      const std::size_t trace_values = options.trace == TraceKind::kFull ? kRows : kRows / 2;
      for (std::size_t k = 0; k < factor.free_nodes(); ++k) {
        std::copy_n(a.data() + kRows * k, trace_values, b.data() + kRows * k);
      }
      factor.solve<kWidth>(b);
      for (std::size_t r = begin; r < closures.terms.size(); ++r) {
        if (closures.terms.inert(r)) continue;
        const Matrix6d Wr = closures.whitener(r);
        Rows<kWidth> s, m;
        factor.apply<kWidth>(closures.terms[r], a, s.data());
        factor.apply<kWidth>(closures.terms[r], b, m.data());
        for (std::size_t c = begin; c < std::min(end, r + 1); ++c) {
          if (terms[c - begin] == nullptr) continue;
          const Matrix6d& Wc = W[c - begin];
          const auto row = 6 * static_cast<Eigen::Index>(r), column = 6 * static_cast<Eigen::Index>(c);
          const auto at = 6 * static_cast<Eigen::Index>(c - begin);
          S.block<6, 6>(row, column) = Wr * Rows<6>(s.middleCols<6>(at)) * Wc;
          M.block<6, 6>(row, column) = Wr * Rows<6>(m.middleCols<6>(at)) * Wc;
        }
      }
    });
    dense_fresh = true;
    dense_moves = 0;
  }

  /// Block (a, b) of a symmetric matrix of which only the lower triangle is valid.
  [[nodiscard]] static Matrix6d held(const Eigen::MatrixXd& m, std::size_t a, std::size_t b) {
    const auto i = 6 * static_cast<Eigen::Index>(a), j = 6 * static_cast<Eigen::Index>(b);
    if (a > b) return m.block<6, 6>(i, j);
    if (a < b) return m.block<6, 6>(j, i).transpose();
    return Matrix6d(m.block<6, 6>(i, i)).selfadjointView<Eigen::Lower>();
  }

  [[nodiscard]] static Matrix12d held_pair(const Eigen::MatrixXd& m, std::size_t a, std::size_t b) {
    Matrix12d out;
    out << held(m, a, a), held(m, a, b), held(m, b, a), held(m, b, b);
    return out;
  }

  /// The 6·k columns of the full matrix for these candidates.
  [[nodiscard]] Eigen::MatrixXd held_columns(const Eigen::MatrixXd& m,
                                             const std::vector<std::size_t>& which) const {
    Eigen::MatrixXd out(m.rows(), 6 * static_cast<Eigen::Index>(which.size()));
    for (std::size_t k = 0; k < which.size(); ++k) {
      for (std::size_t r = 0; r < closures.terms.size(); ++r) {
        out.block<6, 6>(6 * static_cast<Eigen::Index>(r), 6 * static_cast<Eigen::Index>(k)) =
            held(m, r, which[k]);
      }
    }
    return out;
  }

  /// The 6×6 blocks of c on and below the diagonal −= those of a·bᵀ. Neither a nor b may be c.
  static void subtract_lower(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, Eigen::MatrixXd& c) {
    const detail::DenseKernels& kernels = detail::dense_kernels(detail::Rounding::kPortable);
    const auto rows = static_cast<int>(c.rows()), rank = static_cast<int>(a.cols());
    for (int j = 0; j < rows; j += 6) {
      kernels.subtract_abt(rows - j, rank, a.data() + j, rows, b.data() + j, rows, &c(j, j), rows, false);
    }
  }

  /// Updates the blocks when closures enter (+1) or leave (−1): rank 6k for S, rank 12k for M.
  void update_dense(const std::vector<std::size_t>& which, const std::vector<double>& signs) {
    if (++dense_moves >= static_cast<std::size_t>(options.dense_refresh)) dense_fresh = false;
    if (!dense_fresh) return;
    const auto k = 6 * static_cast<Eigen::Index>(which.size());
    const Eigen::MatrixXd s = held_columns(S, which), m = held_columns(M, which);
    Eigen::MatrixXd A(k, k), D(k, k);
    for (std::size_t i = 0; i < which.size(); ++i) {
      const auto row = 6 * static_cast<Eigen::Index>(which[i]), at = 6 * static_cast<Eigen::Index>(i);
      A.middleRows<6>(at) = s.middleRows<6>(row);
      D.middleRows<6>(at) = m.middleRows<6>(row);
      A.block<6, 6>(at, at) += signs[i] * Matrix6d::Identity();
    }
    const Eigen::MatrixXd K = A.partialPivLu().inverse();
    const Eigen::MatrixXd sK = s * (0.5 * (K + K.transpose()));
    const Eigen::MatrixXd z = m - 0.5 * sK * D;
    subtract_lower(sK, s, S);
    // sK·zᵀ + z·sKᵀ as one product: M is read once.
    Eigen::MatrixXd left(m.rows(), 2 * k), right(m.rows(), 2 * k);
    left << sK, z;
    right << z, sK;
    subtract_lower(left, right, M);
  }
};

CovarianceObjective::CovarianceObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                         const ClosureModelOptions& options)
    : CovarianceObjective(graph, candidates, options, closure_model(options)) {}

CovarianceObjective::CovarianceObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                         const ClosureModelOptions& options, const ClosureModel& model) {
  validate(options);
  impl_ = std::make_unique<Impl>(graph, candidates, options, model);
  (void)impl_->closures.factor();  // throws if the graph does not determine a covariance
}

CovarianceObjective::~CovarianceObjective() = default;

std::size_t CovarianceObjective::size() const {
  return impl_->closures.terms.size();
}
const std::vector<std::size_t>& CovarianceObjective::selected() const {
  return impl_->closures.set.members();
}
bool CovarianceObjective::contains(std::size_t candidate) const {
  return impl_->closures.set.contains(candidate);
}
bool CovarianceObjective::connecting(std::size_t candidate) const {
  return impl_->closures.terms.connecting(candidate);
}
BlockStorage CovarianceObjective::storage() const {
  return impl_->dense ? BlockStorage::kDense : BlockStorage::kColumns;
}
std::size_t CovarianceObjective::factorizations() const {
  return impl_->closures.factorizations();
}

double CovarianceObjective::value() {
  Impl& m = *impl_;
  if (!m.value) {
    m.value = m.exact_value();
    m.moves = 0;
  }
  return *m.value;
}

double CovarianceObjective::add_change(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) return 0.0;
  if (!m.dense) return m.add_change(candidate);
  m.hold_all();
  return -GainBlocks{m.held(m.S, candidate, candidate), m.held(m.M, candidate, candidate)}.gain();
}

double CovarianceObjective::remove_change(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) return 0.0;
  if (m.dense) {
    m.hold_all();
    Eigen::LLT<Matrix6d> removal;
    const auto lost = loss(m.held(m.S, candidate, candidate), m.held(m.M, candidate, candidate), removal);
    if (lost) return *lost;
  }
  return m.remove_change(candidate);
}

double CovarianceObjective::swap_change(std::size_t out, std::size_t in) {
  Impl& m = *impl_;
  if (m.last_swap && m.last_swap->out == out && m.last_swap->in == in) return m.last_swap->change;
  double change = 0.0;
  if (m.closures.terms.inert(out)) {
    change = add_change(in);
  } else if (m.closures.terms.inert(in)) {
    change = remove_change(out);
  } else if (m.dense) {
    m.hold_all();
    const auto found = m.swap_of_blocks(m.held_pair(m.S, out, in), m.held_pair(m.M, out, in));
    change = found ? *found : m.swap_change(out, in);
  } else {
    change = m.swap_change(out, in);
  }
  m.last_swap = Impl::Change{out, in, change};
  return change;
}

std::vector<double> CovarianceObjective::add_changes() {
  Impl& m = *impl_;
  std::vector<double> out(size(), 0.0);
  if (!m.dense) m.track();
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (contains(i) || m.closures.terms.inert(i)) continue;
    out[i] = m.dense ? add_change(i) : -m.tracked[i].gain();
  }
  return out;
}

void CovarianceObjective::assign(const std::vector<std::size_t>& set) {
  Impl& m = *impl_;
  m.closures.set.assign(set);
  m.closures.changed();
  m.value.reset();
  m.tracked.clear();
  m.dense_fresh = false;
  m.last_swap.reset();
}

void CovarianceObjective::add(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) {
    m.closures.set.add(candidate);
    m.last_swap.reset();
    return;
  }
  if (!m.dense) {
    m.add_by_columns(candidate);
    return;
  }
  const double change = add_change(candidate);
  m.update_dense({candidate}, {1.0});
  m.closures.set.add(candidate);
  m.moved(change);
}

void CovarianceObjective::remove(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) {
    m.closures.set.remove(candidate);
    m.last_swap.reset();
    return;
  }
  const double change = remove_change(candidate);
  m.tracked.clear();
  if (m.dense) m.update_dense({candidate}, {-1.0});
  m.closures.set.remove(candidate);
  m.moved(change);
}

void CovarianceObjective::swap(std::size_t out, std::size_t in) {
  Impl& m = *impl_;
  const bool inert_out = m.closures.terms.inert(out), inert_in = m.closures.terms.inert(in);
  const double change = swap_change(out, in);
  m.tracked.clear();
  if (m.dense) {
    std::vector<std::size_t> which;
    std::vector<double> signs;
    if (!inert_out) which.push_back(out), signs.push_back(-1.0);
    if (!inert_in) which.push_back(in), signs.push_back(1.0);
    if (!which.empty()) m.update_dense(which, signs);
  }
  m.closures.set.swap(out, in);
  m.moved(change);
}

}  // namespace loopwise
