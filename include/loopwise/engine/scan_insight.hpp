// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/prioritization/method.hpp>

namespace loopwise {

/// What prioritisers are told of scans: the smallest eigenvalue of the observability matrix, from the cache,
/// and the signature of the cloud that is announced, or of the one that the cache loads. 0 and empty if the
/// scan cannot be read. `features` must outlive what is returned.
[[nodiscard]] LOOPWISE_EXPORT ScanInsight scan_insight(FeatureCache& features, ObservabilityVariant variant);

}  // namespace loopwise
