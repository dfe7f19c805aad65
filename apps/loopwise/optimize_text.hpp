// SPDX-License-Identifier: BSD-3-Clause
// Texts and tables of the command `optimize`.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "command.hpp"

namespace loopwise::cli {

/// Wall time at the end of each stage, s.
struct Times {
  double reading = 0.0, optimized = 0.0, certified = 0.0, marginals = 0.0;
};

/// Table of the cost of every step.
std::string trace_table(const OptimizationResult& result);
/// A line for every robot whose odometry is worse than stated.
std::string odometry_text(const GncResult& gnc);
/// Writes rows edge, from, to, weight, kind, in the order of the graph's edges.
void write_weights(const std::string& path, const PoseGraph& graph, const std::vector<double>& weights);
/// Writes a row for every node: the upper triangle of its covariance, translation before rotation.
void write_marginals(const std::string& path, const PoseGraph& graph, const Marginals& marginals);
Json certificate_json(const CertifiedEstimate& estimate);
/// \param robust whether the certified problem has the weights of robust optimisation
std::string certificate_text(const CertifiedEstimate& estimate, bool robust);
Json head_json(const PoseGraph& graph, const OptimizationResult& result, const Times& at, double total);
std::string head_text(const PoseGraph& graph, const OptimizationResult& result, double seconds);

}  // namespace loopwise::cli
