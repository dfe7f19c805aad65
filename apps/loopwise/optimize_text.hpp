// SPDX-License-Identifier: BSD-3-Clause
// Texts and tables of the command `optimize`.
#pragma once

#include <string>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::cli {

/// Wall time at the end of each stage, s.
struct Times {
  double reading = 0.0, optimized = 0.0, certified = 0.0, marginals = 0.0;
};

/// Table of the cost of every step.
[[nodiscard]] std::string trace_table(const OptimizationResult& result);
[[nodiscard]] Json gnc_json(const GncResult& gnc);
/// Counts of closures, and a line for every robot whose odometry is worse than stated.
[[nodiscard]] std::string gnc_text(const GncResult& gnc);
[[nodiscard]] std::string marginals_text(const Marginals& marginals);
[[nodiscard]] Json certificate_json(const CertifiedEstimate& estimate);
/// \param robust whether the certified problem has the weights of robust optimisation
[[nodiscard]] std::string certificate_text(const CertifiedEstimate& estimate, bool robust);
[[nodiscard]] Json head_json(const PoseGraph& graph, const OptimizationResult& result, const Times& at,
                             double total);
[[nodiscard]] std::string head_text(const PoseGraph& graph, const OptimizationResult& result, double seconds);

}  // namespace loopwise::cli
