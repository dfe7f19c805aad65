// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/graph_tables.hpp>

#include <charconv>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>

namespace loopwise {
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

std::string shortest(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

void require_count(const std::string& what, std::size_t found, std::size_t expected) {
  if (found == expected) return;
  throw InputError(std::to_string(found) + " " + what + " are given, the graph needs " +
                   std::to_string(expected));
}

}  // namespace

std::string weights_csv(const PoseGraph& graph, const std::vector<double>& weights) {
  require_count("weights", weights.size(), graph.edges().size());
  CsvText csv({"edge", "from", "to", "weight", "kind"});
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    csv.row(e, edge.from, edge.to, weights[e], kind_name(edge.kind));
  }
  return csv.text();
}

std::string covariances_csv(const PoseGraph& graph, const std::vector<Matrix6d>& covariances) {
  require_count("covariances", covariances.size(), graph.nodes().size());
  const std::string axes[] = {"x", "y", "z", "rx", "ry", "rz"};
  std::vector<std::string> columns{"key"};
  for (int r = 0; r < 6; ++r) {
    for (int c = r; c < 6; ++c) columns.push_back(axes[r] + "_" + axes[c]);
  }
  CsvText csv(columns);
  for (std::size_t i = 0; i < covariances.size(); ++i) {
    std::vector<std::string> row{std::to_string(graph.nodes()[i].key)};
    for (int r = 0; r < 6; ++r) {
      for (int c = r; c < 6; ++c) row.push_back(shortest(covariances[i](r, c)));
    }
    csv.row(row);
  }
  return csv.text();
}

}  // namespace loopwise
