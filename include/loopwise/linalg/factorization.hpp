// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/options.hpp>

namespace loopwise {

/// The sparse Cholesky factorisation.
enum class Factorization {
  kAutomatic,     ///< The fastest for the size.
  kMultifrontal,  ///< Loopwise's own, for the small dense blocks of pose graphs.
  kSimplicial,    ///< CHOLMOD's, column by column.
  kSupernodal,    ///< CHOLMOD's, by panels of columns; needs a build with LOOPWISE_WITH_GPL.
};
[[nodiscard]] inline EnumNames<Factorization> enum_names(Factorization) {
  return {{Factorization::kAutomatic, "automatic"},
          {Factorization::kMultifrontal, "multifrontal"},
          {Factorization::kSimplicial, "simplicial"},
          {Factorization::kSupernodal, "supernodal"}};
}

}  // namespace loopwise
