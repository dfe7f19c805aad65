// SPDX-License-Identifier: BSD-3-Clause
#include "linalg/block_cholesky.hpp"

#include <Eigen/Dense>
#include <numeric>
#include <vector>

#include "linalg/selected_inverse.hpp"
#include "testing.hpp"

namespace loopwise::block_cholesky_test {
namespace {

using detail::BlockCholesky;
using detail::BlockPair;
using Eigen::MatrixXd;

/// Pairs of a chain with closures, some of them twice and in both directions.
std::vector<BlockPair> chain_with_closures(std::uint32_t variables, std::size_t closures, Rng& rng) {
  std::vector<BlockPair> pairs;
  for (std::uint32_t v = 1; v < variables; ++v) pairs.emplace_back(v - 1, v);
  for (std::size_t k = 0; k < closures; ++k) {
    const auto a = static_cast<std::uint32_t>(rng.below(variables));
    const auto b = static_cast<std::uint32_t>(rng.below(variables));
    if (a == b) continue;
    pairs.emplace_back(a, b);
    if (k % 4 == 0) pairs.emplace_back(b, a);
  }
  return pairs;
}

/// Random blocks with a dominant diagonal. \returns the dense matrix
MatrixXd fill(BlockCholesky& cholesky, Rng& rng) {
  detail::BlockMatrix& matrix = cholesky.matrix();
  matrix.set_zero();
  const auto n = static_cast<Eigen::Index>(matrix.variables());
  const Eigen::Index b = matrix.block_size();
  MatrixXd dense = MatrixXd::Zero(b * n, b * n);
  const auto add = [&](const BlockCholesky::Slot& slot, Eigen::Index row, Eigen::Index column,
                       const MatrixXd& block) {
    matrix.add(slot, block);
    dense.block(b * row, b * column, b, b) += block;
    if (row != column) dense.block(b * column, b * row, b, b) += block.transpose();
  };
  for (Eigen::Index v = 0; v < n; ++v) {
    add(matrix.diagonal_slot(static_cast<std::size_t>(v)), v, v, 20.0 * MatrixXd::Identity(b, b));
  }
  for (std::size_t k = 0; k < matrix.pairs().size(); ++k) {
    MatrixXd block(b, b);
    for (Eigen::Index i = 0; i < block.size(); ++i) block.data()[i] = rng.uniform(-1.0, 1.0);
    add(matrix.pair_slot(k), matrix.pairs()[k].first, matrix.pairs()[k].second, block);
  }
  return dense;
}

/// A matrix by position of its variables.
MatrixXd in_order(const MatrixXd& dense, const BlockCholesky& cholesky) {
  MatrixXd out(dense.rows(), dense.cols());
  const auto at = [&](std::size_t v) { return 6 * static_cast<Eigen::Index>(cholesky.position(v)); };
  for (std::size_t r = 0; r < cholesky.variables(); ++r) {
    for (std::size_t c = 0; c < cholesky.variables(); ++c) {
      out.block<6, 6>(at(r), at(c)) =
          dense.block<6, 6>(6 * static_cast<Eigen::Index>(r), 6 * static_cast<Eigen::Index>(c));
    }
  }
  return out;
}

/// Compares the blocks of the inverse in the fronts with those of the dense inverse.
void check_selected_inverse(const detail::Panels& l, const MatrixXd& inverse, detail::Rounding rounding) {
  double worst = 0.0;
  const MatrixXd diagonal = detail::selected_inverse(l, rounding, [&](std::size_t s, const double* z) {
    const Eigen::Map<const MatrixXd> front(z, l.height(s), l.columns(s));
    const Eigen::Index column = 6 * static_cast<Eigen::Index>(l.first[s]);
    for (Eigen::Index j = 0; j < front.cols(); ++j) {
      for (Eigen::Index i = 0; i < front.rows(); ++i) {
        Eigen::Index row = column + i;
        if (i >= front.cols()) {
          const auto block = l.rows[l.row_start[s] + static_cast<std::size_t>((i - front.cols()) / 6)];
          row = 6 * static_cast<Eigen::Index>(block) + i % 6;
        }
        worst = std::max(worst, std::abs(front(i, j) - inverse(row, column + j)));
      }
    }
  });
  const double unit = inverse.cwiseAbs().maxCoeff();
  REQUIRE(worst < 1e-13 * unit);
  for (Eigen::Index at = 0; at < diagonal.cols(); at += 6) {
    const MatrixXd error = diagonal.middleCols<6>(at) - inverse.block<6, 6>(at, at);
    REQUIRE(error.cwiseAbs().maxCoeff() < 1e-13 * unit);
  }
}

}  // namespace

TEST_CASE("elimination: counts and tree are those of the dense factor", "[linalg][property]") {
  Rng rng(41);
  for (const std::uint32_t n : {1U, 2U, 17U, 60U}) {
    CAPTURE(n);
    const std::vector<BlockPair> pairs = chain_with_closures(n, n > 2 ? n / 3 : 0, rng);
    std::vector<std::uint32_t> order(n);
    std::iota(order.begin(), order.end(), 0U);
    rng.shuffle(order);
    const detail::Elimination e = detail::analyze_order(order, pairs);
    // Elimination on a dense pattern.
    std::vector<std::vector<char>> pattern(n, std::vector<char>(n, 0));
    for (const auto& [a, b] : pairs) {
      pattern[e.position[a]][e.position[b]] = pattern[e.position[b]][e.position[a]] = 1;
    }
    for (std::uint32_t j = 0; j < n; ++j) {
      int count = 1, parent = -1;
      for (std::uint32_t i = j + 1; i < n; ++i) {
        if (pattern[i][j] == 0) continue;
        ++count;
        if (parent < 0) parent = static_cast<int>(i);
        for (std::uint32_t k = i + 1; k < n; ++k) {
          if (pattern[k][j] != 0) pattern[k][i] = pattern[i][k] = 1;
        }
      }
      REQUIRE(e.count[j] == count);
      REQUIRE(e.parent[j] == parent);
      // A postorder: the columns of a subtree are neighbours and end with its root.
      if (j > 0 && e.parent[j - 1] != static_cast<int>(j)) {
        REQUIRE((e.parent[j - 1] < 0 || e.parent[j - 1] > static_cast<int>(j)));
      }
    }
  }
}

TEST_CASE("block Cholesky: a matrix without variables", "[linalg]") {
  for (const int block : {3, 6}) {
    BlockCholesky cholesky(block, Factorization::kAutomatic);
    cholesky.analyze(0, {});
    REQUIRE(cholesky.factorize());
    REQUIRE(cholesky.smallest_pivot().first == 1.0);
    if (block == 6) REQUIRE(cholesky.log_determinant() == 0.0);
  }
}

TEST_CASE("block Cholesky: pairs that return give the positions of before", "[linalg]") {
  Rng rng(7);
  const std::vector<BlockPair> all = chain_with_closures(60, 20, rng);
  BlockCholesky cholesky(6, Factorization::kMultifrontal, detail::Rounding::kPortable);
  cholesky.analyze(60, all);
  const auto positions = [&] {
    std::vector<std::uint32_t> out;
    for (std::size_t v = 0; v < 60; ++v) out.push_back(cholesky.position(v));
    return out;
  };
  const std::vector<std::uint32_t> before = positions();
  bool differed = false;
  for (std::size_t left_out = 1; left_out <= 20; ++left_out) {
    CAPTURE(left_out);
    cholesky.analyze_again({all.begin(), all.end() - static_cast<std::ptrdiff_t>(left_out)});
    differed = differed || positions() != before;
    cholesky.analyze_again(all);
    REQUIRE(positions() == before);
  }
  REQUIRE(differed);  // otherwise the cases above show nothing
}

TEST_CASE("block Cholesky: solves after other pairs in the same order", "[linalg][property]") {
  Rng rng(42);
  for (const detail::Rounding rounding : {detail::Rounding::kFastest, detail::Rounding::kPortable}) {
    BlockCholesky cholesky(6, Factorization::kMultifrontal, rounding);
    for (int round = 0; round < 12; ++round) {
      CAPTURE(round);
      const std::vector<BlockPair> pairs = chain_with_closures(40, static_cast<std::size_t>(2 * round), rng);
      if (round == 0) {
        cholesky.analyze(40, pairs);
      } else {
        cholesky.analyze_again(pairs);
      }
      const MatrixXd dense = fill(cholesky, rng);
      REQUIRE(cholesky.factorize());
      MatrixXd x(dense.rows(), 2);
      for (Eigen::Index i = 0; i < x.size(); ++i) x.data()[i] = rng.normal();
      const MatrixXd expected = dense.llt().solve(x);
      cholesky.solve(x);
      REQUIRE((x - expected).cwiseAbs().maxCoeff() < 1e-12);
      const double log_determinant =
          2.0 * Eigen::VectorXd(MatrixXd(dense.llt().matrixL()).diagonal()).array().log().sum();
      REQUIRE(cholesky.log_determinant() == Approx(log_determinant).epsilon(1e-12));
    }
  }
}

TEST_CASE("selected inversion: the blocks of the dense inverse", "[linalg][property]") {
  Rng rng(43);
  for (const auto& [n, closures] :
       {std::pair(1U, 0U), std::pair(30U, 0U), std::pair(50U, 40U), std::pair(90U, 4000U)}) {
    CAPTURE(n, closures);
    const std::vector<BlockPair> pairs = chain_with_closures(n, closures, rng);
    for (const Factorization kind : {Factorization::kMultifrontal, Factorization::kSimplicial}) {
      for (const detail::Rounding rounding : {detail::Rounding::kFastest, detail::Rounding::kPortable}) {
        BlockCholesky cholesky(6, kind, rounding);
        cholesky.analyze(n, pairs);
        MatrixXd dense = fill(cholesky, rng);
        const double shift = static_cast<double>(closures);  // keeps the matrix definite
        cholesky.matrix().set_diagonal(cholesky.matrix().diagonal().array() + shift);
        dense.diagonal().array() += shift;
        REQUIRE(cholesky.factorize());
        detail::Panels l = cholesky.panels();
        detail::invert_diagonal(l);
        check_selected_inverse(l, in_order(dense, cholesky).inverse(), rounding);
      }
    }
  }
}

TEST_CASE("selected inversion: large panels are inverted in pieces", "[linalg][property]") {
  Rng rng(44);
  // Two groups of variables that are joined by a third one: a wide panel with many rows below.
  constexpr std::uint32_t kGroup = 35, kShared = 132, kAll = 2 * kGroup + kShared;
  std::vector<BlockPair> pairs;
  for (std::uint32_t a = 0; a < kAll; ++a) {
    for (std::uint32_t b = 0; b < a; ++b) {
      if (b >= kGroup || a < kGroup || a >= 2 * kGroup) pairs.emplace_back(b, a);
    }
  }
  for (const detail::Rounding rounding : {detail::Rounding::kFastest, detail::Rounding::kPortable}) {
    BlockCholesky cholesky(6, Factorization::kMultifrontal, rounding);
    cholesky.analyze(kAll, pairs);
    MatrixXd dense = fill(cholesky, rng);
    const double shift = 400.0;  // keeps the matrix definite
    cholesky.matrix().set_diagonal(cholesky.matrix().diagonal().array() + shift);
    dense.diagonal().array() += shift;
    REQUIRE(cholesky.factorize());
    detail::Panels l = cholesky.panels();
    detail::invert_diagonal(l);
    bool large = false;
    for (std::size_t s = 0; s < l.size(); ++s) {
      large = large || (l.columns(s) > 2 * detail::kStripe && l.below(s) > detail::kStripeRows);
    }
    REQUIRE(large);
    check_selected_inverse(l, in_order(dense, cholesky).inverse(), rounding);
  }
}

}  // namespace loopwise::block_cholesky_test
