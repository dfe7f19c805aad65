// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_hard.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <map>
#include <thread>
#include <vector>

#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "optimization_graphs.hpp"
#include "optimization_judge.hpp"

namespace loopwise::bench {
namespace {

/// Shares of the closures that have to be found, and bounds on the time.
constexpr double kWanted = 0.99;
constexpr double kMostCleanSolves = 15.0;
/// Solutions whose costs differ by less than this share are the same.
constexpr double kSameCost = 1e-6;

/// A row that takes longer is stopped.
constexpr double kMostSeconds = 60.0;

/// Stops work after some processor time of this process.
class Watchdog {
 public:
  explicit Watchdog(double seconds)
      : thread_([this, limit = process_seconds() + seconds] {
          while (!done_ && process_seconds() < limit)
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
          if (!done_) source_.request_stop();
        }) {}
  ~Watchdog() {
    done_ = true;
    thread_.join();
  }
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

  [[nodiscard]] StopToken token() const { return source_.token(); }

 private:
  static double process_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

  StopSource source_;
  std::atomic<bool> done_{false};
  std::thread thread_;
};

/// Factors on the stated information of odometry and closures.
struct Information {
  const char* name;
  double of_odometry, of_closures;
};
constexpr Information kInformation[] = {
    {"honest", 1.0, 1.0}, {"odometry 3x too sure", 9.0, 1.0}, {"100x too unsure", 1e-4, 1e-4}};

PoseGraph with_information(const PoseGraph& graph, const Information& factors) {
  PoseGraph out = graph;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    out.set_information(e,
                        edge.information * (known_inlier(edge) ? factors.of_odometry : factors.of_closures));
  }
  return out;
}

/// Truncated least squares from the solution without the false closures, for at most kMostSeconds.
GncResult from_labels(const PoseGraph& graph, const std::vector<Eigen::Isometry3d>& clean) {
  const Watchdog watchdog(kMostSeconds);
  PoseGraph at = graph;
  at.set_poses(clean);
  OptimizerOptions options;
  options.initialization = Initialization::kFile;
  GncOptions gnc;
  gnc.kernel = RobustKernel::kTls;
  gnc.second_start = gnc.growth = false;
  gnc.innovation_probability = 1.0;
  return optimize_gnc(at, options, gnc, watchdog.token());
}

std::string cost_text(double cost) {
  char text[32];
  return {text, static_cast<std::size_t>(std::snprintf(text, sizeof text, "%.6g", cost))};
}

/// Counts of the rows of one family with one kind of information.
struct Count {
  int rows = 0, missed = 0, failed = 0, slow = 0;
  double worst_recall = 1.0, worst_precision = 1.0, most_clean_solves = 0.0;
};

class Table {
 public:
  explicit Table(std::string filter) : filter_(std::move(filter)) {}

  /// The graph with each kind of information.
  void show(const std::string& family, const std::string& what, const BenchGraph& graph) {
    for (const Information& information : kInformation) show(family, what, graph, information);
  }

  /// One line: the result and, if closures are wrong, whether a start from the labelled solution ends at a
  /// lower cost. If the result takes odometry as more uncertain than stated, both costs are with that
  /// odometry. Right closures beyond the threshold at the labelled solution are not counted.
  void show(const std::string& family, const std::string& what, const BenchGraph& stated,
            const Information& information) {
    const std::string name = what + ", " + information.name;
    if ((family + " | " + name).find(filter_) == std::string::npos) return;
    BenchGraph graph = stated;
    graph.graph = with_information(stated.graph, information);
    double start = thread_seconds();
    std::vector<Eigen::Isometry3d> clean = optimize(without_false(graph)).poses;
    const double clean_ms = 1e3 * (thread_seconds() - start);
    start = thread_seconds();
    GncResult result;
    {
      const Watchdog watchdog(kMostSeconds);
      result = optimize_gnc(graph.graph, {}, {}, watchdog.token());
    }
    const double ms = 1e3 * (thread_seconds() - start);
    if (!result.odometry_scales.empty()) {
      for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
        const Edge& edge = graph.graph.edges()[e];
        if (edge.kind == EdgeKind::kOdometry)
          graph.graph.set_information(e, edge.information * result.weights[e]);
      }
      clean = optimize(without_false(graph)).poses;
    }
    const double c2 = chi_squared_quantile(GncOptions().inlier_probability, graph.graph.degrees_of_freedom());
    const Verdict v = judge(graph, [&](std::size_t e) {
      return result.weights[e] > 0.5 || (!graph.is_false[e] && squared_residual(graph.graph, e, clean) > c2);
    });
    const bool missed = v.recall < kWanted || v.precision < kWanted;
    const GncResult labels = missed ? from_labels(graph.graph, clean) : GncResult();
    const bool failed = missed && labels.truncated_cost < result.truncated_cost * (1.0 - kSameCost);
    const bool open = missed && !failed && labels.optimization.termination == Termination::kStopped;
    const bool slow = ms > kMostCleanSolves * clean_ms;
    std::printf("%-22s %-44s %7.3f %9.3f %9.1f %6.1f %5d %-16s %11.6g %11s %s%s\n", family.c_str(),
                name.c_str(), v.recall, v.precision, ms, ms / clean_ms, result.optimization.factorizations,
                enum_name(result.start).c_str(), result.truncated_cost,
                missed ? cost_text(labels.truncated_cost).c_str() : "-",
                failed   ? "FAILED"
                : open   ? "labels' solution not finished"
                : missed ? "costs less"
                         : "",
                result.optimization.termination == Termination::kStopped ? " stopped"
                : slow                                                   ? " slow"
                                                                         : "");
    std::fflush(stdout);
    Count& count = counts_[{family, information.name}];
    ++count.rows;
    count.missed += missed ? 1 : 0;
    count.failed += failed ? 1 : 0;
    count.slow += slow ? 1 : 0;
    count.worst_recall = std::min(count.worst_recall, v.recall);
    count.worst_precision = std::min(count.worst_precision, v.precision);
    count.most_clean_solves = std::max(count.most_clean_solves, ms / clean_ms);
  }

  void summarize() const {
    std::printf("\n%-22s %-22s %5s %7s %7s %6s %10s %10s %10s\n", "graph", "information", "rows", "missed",
                "FAILED", "slow", "recall >=", "prec. >=", "/clean <=");
    Count all;
    for (const auto& [key, count] : counts_) {
      std::printf("%-22s %-22s %5d %7d %7d %6d %10.3f %10.3f %10.1f\n", key.first.c_str(), key.second.c_str(),
                  count.rows, count.missed, count.failed, count.slow, count.worst_recall,
                  count.worst_precision, count.most_clean_solves);
      all.rows += count.rows;
      all.missed += count.missed;
      all.failed += count.failed;
      all.slow += count.slow;
    }
    std::printf(
        "%d rows; missed (recall or precision below %.2f): %d, of which FAILED (a start from the labels' "
        "solution\ncosts less): %d; slow (more than %.0f clean solves): %d\n",
        all.rows, kWanted, all.missed, all.failed, kMostCleanSolves, all.slow);
  }

 private:
  const std::string filter_;
  std::map<std::pair<std::string, std::string>, Count> counts_;
};

/// Shares of false closures in %, random and in groups.
void show_family(Table& table, const BenchGraph& family, std::uint64_t seed) {
  const std::size_t closures = closures_of(family.graph);
  const auto wrong = [&](std::size_t percent) { return closures * percent / (100 - percent); };
  for (const std::size_t percent : {10U, 30U, 50U, 70U}) {
    BenchGraph graph = family;
    add_random_false(graph, wrong(percent), seed + percent);
    table.show(family.name, std::to_string(percent) + " % random", graph);
  }
  const std::pair<std::size_t, std::size_t> grouped[] = {{10, 5},  {30, 2},  {30, 5}, {30, 10},
                                                         {30, 20}, {50, 10}, {70, 2}};
  for (const auto& [percent, size] : grouped) {
    if (wrong(percent) < size || family.graph.nodes().size() < 4 * size) continue;
    BenchGraph graph = family;
    add_false_groups(graph, wrong(percent) / size, size, seed + size + 100 * percent);
    table.show(family.name, std::to_string(percent) + " % in groups of " + std::to_string(size), graph);
  }
}

}  // namespace

void compare_hard(std::uint64_t seed, const std::string& folder, const std::string& filter) {
  std::printf("%-22s %-44s %7s %9s %9s %6s %5s %-16s %11s %11s\n", "graph", "false closures, information",
              "recall", "precision", "ms", "/clean", "fact", "start", "trunc. cost", "from labels");
  Table table(filter);
  if (!folder.empty()) {
    for (const auto& path : g2o_files(folder)) {
      const BenchGraph file = read_bench_graph(path);
      if (closures_of(file.graph) > 0) show_family(table, file, seed);
    }
  }
  for (const BenchGraph& family :
       {lattice(1000, seed), grid(1000, seed), streets(2000, 1000, 1, seed), streets(2000, 3000, 4, seed),
        torus(1500, seed), rooms(1500, 3000, seed)}) {
    show_family(table, family, seed);
  }
  for (const BenchGraph& family : {torus(5000, seed), rooms(5000, 10000, seed)}) {
    for (const std::size_t percent : {10U, 30U, 50U}) {
      BenchGraph graph = family;
      add_random_false(graph, closures_of(family.graph) * percent / (100 - percent), seed + percent);
      table.show(family.name, std::to_string(percent) + " % random", graph, kInformation[0]);
    }
  }
  table.summarize();
}

}  // namespace loopwise::bench
