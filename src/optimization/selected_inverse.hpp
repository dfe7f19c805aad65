// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>

#include <Eigen/Core>

#include "block_cholesky.hpp"

namespace loopwise::detail {

/// Diagonal blocks of (L Lᵀ)⁻¹, side by side in elimination order: block × (block · number of blocks).
/// Takahashi's recursion over panels, from the last column to the first (Erisman and Tinney, CACM 1975).
/// \param visit called for every panel with its columns of the inverse over all rows of the panel, column by
///        column, with a stride of `height(panel)`
[[nodiscard]] Eigen::MatrixXd selected_inverse(
    const Panels& panels, int block,
    const std::function<void(std::size_t panel, const double* z)>& visit = {});

/// x = (L Lᵀ)⁻¹ x in place; rows in elimination order.
void solve(const Panels& panels, Eigen::MatrixXd& x);
/// x = L⁻ᵀ x in place.
void solve_transposed(const Panels& panels, Eigen::MatrixXd& x);

}  // namespace loopwise::detail
