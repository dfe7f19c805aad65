// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/export.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/prioritization/method.hpp>

namespace loopwise {

/// Describes scans to the prioritisers. The smallest eigenvalue of the observability matrix comes from the
/// cache; it is 0 if the scan is missing. The signature is that of the announced cloud, or of the cloud that
/// the cache loads; it is empty if the scan is missing. `features` must outlive the returned functions.
[[nodiscard]] LOOPWISE_EXPORT ScanInsight scan_insight(FeatureCache& features, ObservabilityVariant variant);

}  // namespace loopwise
