// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/Cholesky>

#include <loopwise/prioritization/covariance_objective.hpp>

#include "closure_set.hpp"

namespace loopwise {
namespace {

using detail::ClosureFactor;
using detail::ClosureSet;
using detail::ClosureTerm;
template <int Width>
using LogDetRows = Eigen::Matrix<double, 6, Width, Eigen::RowMajor>;

constexpr double kLogDetLostPivot = 1e-9;
constexpr std::size_t kLogDetValueRefresh = 64;
constexpr std::size_t kLogDetChunk = 64;

/// log det of a positive definite matrix, or nothing if rounding dominates it.
std::optional<double> log_det(const Matrix6d& m) {
  const Eigen::LLT<Matrix6d> cholesky(m);
  if (cholesky.info() != Eigen::Success) return std::nullopt;
  const Vector6d pivots = cholesky.matrixLLT().diagonal();
  if (pivots.cwiseAbs2().minCoeff() < kLogDetLostPivot) return std::nullopt;
  return 2.0 * pivots.array().log().sum();
}

}  // namespace

struct LogDetObjective::Impl {
  Impl(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
       const ClosureModelOptions& options, const ClosureModel& model)
      : closures(graph, candidates, options, model), pool(options.threads) {}

  ClosureSet closures;
  ThreadPool pool;
  std::vector<double> x;
  std::optional<double> value;
  std::size_t moves = 0;
  std::vector<Matrix6d> tracked;  // S of every candidate during a greedy choice

  void moved(double change) {
    if (value) *value += change;
    if (++moves >= kLogDetValueRefresh) value.reset();
    closures.changed();
  }

  /// Whitened JΣJᵀ; leaves the columns in `columns`.
  [[nodiscard]] Matrix6d block(const ClosureFactor& factor, std::size_t candidate,
                               std::vector<double>& columns) const {
    const ClosureTerm* term = &closures.terms[candidate];
    factor.closure_columns<6>(&term, columns);
    LogDetRows<6> S;
    factor.apply<6>(*term, columns, S.data());
    const Matrix6d W = closures.whitener(candidate);
    const Matrix6d s = W * S * W.transpose();
    return 0.5 * (s + s.transpose());
  }

  [[nodiscard]] double gain(const ClosureFactor& factor, std::size_t candidate) {
    return *log_det(Matrix6d::Identity() + block(factor, candidate, x));
  }

  const ClosureFactor& factor_without(std::size_t out) {
    std::vector<std::size_t> others = closures.set.members();
    others.erase(std::find(others.begin(), others.end(), out));
    return closures.factor_with(others);
  }
};

LogDetObjective::LogDetObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                 const ClosureModelOptions& options)
    : LogDetObjective(graph, candidates, options, closure_model(options)) {}

LogDetObjective::LogDetObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                 const ClosureModelOptions& options, const ClosureModel& model) {
  validate(options);
  impl_ = std::make_unique<Impl>(graph, candidates, options, model);
  (void)impl_->closures.factor();
}

LogDetObjective::~LogDetObjective() = default;

std::size_t LogDetObjective::size() const {
  return impl_->closures.terms.size();
}
const std::vector<std::size_t>& LogDetObjective::selected() const {
  return impl_->closures.set.members();
}
bool LogDetObjective::contains(std::size_t candidate) const {
  return impl_->closures.set.contains(candidate);
}
bool LogDetObjective::connecting(std::size_t candidate) const {
  return impl_->closures.terms.connecting(candidate);
}

double LogDetObjective::value() {
  Impl& m = *impl_;
  if (!m.value) {
    m.value = -m.closures.factor().log_determinant();
    m.moves = 0;
  }
  return *m.value;
}

double LogDetObjective::add_change(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) return 0.0;
  return -m.gain(m.closures.factor(), candidate);
}

double LogDetObjective::remove_change(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) return 0.0;
  const auto lost = log_det(Matrix6d::Identity() - m.block(m.closures.factor(), candidate, m.x));
  return lost ? -*lost : m.gain(m.factor_without(candidate), candidate);
}

double LogDetObjective::swap_change(std::size_t out, std::size_t in) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(out)) return add_change(in);
  if (m.closures.terms.inert(in)) return remove_change(out);
  const ClosureFactor& factor = m.closures.factor();
  const ClosureTerm* both[2] = {&m.closures.terms[out], &m.closures.terms[in]};
  factor.closure_columns<12>(both, m.x);
  Eigen::Matrix<double, 12, 12, Eigen::RowMajor> raw;
  factor.apply<12>(*both[0], m.x, raw.data());
  factor.apply<12>(*both[1], m.x, raw.data() + 72);
  const Matrix6d Wo = m.closures.whitener(out), Wi = m.closures.whitener(in);
  const Matrix6d s_oo = Wo * raw.topLeftCorner<6, 6>() * Wo.transpose();
  const Matrix6d s_io = Wi * raw.bottomLeftCorner<6, 6>() * Wo.transpose();
  const Matrix6d s_ii = Wi * raw.bottomRightCorner<6, 6>() * Wi.transpose();
  const Matrix6d rest = Matrix6d::Identity() - s_oo;
  if (const auto lost = log_det(rest)) {
    const Matrix6d grown = s_ii + s_io * Eigen::LLT<Matrix6d>(rest).solve(s_io.transpose());
    return -*lost - *log_det(Matrix6d::Identity() + grown);
  }
  const ClosureFactor& without = m.factor_without(out);
  const double gained = m.gain(without, out);
  return gained - m.gain(without, in);
}

std::vector<double> LogDetObjective::add_changes() {
  Impl& m = *impl_;
  const std::size_t count = size();
  if (m.tracked.empty()) {
    const ClosureFactor& factor = m.closures.factor();
    m.tracked.assign(count, Matrix6d::Zero());
    m.pool.for_each((count + kLogDetChunk - 1) / kLogDetChunk, [&](std::size_t chunk) {
      std::vector<double> own;
      for (std::size_t i = chunk * kLogDetChunk; i < std::min(count, (chunk + 1) * kLogDetChunk); ++i) {
        if (!m.closures.terms.inert(i)) m.tracked[i] = m.block(factor, i, own);
      }
    });
  }
  std::vector<double> out(count, 0.0);
  for (std::size_t i = 0; i < count; ++i) {
    if (contains(i) || m.closures.terms.inert(i)) continue;
    out[i] = -*log_det(Matrix6d::Identity() + m.tracked[i]);
  }
  return out;
}

void LogDetObjective::assign(const std::vector<std::size_t>& set) {
  Impl& m = *impl_;
  m.closures.set.assign(set);
  m.closures.changed();
  m.value.reset();
  m.tracked.clear();
}

void LogDetObjective::add(std::size_t candidate) {
  Impl& m = *impl_;
  if (m.closures.terms.inert(candidate)) {
    m.closures.set.add(candidate);
    return;
  }
  const ClosureFactor& factor = m.closures.factor();
  const Matrix6d own = m.block(factor, candidate, m.x);
  if (!m.tracked.empty()) {
    // S of every other candidate decreases by (JX)(JX)ᵀ, with X = ΣJᵀ whitened by I + S of the new closure.
    const Matrix6d Q = Eigen::LLT<Matrix6d>(Matrix6d::Identity() + own).matrixL().solve(Matrix6d::Identity());
    const Matrix6d T = m.closures.whitener(candidate).transpose() * Q.transpose();
    m.pool.for_each((size() + kLogDetChunk - 1) / kLogDetChunk, [&](std::size_t chunk) {
      for (std::size_t i = chunk * kLogDetChunk; i < std::min(size(), (chunk + 1) * kLogDetChunk); ++i) {
        if (m.closures.terms.inert(i)) continue;
        LogDetRows<6> J;
        factor.apply<6>(m.closures.terms[i], m.x, J.data());
        const Matrix6d s = m.closures.whitener(i) * J * T;
        m.tracked[i].noalias() -= s.lazyProduct(s.transpose());
      }
    });
  }
  m.closures.set.add(candidate);
  m.moved(-*log_det(Matrix6d::Identity() + own));
}

void LogDetObjective::remove(std::size_t candidate) {
  Impl& m = *impl_;
  const double change = remove_change(candidate);
  m.tracked.clear();
  m.closures.set.remove(candidate);
  m.moved(change);
}

void LogDetObjective::swap(std::size_t out, std::size_t in) {
  Impl& m = *impl_;
  const double change = swap_change(out, in);
  m.tracked.clear();
  m.closures.set.swap(out, in);
  m.moved(change);
}

}  // namespace loopwise
