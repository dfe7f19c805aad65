// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Figures of docs/prioritization.md. Processor time of the calling thread unless wall time is stated.
///
///     loopwise_prioritization_bench annealing GRAPH.g2o        Algorithm 1 on |L| = 500, B = 250, exact
///     loopwise_prioritization_bench storage GRAPH.g2o          the two ways to hold blocks, by |L|
///     loopwise_prioritization_bench first-batch POSES L B THREADS   sketch, shortlist and greedy choice
///     loopwise_prioritization_bench choosing METHOD POSES L BATCHES THREADS   batches of 100, by expected,
///     gi or both loopwise_prioritization_bench signatures                 of scans: to make, and a pair
///     loopwise_prioritization_bench sketch GRAPH.g2o           error of the probes
///     loopwise_prioritization_bench gnn GRAPH.g2o WEIGHTS.json swap evaluations of the network
#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <numeric>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/expected.hpp>
#include <loopwise/prioritization/gnn.hpp>
#include <loopwise/prioritization/graph_information.hpp>

#include "optimization_graphs.hpp"

using namespace loopwise;

namespace {

double cpu() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double wall() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

double memory_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

/// Odometry and priors alone.
PoseGraph bare(const PoseGraph& graph) {
  PoseGraph out = graph;
  out.remove_edges_if([](const Edge& edge) { return edge.to != edge.from + 1; });
  return out;
}

/// The `count` pairs of nodes that lie nearest to each other, not counting neighbours along a path; a random
/// sample of those within `radius_m` if that is given.
std::vector<LoopCandidate> nearby_pairs(const PoseGraph& graph, std::size_t count, double radius_m,
                                        std::uint64_t seed) {
  const auto& nodes = graph.nodes();
  const auto distance = [&](std::size_t i, std::size_t j) {
    return (nodes[i].pose.translation() - nodes[j].pose.translation()).norm();
  };
  if (radius_m <= 0.0) {
    std::vector<std::size_t> histogram(100000, 0);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
      for (std::size_t j = 0; j + 10 < i; ++j) {
        ++histogram[std::min<std::size_t>(99999, static_cast<std::size_t>(4.0 * distance(i, j)))];
      }
    }
    std::size_t bin = 0;
    for (std::size_t sum = 0; bin + 1 < histogram.size() && sum < count; ++bin) sum += histogram[bin];
    radius_m = static_cast<double>(bin) / 4.0;
  }
  std::vector<LoopCandidate> out;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (std::size_t j = 0; j + 10 < i; ++j) {
      if (distance(i, j) >= radius_m) continue;
      LoopCandidate c;
      c.from = nodes[i].key;
      c.to = nodes[j].key;
      c.distance_m = distance(i, j);
      out.push_back(c);
    }
  }
  Rng rng(seed);
  rng.shuffle(out);
  if (out.size() > count) out.resize(count);
  for (std::size_t i = 0; i < out.size(); ++i) out[i].id = i;
  std::printf("%zu candidates within %.1f m\n", out.size(), radius_m);
  return out;
}

void annealing(const std::string& path) {
  const PoseGraph graph = bare(bench::read_bench_graph(path).graph);
  const auto candidates = nearby_pairs(graph, 500, 30.0, 1);
  const std::size_t count = candidates.size() / 2;
  const double begin = cpu();
  CovarianceObjective objective(graph, candidates);
  const auto midpoints = candidate_midpoints(graph, candidates);
  SimulatedAnnealing run(objective, midpoints, count, {}, 1);
  run.run(10100);
  const Selection best = run.best();
  std::printf("Algorithm 1: %.2f s, %llu steps, %llu accepted (%.1f %%), e %.6g -> %.6g\n", cpu() - begin,
              static_cast<unsigned long long>(run.steps()), static_cast<unsigned long long>(run.accepted()),
              100.0 * static_cast<double>(run.accepted()) / static_cast<double>(run.steps()),
              run.start_value(), best.value);
  for (const bool lazy : {false, true}) {
    GreedyOptions options;
    options.lazy = lazy;
    const double start = cpu();
    const Selection chosen = greedy(objective, midpoints, count, options);
    std::printf("greedy%s: %.2f s, e = %.6g, %llu gains\n", lazy ? ", lazy" : "", cpu() - start, chosen.value,
                static_cast<unsigned long long>(chosen.evaluations));
  }
  std::vector<double> evaluation, reference;
  for (int k = 0; k < 21; ++k) {
    objective.assign(best.set);
    double start = cpu();
    const double value = objective.value();
    evaluation.push_back(cpu() - start);
    if (value <= 0.0) std::abort();
  }
  PoseGraph closed = graph;
  for (const std::size_t i : best.set) {
    Edge edge;
    edge.from = candidates[i].from;
    edge.to = candidates[i].to;
    edge.T_from_to = graph.node(edge.from).pose.inverse() * graph.node(edge.to).pose;
    edge.information = closure_model({}).covariance.inverse();
    closed.add_edge(edge);
  }
  for (int k = 0; k < 11; ++k) {
    const double start = cpu();
    const Marginals m = marginals(closed);
    reference.push_back(cpu() - start);
    if (m.trace_translation <= 0.0) std::abort();
  }
  std::sort(evaluation.begin(), evaluation.end());
  std::sort(reference.begin(), reference.end());
  std::printf("full exact evaluation of a set: %.2f ms (median of 21); marginals() of the graph: %.2f ms\n",
              1e3 * evaluation[10], 1e3 * reference[5]);
}

void storage(const std::string& path) {
  const PoseGraph graph = bare(bench::read_bench_graph(path).graph);
  for (const std::size_t size : {50U, 100U, 200U, 300U, 500U}) {
    const auto candidates = nearby_pairs(graph, size, 30.0, 1);
    const auto midpoints = candidate_midpoints(graph, candidates);
    for (const BlockStorage way : {BlockStorage::kColumns, BlockStorage::kDense}) {
      ClosureModelOptions options;
      options.storage = way;
      CovarianceObjective objective(graph, candidates, options);
      SimulatedAnnealing run(objective, midpoints, size / 2, {}, 1);
      const double start = cpu();
      run.run(2600);
      const double hot = cpu() - start;
      run.run(7500);
      std::printf("|L| = %zu, %s: 2500 hot steps %.2f s, 7500 cold steps %.2f s, %llu accepted\n", size,
                  enum_name(way).c_str(), hot, cpu() - start - hot,
                  static_cast<unsigned long long>(run.accepted()));
    }
  }
}

void first_batch(std::size_t poses, std::size_t count, std::size_t batch, int threads) {
  const PoseGraph graph = bare(bench::streets(poses, 0, 4, 1).graph);
  const auto candidates = nearby_pairs(graph, count, 0.0, 1);
  ClosureModelOptions closures;
  closures.threads = threads;
  const double start = wall();
  GraphInformationPrioritizer gi({}, closures, {});
  gi.on_graph(graph);
  if (!gi.add(candidates).empty()) std::abort();
  gi.improve(batch, {}, 0);
  const double ready = wall() - start;
  const auto status = gi.status();
  const auto taken = gi.take(batch);
  std::printf(
      "%zu poses, |L| = %zu, B = %zu, %d threads: first batch of %zu after %.2f s wall, "
      "shortlist %zu, e = %.6g (nothing: %.6g), %.0f MB\n",
      graph.nodes().size(), candidates.size(), batch, threads, taken.size(), ready, status.shortlist,
      status.value, marginals(graph).trace_translation, memory_mb());
}

/// A sweep of a street: its ground and its walls.
PointCloud sweep(std::size_t points, std::uint64_t seed) {
  Rng rng(seed);
  PointCloud cloud;
  for (std::size_t i = 0; i < points; ++i) {
    const double x = 60.0 * rng.normal() * 0.4, y = i % 3 == 0   ? 8.0 * rng.uniform(-1.0, 1.0)
                                                    : i % 3 == 1 ? 8.0
                                                                 : -8.0;
    cloud.points.emplace_back(x, y, i % 3 == 0 ? 0.0 : 6.0 * rng.uniform());
  }
  return cloud;
}

void signatures() {
  constexpr int kScans = 200, kPairs = 200000;
  for (const std::size_t points : {1500U, 30000U, 120000U}) {
    std::vector<PointCloud> clouds;
    for (std::uint64_t k = 0; k < 10; ++k) clouds.push_back(sweep(points, k));
    std::vector<ScanSignature> made(10);
    double start = cpu();
    for (int k = 0; k < kScans; ++k) made[k % 10] = ScanSignature(clouds[k % 10]);
    const double to_make = (cpu() - start) / kScans;
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    double sum = 0.0;
    start = cpu();
    for (int k = 0; k < kPairs; ++k) {
      T.translation().x() = 1e-4 * k;
      sum += predicted_overlap(made[k % 10], made[(k / 10) % 10], T);
    }
    const double pair = (cpu() - start) / kPairs;
    std::printf("sweep of %zu points: signature %.3f ms, %zu bytes; a pair %.2f us (mean overlap %.2f)\n",
                points, 1e3 * to_make, made[0].bytes(), 1e6 * pair, sum / kPairs);
  }
}

/// Batches of 100 while the graph gets closures and moves: the time of the first batch, and of the others.
void choosing_by(Prioritizer& method, PoseGraph graph, const std::vector<LoopCandidate>& candidates,
                 int batches) {
  Rng rng(7);
  std::vector<double> seconds;
  const double before = memory_mb();
  for (int b = 0; b < batches; ++b) {
    const double start = wall();
    method.on_graph(graph);
    if (b == 0 && !method.add(candidates).empty()) std::abort();
    method.improve(100, {}, 0);
    const auto batch = method.take(100);
    seconds.push_back(wall() - start);
    std::vector<Edge> closures;
    for (const LoopCandidate& candidate : batch) {
      RegistrationResult result;
      result.candidate = candidate;
      result.reason = RejectionReason::kLowOverlap;
      if (rng.uniform() < 0.5) {
        Edge edge;
        edge.from = candidate.from;
        edge.to = candidate.to;
        edge.T_from_to = graph.node(edge.from).pose.inverse() * graph.node(edge.to).pose;
        edge.information = closure_model({}).covariance.inverse();
        closures.push_back(edge);
        result.reason = RejectionReason::kNone;
        result.closure = LoopClosure{edge.from, edge.to, edge.T_from_to};
      }
      method.on_result(result);
    }
    for (const Edge& edge : closures) graph.add_edge(edge);
    for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
      Eigen::Isometry3d pose = graph.nodes()[i].pose;
      pose.translation() += 0.02 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
      graph.set_pose(graph.nodes()[i].key, pose);
    }
  }
  std::vector<double> later(seconds.begin() + 1, seconds.end());
  std::sort(later.begin(), later.end());
  std::printf("%-9s first batch %.2f s, later ones %.3f s (median; at most %.3f), %.0f MB more\n",
              std::string(method.name()).c_str(), seconds[0], later[later.size() / 2], later.back(),
              memory_mb() - before);
  std::fflush(stdout);
}

void choosing(const std::string& method, std::size_t poses, std::size_t count, int batches, int threads) {
  const PoseGraph graph = bare(bench::streets(poses, 0, 4, 1).graph);
  auto candidates = nearby_pairs(graph, count, 0.0, 1);
  // As they come in a run: node by node.
  std::sort(candidates.begin(), candidates.end(), [](const LoopCandidate& a, const LoopCandidate& b) {
    return std::pair(a.from, a.to) < std::pair(b.from, b.to);
  });
  for (std::size_t i = 0; i < candidates.size(); ++i) candidates[i].id = i;
  ClosureModelOptions closures;
  closures.threads = threads;
  std::printf("%zu poses, %zu candidates, %d threads, wall time\n", graph.nodes().size(), candidates.size(),
              threads);
  std::fflush(stdout);
  if (method != "expected") {
    GraphInformationPrioritizer gi({}, closures, {});
    choosing_by(gi, graph, candidates, batches);
  }
  if (method == "gi") return;
  const auto signature = [](const KeyedScan& scan) { return ScanSignature(sweep(2000, scan.key)); };
  Robot robot;
  robot.name = "all";
  robot.last = ~Key{0};
  ExpectedPrioritizer expected({}, closures, Robots({robot}), signature, 1);
  for (const Node& node : graph.nodes()) expected.on_scan({node.key, 0, nullptr});
  choosing_by(expected, graph, candidates, batches);
}

void sketch(const std::string& path) {
  const PoseGraph graph = bare(bench::read_bench_graph(path).graph);
  const auto candidates = nearby_pairs(graph, 1000, 30.0, 1);
  CovarianceObjective objective(graph, candidates);
  const auto exact = objective.add_changes();
  for (const std::size_t probes : {16U, 64U, 256U, 1024U}) {
    const double start = cpu();
    const auto gains = sketched_gains(graph, candidates, {}, closure_model({}), probes);
    const double seconds = cpu() - start;
    double squares = 0.0, worst = 0.0;
    for (std::size_t i = 0; i < gains.size(); ++i) {
      const double relative = std::abs(gains[i] / -exact[i] - 1.0);
      squares += relative * relative;
      worst = std::max(worst, relative);
    }
    std::printf("%zu probes: rms relative error %.3f (sqrt(2/k) = %.3f), worst %.2f, %.1f ms\n", probes,
                std::sqrt(squares / static_cast<double>(gains.size())),
                std::sqrt(2.0 / static_cast<double>(probes)), worst, 1e3 * seconds);
  }
}

void gnn(const std::string& path, const std::string& weights) {
  const PoseGraph graph = bare(bench::read_bench_graph(path).graph);
  const auto candidates = nearby_pairs(graph, 500, 30.0, 1);
  const auto network = std::make_shared<const GraphNetwork>(weights);
  GnnObjective objective(graph, candidates, network, GnnFeatures::kWorld, marginals(graph).covariances);
  std::vector<std::size_t> set(250);
  std::iota(set.begin(), set.end(), std::size_t{0});
  double start = cpu();
  objective.assign(set);
  const double assigned = cpu() - start;
  const auto input = objective.input();
  start = cpu();
  const double full = network->evaluate(input);
  const double full_s = cpu() - start;
  Rng rng(1);
  start = cpu();
  double sum = 0.0;
  constexpr int kSwaps = 1000;
  for (int k = 0; k < kSwaps; ++k) sum += objective.swap_change(rng.below(250), 250 + rng.below(250));
  const double swaps = cpu() - start;
  std::printf(
      "network: %.0f swap evaluations a second; a full evaluation %.1f ms (%.1f ms node by node); "
      "y = %.4f, mean change %.2g\n",
      kSwaps / swaps, 1e3 * full_s, 1e3 * assigned, full, sum / kSwaps);
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const std::string what = words.empty() ? "" : words[0];
  if (what == "annealing" && words.size() == 2) {
    annealing(words[1]);
  } else if (what == "storage" && words.size() == 2) {
    storage(words[1]);
  } else if (what == "first-batch" && words.size() == 5) {
    first_batch(std::stoul(words[1]), std::stoul(words[2]), std::stoul(words[3]), std::stoi(words[4]));
  } else if (what == "choosing" && words.size() == 6) {
    choosing(words[1], std::stoul(words[2]), std::stoul(words[3]), std::stoi(words[4]), std::stoi(words[5]));
  } else if (what == "signatures" && words.size() == 1) {
    signatures();
  } else if (what == "sketch" && words.size() == 2) {
    sketch(words[1]);
  } else if (what == "gnn" && words.size() == 3) {
    gnn(words[1], words[2]);
  } else {
    std::cerr << "annealing GRAPH | storage GRAPH | first-batch POSES L B THREADS | choosing METHOD POSES L "
                 "BATCHES "
                 "THREADS | signatures | sketch GRAPH | gnn GRAPH "
                 "WEIGHTS\n";
    return 2;
  }
  return 0;
}
