// SPDX-License-Identifier: BSD-3-Clause
#include "optimize_text.hpp"

#include <cstdio>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/text_tables.hpp>

namespace loopwise::cli {

std::string trace_table(const OptimizationResult& result) {
  std::vector<std::vector<std::string>> rows{
      {"step", "cost", "decrease", "predicted", "gradient", "size", "damping", ""}};
  const auto scientific = [](double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.6e", value);
    return std::string(text);
  };
  for (const IterationRecord& r : result.trace) {
    rows.push_back({std::to_string(r.iteration), scientific(r.cost), scientific(r.decrease),
                    scientific(r.predicted), scientific(r.gradient), scientific(r.step),
                    scientific(r.damping), r.accepted ? "" : "refused"});
  }
  return table(rows);
}

Json gnc_json(const GncResult& gnc) {
  Json json = {{"outer_iterations", gnc.outer_iterations},
               {"inliers", gnc.inliers},
               {"outliers", gnc.outliers},
               {"start", enum_name(gnc.start)},
               {"truncated_cost", gnc.truncated_cost}};
  if (gnc.noise_scale < 1.0) json["noise_scale"] = gnc.noise_scale;
  for (const OdometryScale& odometry : gnc.odometry_scales) {
    json["odometry_scales"].push_back({{"first", odometry.first}, {"scale", odometry.scale}});
  }
  return json;
}

std::string gnc_text(const GncResult& gnc) {
  std::string text = "closures     " + std::to_string(gnc.inliers) + " inliers, " +
                     std::to_string(gnc.outliers) + " outliers, " + std::to_string(gnc.outer_iterations) +
                     " outer iterations, start " + enum_name(gnc.start) + "\n";
  if (gnc.noise_scale < 1.0)
    text += "noise        sigmas are about " + fixed(gnc.noise_scale, 4) +
            " times the stated ones; closures were selected with them\n";
  for (const OdometryScale& odometry : gnc.odometry_scales) {
    text += "odometry     of the robot that begins at " + key_name(odometry.first) + ": estimated sigma is " +
            fixed(odometry.scale, 2) + " times the stated one\n";
  }
  return text;
}

std::string marginals_text(const Marginals& marginals) {
  char line[96];
  std::snprintf(line, sizeof line, "marginals    trace %.9g m^2 (translation), %.9g (full)\n",
                marginals.trace_translation, marginals.trace_full);
  return line;
}

Json head_json(const PoseGraph& graph, const OptimizationResult& result, const Times& at, double total) {
  return {{"poses", graph.nodes().size()},
          {"planar", graph.planar()},
          {"edges", graph.edges().size()},
          {"components", result.components},
          {"cost_initial", result.cost_initial},
          {"cost", result.cost},
          {"iterations", result.iterations},
          {"factorizations", result.factorizations},
          {"converged", result.converged},
          {"initialization", enum_name(result.initialization)},
          {"termination", enum_name(result.termination)},
          {"message", result.message},
          {"seconds",
           {{"total", total},
            {"reading", at.reading},
            {"optimization", at.optimized - at.reading},
            {"certificate", at.certified - at.optimized},
            {"marginals", at.marginals - at.certified}}}};
}

std::string head_text(const PoseGraph& graph, const OptimizationResult& result, double seconds) {
  char line[256];
  std::snprintf(line, sizeof line,
                "graph        %zu poses, %zu edges, %zu component%s%s\ncost         %.12g -> %.12g\n"
                "optimisation from %s, %d steps, %d factorisations, %s, %.3f s\n",
                graph.nodes().size(), graph.edges().size(), result.components,
                result.components == 1 ? "" : "s", graph.planar() ? ", planar" : "", result.cost_initial,
                result.cost, enum_name(result.initialization).c_str(), result.iterations,
                result.factorizations, enum_name(result.termination).c_str(), seconds);
  return line;
}

}  // namespace loopwise::cli
