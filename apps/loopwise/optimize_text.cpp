// SPDX-License-Identifier: BSD-3-Clause
#include "optimize_text.hpp"

#include <charconv>
#include <cstdio>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

namespace loopwise::cli {
namespace {

/// The name of a kind as in the tables of results.
const char* kind_name(EdgeKind kind) {
  switch (kind) {
    case EdgeKind::kOdometry:
      return "odometry";
    case EdgeKind::kLandmark:
      return "landmark";
    case EdgeKind::kLoopClosure:
      break;
  }
  return "closure";
}

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

/// A line for every chain whose odometry is worse than stated.
std::string odometry_text(const GncResult& gnc) {
  std::string text;
  for (const OdometryScale& odometry : gnc.odometry_scales) {
    char factor[32];
    std::snprintf(factor, sizeof factor, "%.2f", odometry.scale);
    text += "odometry     of the robot that begins at " + key_name(odometry.first) + ": estimated sigma is " +
            factor + " times the stated one\n";
  }
  return text;
}

void write_weights(const std::string& path, const PoseGraph& graph, const std::vector<double>& weights) {
  CsvText csv({"edge", "from", "to", "weight", "kind"});
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    csv.row(e, edge.from, edge.to, weights[e], kind_name(edge.kind));
  }
  write_file(path, csv.text());
}

void write_marginals(const std::string& path, const PoseGraph& graph, const Marginals& marginals) {
  const std::string axes[] = {"x", "y", "z", "rx", "ry", "rz"};
  std::string text = "key";
  for (int r = 0; r < 6; ++r) {
    for (int c = r; c < 6; ++c) text += "," + axes[r] + "_" + axes[c];
  }
  text += "\n";
  char number[32];
  for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
    text += std::to_string(graph.nodes()[i].key);
    for (int r = 0; r < 6; ++r) {
      for (int c = r; c < 6; ++c) {
        text += ',';
        text.append(number,
                    std::to_chars(number, number + sizeof number, marginals.covariances[i](r, c)).ptr);
      }
    }
    text += "\n";
  }
  write_file(path, text);
}

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
