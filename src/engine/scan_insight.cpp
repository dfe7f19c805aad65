// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/scan_insight.hpp>

namespace loopwise {

ScanInsight scan_insight(FeatureCache& features, ObservabilityVariant variant) {
  ScanInsight insight;
  insight.eigenvalue = [&features, variant](const KeyedScan& scan) {
    const auto of_scan = features.get(scan.key);
    if (!of_scan) return 0.0;
    return variant == ObservabilityVariant::kLamp ? of_scan->observability.min_eigenvalue_lamp
                                                  : of_scan->observability.min_eigenvalue;
  };
  insight.signature = [&features](const KeyedScan& scan) {
    const auto cloud = scan.cloud ? scan.cloud : features.scan(scan.key);
    return cloud ? ScanSignature(*cloud) : ScanSignature();
  };
  return insight;
}

}  // namespace loopwise
