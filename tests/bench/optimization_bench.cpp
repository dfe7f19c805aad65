// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The back end beside Ceres and beside the bare factorisation, in one run.
///   loopwise_optimization_bench files DATA/g2o      optimisation and marginals of each file
///   loopwise_optimization_bench gnc DATA/gnc        robust optimisation of each file
///   loopwise_optimization_bench sizes [LARGEST [SMALLEST]]  generated graphs of growing size
///   loopwise_optimization_bench groups              false closures that agree in groups
/// Times are processor time of the one thread that works, median of `kRounds`, so that a busy machine shows
/// less.
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <string>

#include <cholmod.h>

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/optimization/pcm.hpp>

#include "blas_threads.hpp"
#include "optimization_ceres.hpp"
#include "optimization_graphs.hpp"
#include "pose_problem.hpp"

namespace loopwise::bench {
namespace {

constexpr int kRounds = 5;

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// Milliseconds, median; long work runs once.
double median_ms(const std::function<void()>& work) {
  std::vector<double> times;
  for (int i = 0; i < kRounds; ++i) {
    const double start = thread_seconds();
    work();
    times.push_back(1e3 * (thread_seconds() - start));
    if (times.back() > 5e3) break;
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

double peak_gib() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / (1024.0 * 1024.0);
}

/// F: one numeric factorisation of the graph's Hessian, the best of our orderings and CHOLMOD's own,
/// simplicial and supernodal.
double factorization_ms(const PoseGraph& graph) {
  const detail::PoseProblem problem(graph);
  ThreadPool pool(1);
  const auto poses = problem.poses_of(graph.poses());
  std::vector<Vector6d> residuals;
  problem.cost(poses, pool, residuals);
  double best = 1e300;
  for (const Factorization kind : {Factorization::kSupernodal, Factorization::kSimplicial}) {
    detail::NormalEquations equations(kind);
    equations.set_structure(problem);
    equations.linearize(problem, poses, residuals, pool);
    detail::BlockCholesky& hessian = equations.hessian();
    best = std::min(best, median_ms([&] { static_cast<void>(hessian.factorize()); }));
    if (kind == Factorization::kSimplicial) continue;
    // The same matrix, scalar by scalar, as CHOLMOD orders it by default.
    cholmod_common common{};
    cholmod_start(&common);
    const std::size_t n = 6 * hessian.variables();
    cholmod_triplet* triplets =
        cholmod_allocate_triplet(n, n, hessian.values().size(), 0, CHOLMOD_REAL, &common);
    triplets->stype = -1;
    auto* rows = static_cast<int*>(triplets->i);
    auto* columns = static_cast<int*>(triplets->j);
    auto* values = static_cast<double*>(triplets->x);
    const auto add = [&](const detail::BlockCholesky::Slot& slot, std::size_t a, std::size_t b) {
      for (std::size_t c = 0; c < 6; ++c) {
        for (std::size_t r = 0; r < 6; ++r) {
          const std::size_t row = 6 * a + r, column = 6 * b + c;
          const std::size_t at = slot.offset + (slot.transposed ? r * slot.stride + c : c * slot.stride + r);
          if (a == b && row < column) continue;
          rows[triplets->nnz] = static_cast<int>(std::max(row, column));
          columns[triplets->nnz] = static_cast<int>(std::min(row, column));
          values[triplets->nnz++] = hessian.values()[at];
        }
      }
    };
    std::vector<std::pair<std::uint32_t, std::uint32_t>> seen;
    for (std::size_t v = 0; v < hessian.variables(); ++v) add(hessian.diagonal_slot(v), v, v);
    for (std::size_t k = 0; k < hessian.pairs().size(); ++k) {
      const auto [a, b] = hessian.pairs()[k];
      seen.emplace_back(std::max(a, b), std::min(a, b));
    }
    std::vector<std::size_t> order(seen.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return seen[a] < seen[b]; });
    for (std::size_t i = 0; i < order.size(); ++i) {
      if (i > 0 && seen[order[i]] == seen[order[i - 1]]) continue;
      const auto [a, b] = hessian.pairs()[order[i]];
      add(hessian.pair_slot(order[i]), a, b);
    }
    cholmod_sparse* matrix = cholmod_triplet_to_sparse(triplets, triplets->nnz, &common);
    for (const int mode : {CHOLMOD_SUPERNODAL, CHOLMOD_SIMPLICIAL}) {
      common.supernodal = mode;
      cholmod_factor* factor = cholmod_analyze(matrix, &common);
      best = std::min(best, median_ms([&] { cholmod_factorize(matrix, factor, &common); }));
      cholmod_free_factor(&factor, &common);
    }
    cholmod_free_sparse(&matrix, &common);
    cholmod_free_triplet(&triplets, &common);
    cholmod_finish(&common);
  }
  return best;
}

std::vector<std::filesystem::path> g2o_files(const std::string& folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() == ".g2o" && name.find("truth") == std::string::npos)
      files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

void compare_files(const std::string& folder) {
  std::printf("%-16s %8s | %5s %9s %7s | %5s %9s %7s | %9s %7s %10s %7s\n", "file", "F ms", "fact", "ours ms",
              "/F/fact", "iter", "Ceres ms", "ratio", "marg ms", "/F", "Ceres ms", "ratio");
  for (const auto& path : g2o_files(folder)) {
    PoseGraph graph = read_bench_graph(path).graph;
    OptimizationResult ours;
    const double ours_ms = median_ms([&] { ours = optimize(graph); });
    CeresOutcome peer;
    const double peer_ms = median_ms([&] { peer = ceres_optimize(graph); });
    graph.set_poses(ours.poses);
    const double f = factorization_ms(graph);
    Marginals covariances;
    const double marginals_ms = median_ms([&] { covariances = marginals(graph); });
    // QR of the larger graphs takes minutes and gigabytes.
    const bool small = graph.nodes().size() <= 1300;
    double trace = -1.0;
    const double covariance_ms = small ? median_ms([&] { trace = ceres_marginal_trace(graph); }) : 0.0;
    std::printf("%-16s %8.2f | %5d %9.2f %7.2f | %5d %9.1f %7.1f | %9.2f %7.2f %10.1f %7.1f\n",
                path.stem().c_str(), f, ours.factorizations, ours_ms, ours_ms / f / ours.factorizations,
                peer.iterations, peer_ms, peer_ms / ours_ms, marginals_ms, marginals_ms / f, covariance_ms,
                covariance_ms / marginals_ms);
    std::printf("%-16s cost %.12g, Ceres %.12g; trace full %.9g, translation %.9g, Ceres full %.9g\n", "",
                ours.cost, peer.cost, covariances.trace_full, covariances.trace_translation, trace);
    std::fflush(stdout);
  }
}

struct Verdict {
  double recall = 1.0, precision = 1.0;
};

/// Of false closures found and of those found to be false.
Verdict judge(const BenchGraph& graph, const std::function<bool(std::size_t)>& kept) {
  double found = 0, right = 0, all = 0;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    if (known_inlier(graph.graph.edges()[e])) continue;
    all += graph.is_false[e] ? 1 : 0;
    if (kept(e)) continue;
    ++found;
    right += graph.is_false[e] ? 1 : 0;
  }
  return {all > 0 ? right / all : 1.0, found > 0 ? right / found : 1.0};
}

PoseGraph without_false(const BenchGraph& graph) {
  PoseGraph clean = graph.graph;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) clean.set_weight(e, graph.is_false[e] ? 0.0 : 1.0);
  return clean;
}

double mean_distance(const std::vector<Eigen::Isometry3d>& a, const std::vector<Eigen::Isometry3d>& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += (a[i].translation() - b[i].translation()).norm();
  return sum / static_cast<double>(a.size());
}

void compare_gnc(const std::string& folder) {
  std::printf("%-22s %8s %6s %6s %7s %9s %10s %12s\n", "file", "ms", "outer", "fact", "recall", "precision",
              "ATE m", "trunc. cost");
  for (const auto& path : g2o_files(folder)) {
    const BenchGraph graph = read_bench_graph(path);
    GncResult result;
    const double ms = median_ms([&] { result = optimize_gnc(graph.graph); });
    const Verdict v = judge(graph, [&](std::size_t e) { return result.weights[e] > 0.5; });
    std::printf("%-22s %8.1f %6d %6d %7.4f %9.4f %10.3g %12.6g\n", graph.name.c_str(), ms,
                result.outer_iterations, result.optimization.factorizations, v.recall, v.precision,
                mean_distance(result.optimization.poses, optimize(without_false(graph)).poses),
                result.truncated_cost);
    std::fflush(stdout);
  }
}

void compare_sizes(std::size_t largest, std::size_t smallest) {
  std::printf("%-28s %8s %8s %10s %5s %12s %12s %10s %8s\n", "graph", "poses", "edges", "ms", "fact", "cost",
              "marginals ms", "Ceres ms", "peak GiB");
  const auto show = [](const BenchGraph& graph, bool with_ceres) {
    OptimizerOptions options;
    options.initialization = Initialization::kChordal;
    OptimizationResult result;
    const double ms = median_ms([&] { result = optimize(graph.graph, options); });
    PoseGraph at = graph.graph;
    at.set_poses(result.poses);
    const double marginals_ms = median_ms([&] { static_cast<void>(marginals(at)); });
    const double peer = with_ceres ? median_ms([&] {
      PoseGraph start = graph.graph;
      start.set_poses(initial_poses(start, Initialization::kChordal));
      static_cast<void>(ceres_optimize(start));
    })
                                   : 0.0;
    std::printf("%-28s %8zu %8zu %10.1f %5d %12.6g %12.1f %10.1f %8.2f\n", graph.name.c_str(),
                graph.graph.nodes().size(), graph.graph.edges().size(), ms, result.factorizations,
                result.cost, marginals_ms, peer, peak_gib());
    std::fflush(stdout);
  };
  for (const std::size_t poses : {1000U, 3000U, 10000U, 30000U, 100000U}) {
    if (poses < smallest || poses > largest) continue;
    show(streets(poses, poses / 10, 1, 1), poses <= 10000);
    show(streets(poses, 2 * poses, std::max<std::size_t>(2, poses / 5000), 2), poses <= 10000);
    if (poses <= 10000) show(lattice(poses, 3), poses <= 3000);
  }
}

void compare_groups() {
  std::printf("%-8s %-12s %8s %9s %10s %8s\n", "group", "method", "recall", "precision", "ATE m", "ms");
  for (const std::size_t size : {std::size_t{5}, std::size_t{10}, std::size_t{20}}) {
    Verdict sums[3] = {{0.0, 0.0}, {0.0, 0.0}, {0.0, 0.0}};
    double errors[3] = {0, 0, 0}, times[3] = {0, 0, 0};
    constexpr int kSeeds = 5;
    for (int seed = 1; seed <= kSeeds; ++seed) {
      BenchGraph graph = streets(600, 200, 2, static_cast<std::uint64_t>(seed));
      add_false_groups(graph, 100 / size, size, static_cast<std::uint64_t>(seed) + 100);
      const auto truth = optimize(without_false(graph)).poses;
      const auto count = [&](int method, const Verdict& v, double error, double ms) {
        sums[method].recall += v.recall;
        sums[method].precision += v.precision;
        errors[method] += error;
        times[method] += ms;
      };
      double start = thread_seconds();
      const GncResult gnc = optimize_gnc(graph.graph);
      count(0, judge(graph, [&](std::size_t e) { return gnc.weights[e] > 0.5; }),
            mean_distance(gnc.optimization.poses, truth), 1e3 * (thread_seconds() - start));
      start = thread_seconds();
      const PcmResult pcm = pairwise_consistent(graph.graph);
      PoseGraph kept = graph.graph;
      for (std::size_t e = 0; e < pcm.kept.size(); ++e) kept.set_weight(e, pcm.kept[e] ? 1.0 : 0.0);
      const OptimizationResult plain = optimize(kept);
      count(1, judge(graph, [&](std::size_t e) { return pcm.kept[e]; }), mean_distance(plain.poses, truth),
            1e3 * (thread_seconds() - start));
      start = thread_seconds();
      PoseGraph filtered = graph.graph;
      std::vector<std::size_t> number;
      for (std::size_t e = 0; e < pcm.kept.size(); ++e) {
        if (pcm.kept[e]) number.push_back(e);
      }
      std::size_t at = 0;
      filtered.remove_edges_if([&](const Edge&) { return !pcm.kept[at++]; });
      const GncResult both = optimize_gnc(filtered);
      std::vector<bool> in(pcm.kept.size(), false);
      for (std::size_t k = 0; k < number.size(); ++k) in[number[k]] = both.weights[k] > 0.5;
      count(2, judge(graph, [&](std::size_t e) { return in[e]; }),
            mean_distance(both.optimization.poses, truth), 1e3 * (thread_seconds() - start));
    }
    const char* names[] = {"GNC", "PCM", "PCM + GNC"};
    for (int m = 0; m < 3; ++m) {
      std::printf("%-8zu %-12s %8.3f %9.3f %10.3f %8.1f\n", size, names[m], sums[m].recall / kSeeds,
                  sums[m].precision / kSeeds, errors[m] / kSeeds, times[m] / kSeeds);
    }
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace loopwise::bench

int main(int argc, char** argv) {
  using namespace loopwise;
  const detail::SingleThreadedBlas guard;
  const std::string what = argc > 1 ? argv[1] : "";
  if (what == "files" && argc == 3) {
    bench::compare_files(argv[2]);
  } else if (what == "gnc" && argc == 3) {
    bench::compare_gnc(argv[2]);
  } else if (what == "sizes") {
    const auto bound = [&](int i, std::size_t otherwise) {
      return argc > i ? static_cast<std::size_t>(std::atoll(argv[i])) : otherwise;
    };
    bench::compare_sizes(bound(2, 10000), bound(3, 0));
  } else if (what == "groups") {
    bench::compare_groups();
  } else {
    std::fprintf(stderr, "usage: %s files FOLDER | gnc FOLDER | sizes [LARGEST [SMALLEST]] | groups\n",
                 argv[0]);
    return 2;
  }
  return 0;
}
