// SPDX-License-Identifier: BSD-3-Clause
#include <Eigen/Dense>
#include <cmath>
#include <vector>

#include <loopwise/core/thread_pool.hpp>

#include "linalg/block_cholesky.hpp"
#include "linalg/dense_kernels.hpp"
#include "linalg/front.hpp"
#include "testing.hpp"

namespace loopwise::front_test {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

MatrixXd random_matrix(Rng& rng, int rows, int columns) {
  MatrixXd m(rows, columns);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = rng.normal();
  return m;
}

double largest(const MatrixXd& m) {
  return m.size() == 0 ? 0.0 : m.cwiseAbs().maxCoeff();
}

}  // namespace

TEST_CASE("front kernels: equal to Eigen's products for every number of rows", "[linalg][property]") {
  Rng rng(21);
  for (const detail::DenseKernels* kernel : detail::all_dense_kernels()) {
    for (int m = 0; m <= 60; m += 6) {
      CAPTURE(m);
      const int k = 6 * static_cast<int>(1 + rng.below(4)), spare = 2;  // rows that must stay as they are
      const MatrixXd a = random_matrix(rng, m + spare, k), b = random_matrix(rng, 6, k);
      const MatrixXd before = random_matrix(rng, m + spare, 6);
      for (const bool overwrite : {false, true}) {
        MatrixXd c = before, expected = before;
        if (overwrite) expected.topRows(m).setZero();
        expected.topRows(m) -= a.topRows(m) * b.transpose();
        kernel->subtract_abt(m, k, a.data(), m + spare, b.data(), 6, c.data(), m + spare, overwrite);
        REQUIRE(largest(c - expected) < 1e-12);  // measured 1e-14
        const MatrixXd bt = b.transpose();
        c = before;
        kernel->subtract_ab(m, k, a.data(), m + spare, bt.data(), k, c.data(), m + spare, overwrite);
        REQUIRE(largest(c - expected) < 1e-12);
      }
      const VectorXd x = random_matrix(rng, 6, 1), y = random_matrix(rng, m + spare, 1);
      VectorXd result = y;
      kernel->apply(m, a.data(), m + spare, x.data(), result.data());
      VectorXd expected = y;
      expected.head(m) -= a.topLeftCorner(m, 6) * x;
      REQUIRE(largest(result - expected) < 1e-12);
      result = x;
      kernel->apply_transposed(m, a.data(), m + spare, y.data(), result.data());
      REQUIRE(largest(result - (x - a.topLeftCorner(m, 6).transpose() * y.head(m))) < 1e-12);
    }
  }
}

TEST_CASE("front kernels: elimination is a Cholesky factor, and refuses indefinite matrices", "[linalg]") {
  Rng rng(22);
  for (const detail::DenseKernels* kernel : detail::all_dense_kernels()) {
    for (int m = 6; m <= 42; m += 6) {
      CAPTURE(m);
      const MatrixXd root = random_matrix(rng, 6, 8);
      MatrixXd a = random_matrix(rng, m, 6);
      a.topRows(6) = root * root.transpose();
      MatrixXd l = a;
      REQUIRE(kernel->eliminate(m, l.data(), m));
      l.topRows(6).triangularView<Eigen::StrictlyUpper>().setZero();
      REQUIRE(largest(l * l.topRows(6).transpose() - a) < 1e-11);  // measured 2e-14
      a(3, 3) = -1.0;
      REQUIRE_FALSE(kernel->eliminate(m, a.data(), m));
      a(3, 3) = std::numeric_limits<double>::quiet_NaN();
      REQUIRE_FALSE(kernel->eliminate(m, a.data(), m));
    }
  }
}

TEST_CASE("fronts: large ones are computed in pieces", "[linalg][property]") {
  Rng rng(25);
  const int w = 2 * detail::kStripe + 12, m = detail::kStripeRows + 30, h = w + m;
  const MatrixXd root = random_matrix(rng, h, w + 8) / std::sqrt(static_cast<double>(w));
  MatrixXd a = root * root.transpose();
  a.diagonal().array() += 1.0;
  const MatrixXd l = a.topLeftCorner(w, w).llt().matrixL();
  const MatrixXd below = l.triangularView<Eigen::Lower>().solve(a.topRightCorner(w, m)).transpose();
  const MatrixXd before = random_matrix(rng, m, m);
  for (const detail::DenseKernels* kernel : detail::all_dense_kernels()) {
    MatrixXd panel = a.leftCols(w);
    REQUIRE(detail::eliminate_columns(*kernel, w, h, panel.data()) == w);
    REQUIRE(largest((panel.topRows(w) - l).triangularView<Eigen::Lower>().toDenseMatrix()) < 1e-12);
    REQUIRE(largest(panel.bottomRows(m) - below) < 1e-12);
    for (const bool overwrite : {false, true}) {
      MatrixXd update = before;
      detail::subtract_product(*kernel, m, w, panel.data() + w, h, update.data(), overwrite);
      MatrixXd expected = -below * below.transpose();
      if (!overwrite) expected += before;
      REQUIRE(largest((update - expected).triangularView<Eigen::Lower>().toDenseMatrix()) < 1e-12);
    }
    // A pivot in the last stripe that is not positive.
    panel = a.leftCols(w);
    panel(w - 8, w - 8) = -1.0;
    REQUIRE(detail::eliminate_columns(*kernel, w, h, panel.data()) == w - 12);
  }
}

TEST_CASE("front kernels: portable rounding has the same bits for wide and narrow registers",
          "[linalg][property]") {
  Rng rng(24);
  const detail::DenseKernels &wide = detail::dense_kernels(detail::Rounding::kPortable),
                             &narrow = detail::dense_kernels_baseline();
  for (int m = 6; m <= 66; m += 6) {
    CAPTURE(m);
    const int k = 6 * static_cast<int>(1 + rng.below(5));
    const MatrixXd a = random_matrix(rng, m, k), b = random_matrix(rng, 6, k), bt = b.transpose();
    const MatrixXd before = random_matrix(rng, m, 6);
    for (const bool overwrite : {false, true}) {
      MatrixXd c = before, d = before;
      wide.subtract_abt(m, k, a.data(), m, b.data(), 6, c.data(), m, overwrite);
      narrow.subtract_abt(m, k, a.data(), m, b.data(), 6, d.data(), m, overwrite);
      REQUIRE(c == d);
      wide.subtract_ab(m, k, a.data(), m, bt.data(), k, c.data(), m, overwrite);
      narrow.subtract_ab(m, k, a.data(), m, bt.data(), k, d.data(), m, overwrite);
      REQUIRE(c == d);
    }
    MatrixXd c = before;
    const MatrixXd root = random_matrix(rng, 6, 8);
    c.topRows(6) = root * root.transpose();
    MatrixXd d = c;
    REQUIRE(wide.eliminate(m, c.data(), m));
    REQUIRE(narrow.eliminate(m, d.data(), m));
    REQUIRE(c == d);
    const VectorXd x = random_matrix(rng, 6, 1), y = random_matrix(rng, m, 1);
    VectorXd e = y, f = y;
    wide.apply(m, before.data(), m, x.data(), e.data());
    narrow.apply(m, before.data(), m, x.data(), f.data());
    REQUIRE(e == f);
    VectorXd g = x, h = x;
    wide.apply_transposed(m, before.data(), m, y.data(), g.data());
    narrow.apply_transposed(m, before.data(), m, y.data(), h.data());
    REQUIRE(g == h);
  }
}

TEST_CASE("factorisation: subtrees in parallel give the bits of one thread", "[linalg][property]") {
  // Blocks of a chain with closures to near and far ones: many subtrees below a large root.
  constexpr std::uint32_t kVariables = 1500;
  Rng rng(23);
  std::vector<detail::BlockCholesky::Pair> pairs;
  for (std::uint32_t v = 1; v < kVariables; ++v) pairs.emplace_back(v - 1, v);
  for (std::uint32_t k = 0; k < 900; ++k) {
    const auto v = static_cast<std::uint32_t>(rng.below(kVariables - 60));
    const auto reach = static_cast<std::uint32_t>(k % 6 == 0 ? kVariables - v - 1 : 58);
    pairs.emplace_back(v, v + 2 + static_cast<std::uint32_t>(rng.below(reach - 1)));
  }
  detail::BlockCholesky serial(6, Factorization::kMultifrontal), parallel(6, Factorization::kMultifrontal);
  serial.analyze(kVariables, pairs);
  parallel.analyze(kVariables, pairs);
  REQUIRE(serial.factor_flops() > 2e8);  // threads are worth waking
  for (double& value : serial.matrix().values()) value = 0.1 * rng.normal();
  serial.matrix().set_diagonal(VectorXd::Constant(6 * Eigen::Index{kVariables}, 30.0));
  parallel.matrix().values() = serial.matrix().values();
  ThreadPool pool(3);
  REQUIRE(serial.factorize());
  REQUIRE(parallel.factorize(&pool));
  REQUIRE(serial.panels().values == parallel.panels().values);

  // The same holds if the factorisation fails, at any place in the tree.
  VectorXd diagonal = serial.matrix().diagonal();
  for (const std::uint32_t broken : {3U, 700U, 1490U}) {
    CAPTURE(broken);
    VectorXd other = diagonal;
    other[6 * Eigen::Index{broken}] = -1.0;
    serial.matrix().set_diagonal(other);
    parallel.matrix().set_diagonal(other);
    REQUIRE_FALSE(serial.factorize());
    REQUIRE_FALSE(parallel.factorize(&pool));
    REQUIRE(serial.smallest_pivot() == parallel.smallest_pivot());
  }
}

}  // namespace loopwise::front_test
