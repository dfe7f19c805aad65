// SPDX-License-Identifier: BSD-3-Clause
#include <Eigen/Dense>
#include <vector>

#include "linalg/panels.hpp"
#include "testing.hpp"

namespace loopwise::wide_kernels_test {
namespace {

using Eigen::MatrixXd;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

Eigen::Index size(std::size_t blocks) {
  return 6 * static_cast<Eigen::Index>(blocks);
}

/// A lower triangular matrix of 6×6 blocks, dense and as panels of 1 to 3 block columns. Its pattern is that
/// of a Cholesky factor: some random block rows below a panel, and those of the panels that have their first
/// row in it.
struct Sparse {
  explicit Sparse(std::size_t columns, Rng& rng) : dense(MatrixXd::Zero(size(columns), size(columns))) {
    for (std::size_t begin = 0; begin < columns;) {
      const std::size_t end = std::min(columns, begin + 1 + rng.below(3));
      add_panel(begin, end, rng);
      begin = end;
    }
    panels.first.push_back(static_cast<std::uint32_t>(columns));
    detail::invert_diagonal(panels);
  }

  void add_panel(std::size_t begin, std::size_t end, Rng& rng) {
    const auto columns = static_cast<std::size_t>(dense.cols() / 6);
    std::vector<bool> filled(columns, false);
    for (std::size_t s = 0; s < panels.first.size(); ++s) {
      const auto first = panels.rows.begin() + static_cast<std::ptrdiff_t>(panels.row_start[s]);
      const auto last = panels.rows.begin() + static_cast<std::ptrdiff_t>(panels.row_start[s + 1]);
      if (first == last || *first < begin || *first >= end) continue;
      for (auto row = first; row != last; ++row) filled[*row] = true;
    }
    std::vector<std::size_t> rows;
    for (std::size_t row = begin; row < columns; ++row) {
      if (row < end || filled[row] || rng.below(5) == 0) rows.push_back(row);
    }
    panels.first.push_back(static_cast<std::uint32_t>(begin));
    MatrixXd values(size(rows.size()), size(end - begin));
    for (Eigen::Index i = 0; i < values.size(); ++i) values.data()[i] = rng.normal();
    for (Eigen::Index j = 0; j < values.cols(); ++j) values(j, j) = rng.uniform(4.0, 6.0);
    panels.values.insert(panels.values.end(), values.data(), values.data() + values.size());
    panels.value_start.push_back(panels.values.size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
      dense.block(size(rows[i]), size(begin), 6, values.cols()) = values.middleRows<6>(size(i));
      if (rows[i] >= end) panels.rows.push_back(static_cast<std::uint32_t>(rows[i]));
    }
    panels.row_start.push_back(panels.rows.size());
    dense = MatrixXd(dense.triangularView<Eigen::Lower>());
    panels.owner.resize(end, static_cast<std::uint32_t>(panels.first.size() - 1));
  }

  MatrixXd dense;
  detail::Panels panels;
};

RowMajor random_rows(Eigen::Index rows, Eigen::Index columns, Rng& rng) {
  RowMajor m(rows, columns);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = rng.normal();
  return m;
}

constexpr int kWidths[] = {6, 12, 16, 24};

}  // namespace

TEST_CASE("wide kernels: substitution is that of the dense matrix", "[linalg][property]") {
  Rng rng(31);
  for (const detail::DenseKernels* every : detail::all_dense_kernels()) {
    const detail::DenseKernels& kernels = *every;
    for (const std::size_t n : {std::size_t{1}, std::size_t{5}, std::size_t{14}}) {
      const Sparse l(n, rng);
      for (const int width : kWidths) {
        CAPTURE(n, width);
        const RowMajor given = random_rows(size(n), width, rng);
        RowMajor x = given;
        kernels.forward(l.panels.view(), nullptr, 0, width, x.data());
        REQUIRE((l.dense * x - given).cwiseAbs().maxCoeff() < 1e-12);
        x = given;
        kernels.backward(l.panels.view(), width, x.data());
        REQUIRE((l.dense.transpose() * x - given).cwiseAbs().maxCoeff() < 1e-12);

        // Zero but for one block: only its path to the root changes.
        const auto block = static_cast<std::uint32_t>(rng.below(n));
        RowMajor sparse = RowMajor::Zero(size(n), width);
        sparse.middleRows<6>(size(block)) = given.topRows<6>();
        RowMajor whole = sparse;
        const std::vector<detail::PathStep> path = detail::sparse_path(l.panels, {block});
        kernels.forward(l.panels.view(), path.data(), path.size(), width, sparse.data());
        kernels.forward(l.panels.view(), nullptr, 0, width, whole.data());
        REQUIRE(sparse == whole);
      }
    }
  }
}

TEST_CASE("wide kernels: the same bits for wide and narrow registers, and for each column alone",
          "[linalg][property]") {
  Rng rng(32);
  const detail::DenseKernels &wide = detail::dense_kernels(detail::Rounding::kPortable),
                             &narrow = detail::dense_kernels_baseline();
  const Sparse l(11, rng);
  for (const int width : kWidths) {
    CAPTURE(width);
    const RowMajor given = random_rows(size(11), width, rng);
    RowMajor x = given, y = given, first = given.leftCols<6>();
    for (RowMajor* m : {&x, &y, &first}) {
      const detail::DenseKernels& kernels = m == &y ? narrow : wide;
      kernels.forward(l.panels.view(), nullptr, 0, static_cast<int>(m->cols()), m->data());
      kernels.backward(l.panels.view(), static_cast<int>(m->cols()), m->data());
    }
    REQUIRE(x == y);
    REQUIRE(first == x.leftCols<6>());

    const RowMajor b = random_rows(6, width, rng), before = random_rows(6, width, rng);
    const MatrixXd a = random_rows(6, 6, rng);
    RowMajor c = before, d = before;
    wide.subtract_wide(a.data(), b.data(), width, c.data());
    narrow.subtract_wide(a.data(), b.data(), width, d.data());
    REQUIRE(c == d);
    REQUIRE((c - (before - a * b)).cwiseAbs().maxCoeff() < 1e-12);
  }
}

TEST_CASE("wide kernels: Gram matrices of some rows, with the same bits for wide and narrow registers",
          "[linalg][property]") {
  Rng rng(34);
  for (const int width : {6, 12}) {
    for (const int counted : {3, 6}) {
      CAPTURE(width, counted);
      const RowMajor x = random_rows(size(9), width, rng);
      MatrixXd expected = MatrixXd::Zero(width, width);
      for (Eigen::Index row = 0; row < x.rows(); ++row) {
        if (row % 6 < counted) expected += x.row(row).transpose() * x.row(row);
      }
      RowMajor wide(width, width), narrow(width, width);
      detail::dense_kernels(detail::Rounding::kPortable).gram(x.data(), 9, counted, width, wide.data());
      detail::dense_kernels_baseline().gram(x.data(), 9, counted, width, narrow.data());
      REQUIRE(wide == narrow);
      REQUIRE((wide - expected).cwiseAbs().maxCoeff() < 1e-12);
    }
  }
}

TEST_CASE("panels: solves of any number of columns are those of the dense matrix", "[linalg][property]") {
  Rng rng(33);
  const Sparse l(9, rng);
  for (const Eigen::Index columns : {1, 5, 6, 7, 13, 17, 24, 25, 60}) {
    CAPTURE(columns);
    const MatrixXd given = random_rows(size(9), columns, rng);
    MatrixXd x = given;
    detail::solve(l.panels, x);
    REQUIRE((l.dense * (l.dense.transpose() * x) - given).cwiseAbs().maxCoeff() < 1e-11);
    x = given;
    detail::solve_transposed(l.panels, x);
    REQUIRE((l.dense.transpose() * x - given).cwiseAbs().maxCoeff() < 1e-12);
  }
}

}  // namespace loopwise::wide_kernels_test
