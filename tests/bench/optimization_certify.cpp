// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_certify.hpp"

#include <cstdio>

#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "optimization_graphs.hpp"

namespace loopwise::bench {

void certify_files(const std::vector<std::filesystem::path>& files) {
  std::printf("%-22s %6s %6s %12s %8s | %12s %12s %-10s %10s %10s %4s %5s %9s %9s %8s\n", "file", "poses",
              "edges", "cost", "s", "2F estimate", "2F", "status", "lambda min", "gap", "rank", "steps",
              "max rad", "max m", "s");
  for (const auto& path : files) {
    PoseGraph graph = read_bench_graph(path).graph;
    const OptimizationResult result = optimize(graph);
    graph.set_poses(result.poses);
    const Certificate c = certify(graph);
    std::printf(
        "%-22s %6zu %6zu %12.7g %8.3f | %12.7g %12.7g %-10s %10.3g %10.2g %4d %5d %9.2g %9.2g %8.3f\n",
        path.stem().c_str(), graph.nodes().size(), graph.edges().size(), result.cost, result.seconds,
        2.0 * c.cost_at_estimate, 2.0 * c.cost, enum_name(c.status).c_str(), c.min_eigenvalue, c.relative_gap,
        c.rank, c.steps, c.rotation_max_rad, c.translation_max_m, c.seconds);
    if (c.status == CertificateStatus::kImprovable) {
      graph.set_poses(c.best_poses);
      OptimizerOptions from_there;
      from_there.initialization = Initialization::kFile;
      std::printf("%-22s 2F %.7g; cost from there %.7g\n", "  a lower minimum", 2.0 * c.best_cost,
                  optimize(graph, from_there).cost);
    }
    std::fflush(stdout);
  }
}

}  // namespace loopwise::bench
