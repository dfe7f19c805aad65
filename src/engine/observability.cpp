// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/observability.hpp>

namespace loopwise {

ObservabilityPrioritizer::Eigenvalue observability_of(FeatureCache& features, ObservabilityVariant variant) {
  return [&features, variant](const KeyedScan& scan) {
    const auto of_scan = features.get(scan.key);
    if (!of_scan) return 0.0;
    return variant == ObservabilityVariant::kLamp ? of_scan->observability.min_eigenvalue_lamp
                                                  : of_scan->observability.min_eigenvalue;
  };
}

}  // namespace loopwise
