// SPDX-License-Identifier: BSD-3-Clause
#include <cstdio>
#include <string>

#include <nlohmann/json.hpp>

#include "optimize_text.hpp"

namespace loopwise::cli {
namespace {

/// Relation of the certified cost's critical point to the written poses.
std::string certified_point_text(const CertifiedEstimate& estimate) {
  const Certificate& c = estimate.certificate;
  char line[256];
  std::snprintf(
      line, sizeof line,
      "             The chordal cost has its %s up to %.2g rad and %.2g m (rms %.2g rad, %.2g m) from "
      "the result,\n             because it weighs the same measurements a little differently",
      c.status == CertificateStatus::kCertified ? "optimum" : "critical point", c.rotation_max_rad,
      c.translation_max_m, c.rotation_rms_rad, c.translation_rms_m);
  std::string text = line;
  if (c.status == CertificateStatus::kCertified) {
    text += estimate.same_minimum ? "; the result is the minimum next to it"
                                  : "; the result is not the minimum next to it";
  }
  std::snprintf(line, sizeof line, " (%.3f s)\n", c.seconds);
  return text + line;
}

}  // namespace

Json certificate_json(const CertifiedEstimate& estimate) {
  const Certificate& c = estimate.certificate;
  return {{"status", enum_name(c.status)},
          {"message", c.message},
          {"cost", c.cost},
          {"cost_at_estimate", c.cost_at_estimate},
          {"lower_bound", c.lower_bound},
          {"relative_gap", c.relative_gap},
          {"min_eigenvalue", c.min_eigenvalue},
          {"eigenvalue_tolerance", c.eigenvalue_tolerance},
          {"components", c.components},
          {"certified_components", c.certified_components},
          {"reduced_factors", c.reduced_factors},
          {"difference",
           {{"rotation_max_rad", c.rotation_max_rad},
            {"rotation_rms_rad", c.rotation_rms_rad},
            {"translation_max_m", c.translation_max_m},
            {"translation_rms_m", c.translation_rms_m}}},
          {"lower_minimum", estimate.lower_minimum},
          {"same_minimum", estimate.same_minimum},
          {"cost_before", estimate.cost_before},
          {"seconds", c.seconds}};
}

std::string certificate_text(const CertifiedEstimate& estimate, bool robust) {
  const Certificate& c = estimate.certificate;
  char line[256];
  std::string text;
  if (estimate.improved) {
    std::snprintf(line, sizeof line, "improved     %s: cost %.9g -> %.9g\n",
                  estimate.lower_minimum ? "the search found a lower minimum" : "converged further",
                  estimate.cost_before, estimate.cost);
    text += line;
  }
  if (c.components == 0 && c.status == CertificateStatus::kCertified)
    return text + "certificate  nothing to certify: " + c.message + "\n";
  if (c.status == CertificateStatus::kUnsupported)
    return text + "certificate  not certified (unsupported): " + c.message + "\n";
  if (c.status == CertificateStatus::kCertified) {
    std::snprintf(
        line, sizeof line,
        "certificate  certified: no poses have a lower chordal cost (globally optimal within %.1e)\n",
        c.relative_gap);
    text += line;
    if (robust) text += "             This holds for the closures kept; their choice is not certified.\n";
  } else {
    text += "certificate  not certified (" + enum_name(c.status);
    if (c.min_eigenvalue < 0.0) {
      std::snprintf(line, sizeof line, ", eigenvalue %.3g", c.min_eigenvalue);
      text += line;
    }
    text += "): " + c.message + "\n";
  }
  return text + certified_point_text(estimate);
}

}  // namespace loopwise::cli
