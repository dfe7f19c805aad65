// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>

#include "panels.hpp"

namespace loopwise::detail {

/// Diagonal blocks of (L Lᵀ)⁻¹, side by side in elimination order: 6 × (6 · number of blocks). Takahashi's
/// recursion, from the last column to the first (Erisman and Tinney, CACM 1975).
/// \param visit called for every panel with its columns of the inverse over all rows of the panel, column by
///        column, with a stride of `height(panel)`
/// \pre invert_diagonal()
[[nodiscard]] LOOPWISE_EXPORT Eigen::MatrixXd selected_inverse(
    const Panels& l, Rounding rounding,
    const std::function<void(std::size_t panel, const double* z)>& visit = {});

}  // namespace loopwise::detail
