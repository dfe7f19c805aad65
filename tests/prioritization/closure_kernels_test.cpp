// SPDX-License-Identifier: BSD-3-Clause
#include <Eigen/Dense>

#include "closure_kernels.hpp"
#include "testing.hpp"

namespace loopwise {
namespace {

using Eigen::MatrixXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// A lower triangular matrix of 6×6 blocks, about a third of them not zero, dense and as the kernels take it.
struct Sparse {
  explicit Sparse(std::size_t columns, Rng& rng) : dense(MatrixXd::Zero(size(columns), size(columns))) {
    for (std::size_t k = 0; k < columns; ++k) {
      start.push_back(rows.size());
      for (std::size_t row = k; row < columns; ++row) {
        if (row > k && rng.below(3) != 0) continue;
        MatrixXd block(6, 6);
        for (Eigen::Index i = 0; i < 36; ++i) block.data()[i] = rng.normal();
        if (row == k) {
          block = MatrixXd(block.triangularView<Eigen::StrictlyLower>());
          for (int i = 0; i < 6; ++i) block(i, i) = rng.uniform(4.0, 6.0);
          const MatrixXd inverted = block.inverse().triangularView<Eigen::Lower>();
          inverse.insert(inverse.end(), inverted.data(), inverted.data() + 36);
        }
        rows.push_back(static_cast<std::uint32_t>(row));
        values.insert(values.end(), block.data(), block.data() + 36);
        dense.block<6, 6>(size(row), size(k)) = block;
      }
    }
    start.push_back(rows.size());
  }

  static Eigen::Index size(std::size_t blocks) { return 6 * static_cast<Eigen::Index>(blocks); }
  [[nodiscard]] detail::BlockColumns columns() const {
    return {start.size() - 1, start.data(), rows.data(), values.data(), inverse.data()};
  }

  MatrixXd dense;
  std::vector<std::size_t> start;
  std::vector<std::uint32_t> rows;
  std::vector<double> values, inverse;
};

RowMajor random_rows(Eigen::Index rows, Eigen::Index columns, Rng& rng) {
  RowMajor m(rows, columns);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = rng.normal();
  return m;
}

constexpr int kWidths[] = {6, 12, 16, 24};

}  // namespace

TEST_CASE("closure kernels: substitution is that of the dense matrix", "[prioritization][property]") {
  Rng rng(31);
  for (const std::size_t n : {std::size_t{1}, std::size_t{5}, std::size_t{14}}) {
    const Sparse l(n, rng);
    for (const int width : kWidths) {
      CAPTURE(n, width);
      const RowMajor given = random_rows(Sparse::size(n), width, rng);
      RowMajor x = given;
      detail::closure_kernels().forward(l.columns(), nullptr, 0, width, x.data());
      REQUIRE((l.dense * x - given).cwiseAbs().maxCoeff() < 1e-12);
      x = given;
      detail::closure_kernels().backward(l.columns(), width, x.data());
      REQUIRE((l.dense.transpose() * x - given).cwiseAbs().maxCoeff() < 1e-12);

      // Zero above the last column: that one is all there is to do.
      const auto last = static_cast<std::uint32_t>(n - 1);
      RowMajor sparse = given, whole = given;
      sparse.topRows(Sparse::size(n - 1)).setZero();
      whole = sparse;
      detail::closure_kernels().forward(l.columns(), &last, 1, width, sparse.data());
      detail::closure_kernels().forward(l.columns(), nullptr, 0, width, whole.data());
      REQUIRE(sparse == whole);
    }
  }
}

TEST_CASE("closure kernels: the same bits for wide and narrow registers, and for each column alone",
          "[prioritization][property]") {
  Rng rng(32);
  const detail::ClosureKernels &wide = detail::closure_kernels(),
                               &narrow = detail::closure_kernels_baseline();
  const Sparse l(11, rng);
  for (const int width : kWidths) {
    CAPTURE(width);
    const RowMajor given = random_rows(Sparse::size(11), width, rng);
    RowMajor x = given, y = given, first = given.leftCols<6>();
    for (RowMajor* m : {&x, &y, &first}) {
      const detail::ClosureKernels& kernels = m == &y ? narrow : wide;
      kernels.forward(l.columns(), nullptr, 0, static_cast<int>(m->cols()), m->data());
      kernels.backward(l.columns(), static_cast<int>(m->cols()), m->data());
    }
    REQUIRE(x == y);
    REQUIRE(first == x.leftCols<6>());

    const RowMajor b = random_rows(6, width, rng), before = random_rows(6, width, rng);
    RowMajor c = before, d = before;
    wide.subtract(l.values.data(), b.data(), width, c.data());
    narrow.subtract(l.values.data(), b.data(), width, d.data());
    REQUIRE(c == d);
    const Eigen::Map<const Matrix6d> a(l.values.data());
    REQUIRE((c - (before - a * b)).cwiseAbs().maxCoeff() < 1e-12);
  }

  // Blocks 1 to 3 add to 5 and 6, which represent rows 2 and 7, and to 4, which represents row 0.
  const std::vector<std::uint32_t> rows{9, 0, 2, 7}, place{4, 99, 5, 99, 99, 99, 99, 6};
  std::vector<double> values(7 * 36);
  for (double& v : values) v = rng.normal();
  const std::vector<double> before = values;
  std::vector<double> other = values;
  wide.update(rows.data(), place.data(), 1, 4, values.data());
  narrow.update(rows.data(), place.data(), 1, 4, other.data());
  REQUIRE(values == other);
  const auto block = [](const std::vector<double>& v, int at) {
    return Matrix6d(Eigen::Map<const Matrix6d>(v.data() + 36 * at));
  };
  for (int i = 0; i < 3; ++i) {
    const Matrix6d expected = block(before, 4 + i) - block(before, 1 + i) * block(before, 1).transpose();
    REQUIRE((block(values, 4 + i) - expected).cwiseAbs().maxCoeff() < 1e-12);
  }
  for (int i = 0; i < 4; ++i) REQUIRE(block(values, i) == block(before, i));
}

}  // namespace loopwise
