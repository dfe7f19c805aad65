// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/prioritization/observability.hpp>

namespace loopwise {

/// The smallest eigenvalue of a scan's observability matrix, from the cache; 0 if the scan cannot be read.
/// `features` must outlive the function that is returned.
[[nodiscard]] LOOPWISE_EXPORT ObservabilityPrioritizer::Eigenvalue observability_of(
    FeatureCache& features, ObservabilityVariant variant);

}  // namespace loopwise
