// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>

#include <Eigen/Core>

#include <loopwise/core/se3.hpp>

namespace loopwise {

/// Variance of a surface element across its plane, relative to the variance along it.
inline constexpr double kFlatness = 0.001;

/// Normal equations Σ JᵀMJ·ξ = −Σ JᵀMd of the residuals d with J = [I, −[y]×] and
///
///     M = 2·kFlatness·(C_target + R·C_source·Rᵀ)⁻¹
///       = kFlatness·(I + nn·n·nᵀ + nm·(n·mᵀ + m·nᵀ) + mm·m·mᵀ),   C = I − (1 − kFlatness)·n·nᵀ,
///
/// by the Woodbury identity, with the normal n of the target and the rotated normal m of the source. M is 1
/// across a plane that both share and near 0 along it. A zero normal gives its side an isotropic covariance.
/// Blocks of residuals are summed with SIMD, in single precision within a block.
class NormalEquations {
 public:
  /// \param sq_scale of the Geman-McClure kernel
  explicit NormalEquations(double sq_scale) : sq_scale_(static_cast<float>(sq_scale)) {}

  /// Adds a residual d at the lever arm y.
  void add(const Eigen::Vector3d& d, const Eigen::Vector3d& y, const Eigen::Vector3d& n,
           const Eigen::Vector3d& m) {
    d_.row(filled_) = d.cast<float>();
    y_.row(filled_) = y.cast<float>();
    n_.row(filled_) = n.cast<float>();
    m_.row(filled_) = m.cast<float>();
    if (++filled_ == kBlock) sum_block();
    ++count_;
  }

  [[nodiscard]] std::size_t count() const { return count_; }

  /// Ends the sums. No residual may follow.
  void finish() {
    if (filled_ > 0) sum_block();
    H_.triangularView<Eigen::StrictlyLower>() = H_.transpose().eval();
  }
  [[nodiscard]] const Matrix6d& H() const { return H_; }
  [[nodiscard]] const Vector6d& b() const { return b_; }

 private:
  static constexpr Eigen::Index kBlock = 32;
  using Column = Eigen::Array<float, kBlock, 1>;
  using Columns = Eigen::Array<float, kBlock, 3>;
  using Columns6 = Eigen::Array<float, kBlock, 6>;

  [[nodiscard]] static Column dot(const Columns& a, const Columns& b) {
    return a.col(0) * b.col(0) + a.col(1) * b.col(1) + a.col(2) * b.col(2);
  }
  [[nodiscard]] static Columns cross(const Columns& a, const Columns& b) {
    Columns out;
    out.col(0) = a.col(1) * b.col(2) - a.col(2) * b.col(1);
    out.col(1) = a.col(2) * b.col(0) - a.col(0) * b.col(2);
    out.col(2) = a.col(0) * b.col(1) - a.col(1) * b.col(0);
    return out;
  }

  void sum_block() {
    constexpr auto kHalf = static_cast<float>(0.5 * (1.0 - kFlatness));
    for (Columns* columns : {&d_, &y_, &n_, &m_}) columns->bottomRows(kBlock - filled_).setZero();
    const Column a = 1.0F - kHalf * dot(n_, n_), b = 1.0F - kHalf * dot(m_, m_), c = kHalf * dot(n_, m_);
    const Column scale = kHalf / (a * b - c * c);
    const Column nn = scale * b, nm = scale * c, mm = scale * a;
    const Column dn = dot(n_, d_), dm = dot(m_, d_);
    const Column vn = nn * dn + nm * dm, vm = nm * dn + mm * dm;  // M·d = kFlatness·(d + vn·n + vm·m)
    constexpr auto kWeight = static_cast<float>(kFlatness);
    const Column robust = sq_scale_ / (sq_scale_ + kWeight * (dot(d_, d_) + vn * dn + vm * dm));
    Column w = kWeight * robust * robust;
    w.tail(kBlock - filled_).setZero();

    Columns6 gn, gm;
    gn << n_, cross(y_, n_);
    gm << m_, cross(y_, m_);
    Columns yd = cross(y_, d_);
    const auto sum = [](const auto& column) { return static_cast<double>(column.sum()); };
    for (Eigen::Index j = 0; j < 6; ++j) {
      const Column p = w * (nn * gn.col(j) + nm * gm.col(j)), q = w * (nm * gn.col(j) + mm * gm.col(j));
      for (Eigen::Index i = 0; i <= j; ++i) H_(i, j) += sum(gn.col(i) * p + gm.col(i) * q);
      const Column direct = j < 3 ? d_.col(j) : yd.col(j - 3);
      b_[j] += sum(w * (vn * gn.col(j) + vm * gm.col(j) + direct));
    }
    // The identity's part: I, −[y]× and −[y]×².
    Eigen::Vector3d wy;
    Eigen::Matrix3d squares;
    for (Eigen::Index j = 0; j < 3; ++j) {
      wy[j] = sum(w * y_.col(j));
      for (Eigen::Index i = 0; i < 3; ++i) squares(i, j) = sum(w * y_.col(i) * y_.col(j));
    }
    H_.diagonal().head<3>().array() += sum(w);
    H_.topRightCorner<3, 3>() -= se3::skew(wy);
    H_.bottomRightCorner<3, 3>() += squares.trace() * Eigen::Matrix3d::Identity() - squares;
    filled_ = 0;
  }

  float sq_scale_;
  Eigen::Index filled_ = 0;
  std::size_t count_ = 0;
  Columns d_, y_, n_, m_;  // of the block
  Matrix6d H_ = Matrix6d::Zero();
  Vector6d b_ = Vector6d::Zero();
};

}  // namespace loopwise
