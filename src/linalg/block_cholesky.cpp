// SPDX-License-Identifier: BSD-3-Clause
#include "block_cholesky.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include <loopwise/core/error.hpp>

#include "blas_threads.hpp"
#include "cholmod_factor.hpp"

namespace loopwise::detail {
namespace {

#ifdef LOOPWISE_WITH_GPL
/// For blocks that are not 6×6: the supernodal factorisation, with its dense panels, is faster above this
/// ratio of operations to non-zeros.
constexpr double kSupernodalFlopsPerNonzero = 40.0;
#endif
/// A new order of elimination is computed when the factorisation costs this many times as much as after the
/// last one.
constexpr double kReorderGrowth = 1.25;

}  // namespace

BlockCholesky::BlockCholesky(int block_size, Factorization factorization, Rounding rounding)
    : block_(block_size),
      choice_(factorization),
      rounding_(rounding),
      matrix_(block_size),
      fronts_(rounding) {
#ifndef LOOPWISE_WITH_GPL
  if (choice_ == Factorization::kSupernodal) {
    throw OptionError("factorization = \"supernodal\", but this build leaves out CHOLMOD's GPL parts");
  }
#endif
}

BlockCholesky::~BlockCholesky() = default;

void BlockCholesky::choose() {
  chosen_ = choice_;
  if (block_ == 6 && chosen_ == Factorization::kAutomatic) chosen_ = Factorization::kMultifrontal;
  if (block_ == 6 || (chosen_ != Factorization::kAutomatic && chosen_ != Factorization::kMultifrontal))
    return;
  chosen_ = Factorization::kSimplicial;
#ifdef LOOPWISE_WITH_GPL
  if (factor_flops_ > kSupernodalFlopsPerNonzero * factor_nonzeros_) chosen_ = Factorization::kSupernodal;
#endif
}

void BlockCholesky::count(const Elimination& elimination) {
  // Sums of b·c − k and of its square over the scalar columns k = 0 … b − 1 of a block column of c blocks.
  const double b = block_, sum = b * (b - 1.0) / 2.0, squares = b * (b - 1.0) * (2.0 * b - 1.0) / 6.0;
  factor_flops_ = factor_nonzeros_ = 0.0;
  for (const int blocks : elimination.count) {
    const double height = b * blocks;
    factor_nonzeros_ += b * height - sum;
    factor_flops_ += b * height * height - 2.0 * height * sum + squares;
  }
}

void BlockCholesky::analyze(std::size_t variables, const std::vector<Pair>& pairs) {
  if (variables * static_cast<std::size_t>(block_) >
      static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    throw Error("the graph has too many nodes for one factorisation");
  }
  // METIS draws random numbers that other threads of the process may draw too, so portable results do
  // without.
  const Dissection dissection = rounding_ == Rounding::kPortable ? Dissection::kNever : Dissection::kIfLong;
  Elimination elimination = fill_reducing_elimination(variables, pairs, block_, dissection);
  ordered_work_ = elimination.work();
  order_.resize(variables);
  for (std::uint32_t v = 0; v < variables; ++v) order_[elimination.position[v]] = v;
  analyze(std::move(elimination), pairs);
}

void BlockCholesky::analyze_again(const std::vector<Pair>& pairs) {
  Elimination elimination = analyze_order(order_, pairs);
  if (elimination.work() > kReorderGrowth * ordered_work_) {
    analyze(variables(), pairs);
  } else {
    analyze(std::move(elimination), pairs);
  }
}

void BlockCholesky::analyze(Elimination elimination, const std::vector<Pair>& pairs) {
  cholmod_.reset();
  count(elimination);
  choose();
  if (multifrontal()) {
    matrix_.lay_out(elimination.lower, true, elimination.position, pairs, BlockMatrix::Layout::kBlocks);
    // Rounding is portable where many right-hand sides follow.
    fronts_.analyze(elimination, rounding_ == Rounding::kFastest ? 1.0 : 0.0);
    return;
  }
  // Supernodal CHOLMOD reads the lower triangle, simplicial CHOLMOD the upper one.
  const bool supernodal = chosen_ == Factorization::kSupernodal;
  const BlockPattern pattern = supernodal ? elimination.lower : transposed(elimination.lower);
  matrix_.lay_out(pattern, supernodal, elimination.position, pairs, BlockMatrix::Layout::kColumns);
  if (variables() > 0) {
    cholmod_ = std::make_unique<CholmodFactor>(block_, supernodal, pattern, elimination);
  }
}

bool BlockCholesky::factorize(ThreadPool* pool) {
  if (variables() == 0) return true;
  std::optional<SingleThreadedBlas> guard;
  if (cholmod_) guard.emplace();
  return cholmod_ ? cholmod_->factorize(matrix_.values()) : fronts_.factorize(matrix_.values().data(), pool);
}

std::pair<double, std::size_t> BlockCholesky::smallest_pivot() const {
  const auto block = static_cast<std::size_t>(block_);
  std::pair<double, std::size_t> smallest{1.0, 0};
  if (variables() == 0) return smallest;
  if (!cholmod_) {
    const MultifrontalCholesky::Pivot& found = fronts_.smallest_pivot();
    return {found.ratio, variable_at(found.column)};
  }
  const std::size_t broken = cholmod_->broken_at();
  if (broken < variables()) return {0.0, variable_at(broken)};
  const std::vector<double> pivots = cholmod_->pivots();
  const Eigen::VectorXd diagonal = matrix_.diagonal();
  for (std::size_t v = 0; v < variables(); ++v) {
    for (std::size_t k = 0; k < block; ++k) {
      const double pivot = pivots[position(v) * block + k];
      const double ratio = pivot > 0.0 ? pivot / diagonal[static_cast<Eigen::Index>(v * block + k)] : 0.0;
      if (!(ratio >= smallest.first)) smallest = {std::isnan(ratio) ? 0.0 : ratio, v};
    }
  }
  return smallest;
}

std::size_t BlockCholesky::variable_at(std::size_t place) const {
  std::size_t variable = 0;
  while (position(variable) != place) ++variable;
  return variable;
}

void BlockCholesky::solve(Eigen::VectorXd& x) const {
  if (variables() == 0) return;
  if (cholmod_) {
    Eigen::MatrixXd m = x;
    solve(m);
    x = m;
    return;
  }
  Eigen::VectorXd y(x.size());
  for (std::size_t v = 0; v < variables(); ++v) {
    y.segment<6>(6 * static_cast<Eigen::Index>(position(v))) = x.segment<6>(6 * static_cast<Eigen::Index>(v));
  }
  fronts_.solve(y.data());
  for (std::size_t v = 0; v < variables(); ++v) {
    x.segment<6>(6 * static_cast<Eigen::Index>(v)) = y.segment<6>(6 * static_cast<Eigen::Index>(position(v)));
  }
}

void BlockCholesky::solve(Eigen::MatrixXd& x) const {
  if (variables() == 0 || x.cols() == 0) return;
  if (!cholmod_) {
    for (Eigen::Index c = 0; c < x.cols(); ++c) {
      Eigen::VectorXd column = x.col(c);
      solve(column);
      x.col(c) = column;
    }
    return;
  }
  const SingleThreadedBlas guard;
  Eigen::MatrixXd permuted(x.rows(), x.cols());
  for (std::size_t v = 0; v < variables(); ++v) {
    permuted.middleRows(static_cast<Eigen::Index>(position(v)) * block_, block_) =
        x.middleRows(static_cast<Eigen::Index>(v) * block_, block_);
  }
  cholmod_->solve(permuted);
  for (std::size_t v = 0; v < variables(); ++v) {
    x.middleRows(static_cast<Eigen::Index>(v) * block_, block_) =
        permuted.middleRows(static_cast<Eigen::Index>(position(v)) * block_, block_);
  }
}

double BlockCholesky::log_determinant() const {
  if (!cholmod_) return detail::log_determinant(fronts_.panels());
  double sum = 0.0;
  for (const double pivot : cholmod_->pivots()) sum += std::log(pivot);
  return sum;
}

Panels BlockCholesky::panels() const {
  return cholmod_ ? cholmod_->panels() : fronts_.panels();
}

Panels BlockCholesky::take_panels() {
  return cholmod_ ? cholmod_->panels() : std::move(fronts_.panels());
}

}  // namespace loopwise::detail
