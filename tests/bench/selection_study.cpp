// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How well selectors choose, on simulated graphs: the table and the pictures of docs/prioritization.md.
///
///     loopwise_selection_study run WEIGHTS.json OUT.csv FIRST COUNT   rows of world,seed,method,budget,ratio
///     loopwise_selection_study table OUT.csv                      medians by world
///     loopwise_selection_study picture WORLD SEED OUT.svg         chosen and other candidates on the map
#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <numeric>
#include <sstream>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>
#include <loopwise/prioritization/gnn.hpp>
#include <loopwise/prioritization/selection.hpp>
#include <loopwise/simulation/simulate.hpp>

using namespace loopwise;

namespace {

constexpr std::size_t kCandidates = 500;
constexpr std::size_t kBatch = 100;
constexpr double kSeconds = 0.5;               // of processor time, for each anytime method
constexpr std::uint64_t kEvaluations = 10000;  // the other budget: the steps of Algorithm 1 in the benchmark
constexpr double kLengthM = 1000.0;            // driven by all robots together

double cpu() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Instance {
  PoseGraph graph;
  std::vector<LoopCandidate> candidates;
  std::vector<Eigen::Vector3d> midpoints;
};

/// The odometry of a simulated mission, and random ones of its proximity candidates.
Instance make_problem(WorldKind world, std::uint64_t seed) {
  SimulationOptions options;
  options.world = world;
  options.length_m = kLengthM;
  options.radio = options.communication_gaps = false;
  const SimulatedMission simulated =
      simulate(options, seed, {}, {}, [](Key, const PointCloud&) { /* scans are not needed */ });
  Instance p;
  p.graph = simulated.mission.graph;
  p.graph.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry; });
  ProximityGenerator generator(proximity_preset("lamp_base"), simulated.mission.robots);
  for (const Node& node : p.graph.nodes()) {
    for (const LoopCandidate& c : generator.on_node(p.graph, node.key, 0.0)) p.candidates.push_back(c);
  }
  Rng rng(seed);
  rng.shuffle(p.candidates);
  if (p.candidates.size() > kCandidates) p.candidates.resize(kCandidates);
  p.midpoints = candidate_midpoints(p.graph, p.candidates);
  return p;
}

/// Anneals within a budget of processor time or of evaluations, whichever is given.
std::vector<std::size_t> anneal(GraphObjective& objective, const Instance& p, std::uint64_t seed,
                                const std::vector<std::size_t>& start, double seconds,
                                std::uint64_t evaluations) {
  const double begin = cpu();
  SimulatedAnnealing annealing(objective, p.midpoints, kBatch, {}, seed, start);
  while (annealing.evaluations() < evaluations && cpu() - begin < seconds) {
    annealing.run(std::min<std::uint64_t>(50, evaluations - annealing.evaluations()));
  }
  const Selection best = annealing.best();
  if (best.value > annealing.start_value()) std::abort();  // never above the start
  return best.set;
}

void run(const std::string& weights, const std::string& out_path, std::uint64_t first, std::uint64_t count) {
  std::ofstream out(out_path);
  out << "world,seed,method,budget,ratio\n";
  const auto network = std::make_shared<const GraphNetwork>(weights);
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    for (const auto& [world, name] : enum_names(WorldKind{})) {
      const Instance p = make_problem(world, seed);
      const std::vector<Matrix6d> covariances = marginals(p.graph).covariances;
      CovarianceObjective exact(p.graph, p.candidates);
      const double none = exact.value();
      const auto report = [&, world_name = std::string(name)](const std::string& method,
                                                              const std::string& budget,
                                                              const std::vector<std::size_t>& set) {
        CovarianceObjective judge(p.graph, p.candidates);
        judge.assign(set);
        out << world_name << "," << seed << "," << method << "," << budget << "," << judge.value() / none
            << "\n"
            << std::flush;
      };
      const double endless = 1e9;
      const std::uint64_t many = std::uint64_t{1} << 60;
      const double begin = cpu();
      const Selection chosen = greedy(exact, p.midpoints, kBatch);
      const double greedy_s = cpu() - begin;
      GreedyOptions lazy_options;
      lazy_options.lazy = true;
      const Selection lazy = greedy(exact, p.midpoints, kBatch, lazy_options);
      report("greedy", "time", chosen.set);
      report("greedy", "evaluations", lazy.set);
      report("greedy_annealing", "time",
             anneal(exact, p, seed, chosen.set, std::max(0.0, kSeconds - greedy_s), many));
      report(
          "greedy_annealing", "evaluations",
          anneal(exact, p, seed, lazy.set, endless, kEvaluations - std::min(kEvaluations, lazy.evaluations)));
      report("annealing", "time", anneal(exact, p, seed, {}, kSeconds, many));
      report("annealing", "evaluations", anneal(exact, p, seed, {}, endless, kEvaluations));
      GnnObjective gnn(p.graph, p.candidates, network, GnnFeatures::kWorld, covariances);
      report("annealing_gnn", "time", anneal(gnn, p, seed, {}, kSeconds, many));
      report("annealing_gnn", "evaluations", anneal(gnn, p, seed, {}, endless, kEvaluations));
      report("separated", "none", farthest_points(p.midpoints, kBatch));
      report("largest_covariance", "none", largest_covariance(p.graph, p.candidates, covariances, kBatch));
      std::vector<std::size_t> all(p.candidates.size());
      std::iota(all.begin(), all.end(), std::size_t{0});
      all.resize(std::min(kBatch, all.size()));  // they are shuffled
      report("random", "none", all);
      std::cerr << name << " " << seed << ": " << p.graph.nodes().size() << " nodes, greedy " << greedy_s
                << " s, lazy " << lazy.evaluations << " evaluations\n";
    }
  }
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  const double at = q * static_cast<double>(values.size() - 1);
  const auto low = static_cast<std::size_t>(at);
  const std::size_t high = std::min(low + 1, values.size() - 1);
  return values[low] + (at - static_cast<double>(low)) * (values[high] - values[low]);
}

void table(const std::string& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  std::map<std::pair<std::string, std::string>, std::map<std::string, std::vector<double>>> ratios;
  std::vector<std::pair<std::string, std::string>> order;
  while (std::getline(in, line)) {
    std::istringstream cells(line);
    std::string world, seed, method, budget, ratio;
    std::getline(cells, world, ',');
    std::getline(cells, seed, ',');
    std::getline(cells, method, ',');
    std::getline(cells, budget, ',');
    std::getline(cells, ratio, ',');
    const std::pair<std::string, std::string> row(method, budget);
    if (ratios.count(row) == 0) order.push_back(row);
    ratios[row][world].push_back(std::stod(ratio));
  }
  std::printf("| selector | budget |");
  for (const auto& [kind, name] : enum_names(WorldKind{})) std::printf(" %s |", std::string(name).c_str());
  std::printf("\n| --- | --- | --- | --- | --- | --- |\n");
  for (const auto& row : order) {
    std::printf("| %s | %s |", row.first.c_str(), row.second.c_str());
    for (const auto& [kind, name] : enum_names(WorldKind{})) {
      const auto& values = ratios[row][std::string(name)];
      if (values.empty()) {
        std::printf(" |");
      } else {
        std::printf(" %.4f (%.4f–%.4f) |", quantile(values, 0.5), quantile(values, 0.25),
                    quantile(values, 0.75));
      }
    }
    std::printf("\n");
  }
  std::printf("%zu seeds of each world\n", order.empty() ? 0 : ratios[order[0]].begin()->second.size());
}

void picture(const std::string& world, std::uint64_t seed, const std::string& path) {
  const Instance p = make_problem(parse_enum<WorldKind>("world", world), seed);
  CovarianceObjective objective(p.graph, p.candidates);
  const Selection chosen = greedy(objective, p.midpoints, 50);
  Eigen::Vector3d low = p.graph.nodes()[0].pose.translation(), high = low;
  for (const Node& node : p.graph.nodes()) {
    low = low.cwiseMin(node.pose.translation());
    high = high.cwiseMax(node.pose.translation());
  }
  const double scale = 860.0 / std::max(1.0, high.x() - low.x());
  const auto x = [&](Key key) { return 20.0 + scale * (p.graph.node(key).pose.translation().x() - low.x()); };
  const auto y = [&](Key key) {
    return 20.0 + scale * (high.y() - p.graph.node(key).pose.translation().y());
  };
  std::ofstream out(path);
  char text[256];
  const auto segment = [&](Key a, Key b, const char* style) {
    std::snprintf(text, sizeof text, "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" %s/>\n", x(a),
                  y(a), x(b), y(b), style);
    out << text;
  };
  std::snprintf(text, sizeof text,
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"900\" height=\"%.0f\" "
                "font-family=\"sans-serif\" font-size=\"13\">\n",
                70.0 + scale * (high.y() - low.y()));
  out << text << "<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
  for (const LoopCandidate& c : p.candidates)
    segment(c.from, c.to, "stroke=\"#c8ccd2\" stroke-width=\"0.7\"");
  for (const Edge& edge : p.graph.edges())
    segment(edge.from, edge.to, "stroke=\"#30363d\" stroke-width=\"1.4\"");
  for (const std::size_t i : chosen.set) {
    segment(p.candidates[i].from, p.candidates[i].to, "stroke=\"#d1242f\" stroke-width=\"1.6\"");
  }
  std::snprintf(text, sizeof text,
                "<text x=\"20\" y=\"%.0f\">%s, seed %llu: %zu candidates (grey), the 50 chosen first (red), "
                "odometry (black)</text>\n</svg>\n",
                55.0 + scale * (high.y() - low.y()), world.c_str(), static_cast<unsigned long long>(seed),
                p.candidates.size());
  out << text;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.size() == 5 && words[0] == "run") {
    run(words[1], words[2], std::stoull(words[3]), std::stoull(words[4]));
  } else if (words.size() == 2 && words[0] == "table") {
    table(words[1]);
  } else if (words.size() == 4 && words[0] == "picture") {
    picture(words[1], std::stoull(words[2]), words[3]);
  } else {
    std::cerr << "run WEIGHTS.json OUT.csv FIRST COUNT | table OUT.csv | picture WORLD SEED OUT.svg\n";
    return 2;
  }
  return 0;
}
