// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The back end beside Ceres and beside the bare factorisation, in one run.
///   loopwise_optimization_bench files DATA/g2o      optimisation and marginals of each file
///   loopwise_optimization_bench gnc DATA/gnc [CLEAN.g2o]  robust optimisation of each file
///   loopwise_optimization_bench sizes [LARGEST [SMALLEST [FILE.svg]]]  generated graphs of growing size
///   loopwise_optimization_bench groups              false closures that agree in groups
///   loopwise_optimization_bench hard [SEED [FOLDER [FILTER]]]  generated graphs and the files of a folder
///   with
///                                                   many false closures, random and in groups, and
///                                                   information that is wrong
///   loopwise_optimization_bench batches [POSES [SEED]]  closures and poses that arrive in batches
///   loopwise_optimization_bench certify FILE...     the certificate of global optimality on g2o files
///   loopwise_optimization_bench planar DATA/rrr     2D graphs of real robots, judged by their truth
///   loopwise_optimization_bench gtsam FOLDER [FILTER]  the files of a folder beside GTSAM, if it was found
/// Times are processor time of the one thread that works, so that a busy machine shows less. They are
/// medians; those of `files` are taken in turns with the peers'.
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iomanip>
#include <memory>
#include <string>

#include <cholmod.h>

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/optimization/pcm.hpp>

#include "linalg/blas_threads.hpp"
#include "optimization_ceres.hpp"
#include "optimization_certify.hpp"
#include "optimization_graphs.hpp"
#include "optimization_gtsam.hpp"
#include "optimization_hard.hpp"
#include "optimization_incremental.hpp"
#include "optimization_judge.hpp"
#include "optimization_planar.hpp"
#include "pose_problem.hpp"

namespace loopwise::bench {
namespace {

constexpr int kRounds = 11;
/// Of graphs that grow large and of files that take seconds.
constexpr int kFewRounds = 5;

/// Milliseconds, median; long work runs once.
double median_ms(const std::function<void()>& work) {
  std::vector<double> times;
  for (int i = 0; i < kFewRounds; ++i) {
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

/// Medians of several pieces of work done in turns, ms.
std::vector<double> medians_in_turns(const std::vector<std::function<void()>>& works) {
  std::vector<std::vector<double>> times(works.size());
  for (int i = 0; i < kRounds; ++i) {
    for (std::size_t k = 0; k < works.size(); ++k) {
      if (!times[k].empty() && times[k].back() > 5e3) continue;
      const double start = thread_seconds();
      works[k]();
      times[k].push_back(1e3 * (thread_seconds() - start));
    }
  }
  std::vector<double> out;
  for (auto& list : times) {
    std::sort(list.begin(), list.end());
    out.push_back(list[list.size() / 2]);
  }
  return out;
}

/// CHOLMOD's numeric factorisation of a graph's Hessian, simplicial and supernodal: by our order of
/// elimination and by the one that CHOLMOD finds for the scalar matrix by default. F is the fastest.
class Yardstick {
 public:
  explicit Yardstick(const PoseGraph& graph) {
    const detail::PoseProblem problem(graph);
    ThreadPool pool(1);
    const auto poses = problem.poses_of(graph.poses());
    std::vector<Vector6d> residuals;
    problem.cost(poses, pool, residuals);
    const auto linearized = [&](Factorization kind) {
      auto equations = std::make_unique<detail::NormalEquations>(kind);
      equations->set_structure(problem);
      equations->linearize(problem, poses, residuals, pool);
      return equations;
    };
    ours_ = linearized(Factorization::kMultifrontal);
    for (const Factorization kind : {Factorization::kSupernodal, Factorization::kSimplicial}) {
      systems_.push_back(linearized(kind));
    }
    cholmod_start(&common_);
    make_scalar_matrix(systems_[0]->hessian().matrix());
    for (const int mode : {CHOLMOD_SUPERNODAL, CHOLMOD_SIMPLICIAL}) {
      common_.supernodal = mode;
      factors_.push_back(cholmod_analyze(matrix_, &common_));
    }
  }
  ~Yardstick() {
    for (cholmod_factor* factor : factors_) cholmod_free_factor(&factor, &common_);
    cholmod_free_sparse(&matrix_, &common_);
    cholmod_finish(&common_);
  }
  Yardstick(const Yardstick&) = delete;
  Yardstick& operator=(const Yardstick&) = delete;

  /// Our own factorisation, for comparison.
  void run_ours() { static_cast<void>(ours_->hessian().factorize()); }
  /// CHOLMOD's variants.
  static constexpr std::size_t kVariants = 4;
  void run(std::size_t variant) {
    if (variant < 2) {
      static_cast<void>(systems_[variant]->hessian().factorize());
    } else {
      cholmod_factorize(matrix_, factors_[variant - 2], &common_);
    }
  }

 private:
  void make_scalar_matrix(const detail::BlockMatrix& hessian) {
    const std::size_t n = 6 * hessian.variables();
    cholmod_triplet* triplets =
        cholmod_allocate_triplet(n, n, hessian.values().size(), 0, CHOLMOD_REAL, &common_);
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
    matrix_ = cholmod_triplet_to_sparse(triplets, triplets->nnz, &common_);
    cholmod_free_triplet(&triplets, &common_);
  }

  std::unique_ptr<detail::NormalEquations> ours_;
  std::vector<std::unique_ptr<detail::NormalEquations>> systems_;
  cholmod_common common_{};
  cholmod_sparse* matrix_ = nullptr;
  std::vector<cholmod_factor*> factors_;
};

void compare_files(const std::string& folder) {
  std::printf("%-16s %8s %8s | %5s %9s %7s | %5s %9s %7s | %9s %7s %10s %7s\n", "file", "F ms", "own ms",
              "fact", "ours ms", "/F/fact", "iter", "Ceres ms", "ratio", "marg ms", "/F", "Ceres ms",
              "ratio");
  for (const auto& path : g2o_files(folder)) {
    const PoseGraph start = read_bench_graph(path).graph;
    OptimizationResult ours = optimize(start);
    PoseGraph optimum = start;
    optimum.set_poses(ours.poses);
    Yardstick yardstick(optimum);
    CeresOutcome peer;
    Marginals covariances;
    // QR of the larger graphs takes minutes and gigabytes.
    const bool small = start.nodes().size() <= 1300;
    double trace = -1.0;
    std::vector<std::function<void()>> works{
        [&] { ours = optimize(start); }, [&] { peer = ceres_optimize(start); },
        [&] { covariances = marginals(optimum); }, [&] { yardstick.run_ours(); }};
    for (std::size_t variant = 0; variant < Yardstick::kVariants; ++variant) {
      works.emplace_back([&yardstick, variant] { yardstick.run(variant); });
    }
    if (small) works.emplace_back([&] { trace = ceres_marginal_trace(optimum); });
    const std::vector<double> ms = medians_in_turns(works);
    const double f = *std::min_element(ms.begin() + 4, ms.begin() + 4 + Yardstick::kVariants);
    const double covariance_ms = small ? ms.back() : 0.0;
    std::printf("%-16s %8.2f %8.2f | %5d %9.2f %7.2f | %5d %9.1f %7.1f | %9.2f %7.2f %10.1f %7.1f\n",
                path.stem().c_str(), f, ms[3], ours.factorizations, ms[0], ms[0] / f / ours.factorizations,
                peer.iterations, ms[1], ms[1] / ms[0], ms[2], ms[2] / f, covariance_ms,
                covariance_ms / ms[2]);
    std::printf("%-16s cost %.12g, Ceres %.12g; trace full %.9g, translation %.9g, Ceres full %.9g\n", "",
                ours.cost, peer.cost, covariances.trace_full, covariances.trace_translation, trace);
    std::fflush(stdout);
  }
}

/// ½ Σ min(r², c²) at the optimum of the true closures; odometry and priors are not truncated.
double truncated_cost_of_labels(const BenchGraph& graph, const std::vector<Eigen::Isometry3d>& clean) {
  const double c2 = chi_squared_quantile(GncOptions().inlier_probability, 6);
  double cost = 0.0;
  for (std::size_t e = 0; e < graph.graph.edges().size(); ++e) {
    const double r2 = squared_residual(graph.graph, e, clean);
    cost += 0.5 * (known_inlier(graph.graph.edges()[e]) ? r2 : std::min(r2, c2));
  }
  return cost;
}

void show_gnc(const BenchGraph& graph) {
  GncResult result;
  GncOptions graduation;
  graduation.second_start = false;
  const std::vector<double> ms =
      medians_in_turns({[&] { result = optimize_gnc(graph.graph); },
                        [&] { static_cast<void>(optimize_gnc(graph.graph, {}, graduation)); }});
  const Verdict v = judge(graph, [&](std::size_t e) { return result.weights[e] > 0.5; });
  const auto clean = optimize(without_false(graph)).poses;
  std::printf("%-22s %8.1f %8.1f %-12s %6d %6d %7.4f %9.4f %10.3g %12.6g %12.6g\n", graph.name.c_str(), ms[0],
              ms[1], enum_name(result.start).c_str(), result.outer_iterations,
              result.optimization.factorizations, v.recall, v.precision,
              mean_distance(result.optimization.poses, clean), result.truncated_cost,
              truncated_cost_of_labels(graph, clean));
  std::fflush(stdout);
}

/// The files of a folder; then a clean one with random false closures, 10, 30 and 50 % of all.
void compare_gnc(const std::string& folder, const std::string& clean) {
  std::printf("%-22s %8s %8s %-12s %6s %6s %7s %9s %10s %12s %12s\n", "file", "ms", "alone ¹", "start",
              "outer", "fact", "recall", "precision", "ATE m", "trunc. cost", "of labels");
  std::printf("¹ graduation from the first estimate alone, gnc.second_start=false\n");
  for (const auto& path : g2o_files(folder)) show_gnc(read_bench_graph(path));
  if (clean.empty()) return;
  for (const int percent : {10, 30, 50}) {
    BenchGraph graph = read_bench_graph(clean);
    const std::size_t count = closures_of(graph.graph) * static_cast<std::size_t>(percent) /
                              static_cast<std::size_t>(100 - percent);
    add_random_false(graph, count, static_cast<std::uint64_t>(percent));
    graph.name += " + " + std::to_string(count);
    show_gnc(graph);
  }
}

/// Times of one family of graphs by number of poses.
struct Growth {
  std::string family, colour;
  std::vector<std::array<double, 4>> rows;  ///< poses; ms of optimisation, marginals and Ceres, 0 if not run
};

/// Both axes logarithmic: a straight line of slope 1 is linear growth.
void write_growth(const std::vector<Growth>& families, const std::string& path) {
  constexpr double kLeft = 70, kTop = 20, kWidth = 560, kHeight = 360, kDecadesX = 2, kDecadesY = 5;
  const auto x = [&](double poses) { return kLeft + kWidth * (std::log10(poses) - 3.0) / kDecadesX; };
  const auto y = [&](double ms) { return kTop + kHeight * (1.0 - std::log10(ms) / kDecadesY); };
  std::ofstream out(path);
  out << std::fixed << std::setprecision(1);
  out << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 860 430\" font-family=\"sans-serif\" "
         "font-size=\"13\">\n<rect width=\"860\" height=\"430\" fill=\"white\"/>\n";
  const auto line = [&](double x1, double y1, double x2, double y2, const char* style) {
    out << "<line x1=\"" << x1 << "\" y1=\"" << y1 << "\" x2=\"" << x2 << "\" y2=\"" << y2 << "\" " << style
        << "/>\n";
  };
  const auto text = [&](double at_x, double at_y, const std::string& anchor, const std::string& what) {
    out << "<text x=\"" << at_x << "\" y=\"" << at_y << "\" text-anchor=\"" << anchor << "\">" << what
        << "</text>\n";
  };
  const char* grid = "stroke=\"#ddd\"";
  const char* time_names[] = {"1 ms", "10 ms", "100 ms", "1 s", "10 s", "100 s"};
  for (int d = 0; d <= kDecadesY; ++d) {
    line(kLeft, y(std::pow(10.0, d)), kLeft + kWidth, y(std::pow(10.0, d)), grid);
    text(kLeft - 8, y(std::pow(10.0, d)) + 4, "end", time_names[d]);
  }
  for (const double poses : {1e3, 3e3, 1e4, 3e4, 1e5}) {
    line(x(poses), kTop, x(poses), kTop + kHeight, grid);
    text(x(poses), kTop + kHeight + 20, "middle", std::to_string(static_cast<int>(poses)));
  }
  text(kLeft + kWidth / 2, kTop + kHeight + 42, "middle", "poses");
  const char* dashes[] = {"", " stroke-dasharray=\"7 4\"", " stroke-dasharray=\"2 4\""};
  const char* names[] = {"optimise", "marginals", "Ceres"};
  double legend = kTop + 10;
  for (const Growth& family : families) {
    for (std::size_t series = 1; series < 4; ++series) {
      const std::string stroke =
          "fill=\"none\" stroke-width=\"2\" stroke=\"" + family.colour + "\"" + dashes[series - 1];
      out << "<polyline " << stroke << " points=\"";
      for (const auto& row : family.rows) {
        if (row[series] > 0.0) out << x(row[0]) << ',' << y(row[series]) << ' ';
      }
      out << "\"/>\n";
      line(kLeft + kWidth + 15, legend - 4, kLeft + kWidth + 45, legend - 4, stroke.c_str());
      text(kLeft + kWidth + 52, legend, "start", family.family + ", " + names[series - 1]);
      legend += 22;
    }
    legend += 12;
  }
  out << "</svg>\n";
}

void compare_sizes(std::size_t largest, std::size_t smallest, const std::string& picture) {
  std::vector<Growth> families{
      {"one robot", "#1b6ca8", {}}, {"several robots", "#c0392b", {}}, {"lattice", "#2e7d32", {}}};
  std::printf("%-28s %8s %8s %10s %5s %12s %12s %10s %8s\n", "graph", "poses", "edges", "ms", "fact", "cost",
              "marginals ms", "Ceres ms", "peak GiB");
  const auto show = [](const BenchGraph& graph, bool with_ceres, Growth& growth) {
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
    growth.rows.push_back({static_cast<double>(graph.graph.nodes().size()), ms, marginals_ms, peer});
  };
  for (const std::size_t poses : {1000U, 3000U, 10000U, 30000U, 100000U}) {
    if (poses < smallest || poses > largest) continue;
    show(streets(poses, poses / 10, 1, 1), poses <= 10000, families[0]);
    show(streets(poses, 2 * poses, std::max<std::size_t>(2, poses / 5000), 2), poses <= 10000, families[1]);
    if (poses <= 10000) show(lattice(poses, 3), poses <= 3000, families[2]);
  }
  if (!picture.empty()) write_growth(families, picture);
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
  } else if (what == "gnc" && (argc == 3 || argc == 4)) {
    bench::compare_gnc(argv[2], argc > 3 ? argv[3] : "");
  } else if (what == "sizes") {
    const auto bound = [&](int i, std::size_t otherwise) {
      return argc > i ? static_cast<std::size_t>(std::atoll(argv[i])) : otherwise;
    };
    bench::compare_sizes(bound(2, 10000), bound(3, 0), argc > 4 ? argv[4] : "");
  } else if (what == "groups") {
    bench::compare_groups();
  } else if (what == "batches") {
    bench::compare_batches(argc > 2 ? static_cast<std::size_t>(std::atoll(argv[2])) : 10000,
                           argc > 3 ? static_cast<std::uint64_t>(std::atoll(argv[3])) : 1);
  } else if (what == "hard") {
    bench::compare_hard(argc > 2 ? static_cast<std::uint64_t>(std::atoll(argv[2])) : 1,
                        argc > 3 ? argv[3] : "", argc > 4 ? argv[4] : "");
  } else if (what == "certify" && argc > 2) {
    bench::certify_files({argv + 2, argv + argc});
  } else if (what == "planar" && argc == 3) {
    bench::compare_planar(argv[2]);
  } else if (what == "gtsam" && (argc == 3 || argc == 4)) {
    return bench::compare_gtsam(argv[2], argc > 3 ? argv[3] : "") ? 0 : 1;
  } else {
    std::fprintf(
        stderr,
        "usage: %s files FOLDER | gnc FOLDER [CLEAN.g2o] | sizes [LARGEST [SMALLEST [SVG]]] | "
        "groups | hard [SEED [FOLDER [FILTER]]] | batches [POSES [SEED]] | certify FILE... | planar FOLDER | "
        "gtsam FOLDER [FILTER]\n",
        argv[0]);
    return 2;
  }
  return 0;
}
