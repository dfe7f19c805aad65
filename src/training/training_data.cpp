// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/training/training_data.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/selection.hpp>

namespace loopwise::training {
namespace {

constexpr std::size_t kFewestNodes = 20;
constexpr std::size_t kFewestCandidates = 8;

std::uint64_t hash_of_text(const std::string& text) {
  return ContentHasher().text(text).finish().low;
}

Edge closure_at_estimate(const PoseGraph& graph, const LoopCandidate& candidate,
                         const Matrix6d& information) {
  Edge edge;
  edge.from = candidate.from;
  edge.to = candidate.to;
  edge.T_from_to = graph.node(edge.from).pose.inverse() * graph.node(edge.to).pose;
  edge.information = information;
  return edge;
}

Matrix6d closure_information(const ClosureModel& model) {
  const Matrix6d information = model.covariance.inverse();
  return 0.5 * (information + information.transpose());
}

/// Members of a random set from one area of the graph.
std::vector<std::size_t> cluster(const std::vector<Eigen::Vector3d>& midpoints, std::size_t count, Rng& rng) {
  std::vector<std::size_t> all(midpoints.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  rng.shuffle(all);
  const Eigen::Vector3d centre = midpoints[all[0]];
  all.resize(std::min(all.size(), 3 * count));
  std::stable_sort(all.begin(), all.end(), [&](std::size_t a, std::size_t b) {
    return (midpoints[a] - centre).squaredNorm() < (midpoints[b] - centre).squaredNorm();
  });
  all.resize(std::min(all.size(), count));
  return all;
}

/// The sets of one graph. A set from annealing is followed by one that differs by a swap.
std::vector<std::vector<std::size_t>> choose_sets(const StageGraph& stage, const DataOptions& options,
                                                  Rng& rng) {
  const std::size_t L = stage.candidates.size();
  const std::size_t most = std::min(static_cast<std::size_t>(options.max_set), L / 2);
  const std::vector<Eigen::Vector3d> midpoints = candidate_midpoints(stage.graph, stage.candidates);
  std::vector<std::vector<std::size_t>> out{{}};
  std::vector<std::size_t> all(L);
  std::iota(all.begin(), all.end(), std::size_t{0});
  for (std::int64_t k = 0; k < options.random_sets; ++k) {
    std::size_t size = 1 + rng.below(most);
    if (k % 5 == 3) size = 1 + rng.below(std::min<std::size_t>(most, 8));
    if (k % 5 == 4) {
      out.push_back(cluster(midpoints, size, rng));
      continue;
    }
    rng.shuffle(all);
    out.emplace_back(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(size));
  }
  ClosureModelOptions closures;
  closures.storage = BlockStorage::kColumns;  // cheaper, because most moves of the hot phase are accepted
  CovarianceObjective exact(stage.graph, stage.candidates, closures);
  for (std::int64_t run = 0; run < options.annealing_runs; ++run) {
    const std::size_t sizes[] = {5, 20, 50, 2 + rng.below(most - 1)};
    const std::size_t size = std::min(sizes[run % 4], most);
    SimulatedAnnealing annealing(exact, midpoints, size, {}, rng());
    for (const std::uint64_t more : {0U, 120U, 150U, 300U, 600U, 1200U}) {
      annealing.run(more);
      std::vector<std::size_t> members = exact.selected();
      out.push_back(members);
      std::size_t in = rng.below(L);
      while (exact.contains(in)) in = rng.below(L);
      members[rng.below(members.size())] = in;
      out.push_back(std::move(members));
    }
  }
  return out;
}

TrainingGraph solve(const StageGraph& stage, std::size_t number, const DataOptions& options, Rng& rng,
                    const StopToken& stop) {
  TrainingGraph out;
  out.stage = number;
  const ClosureModelOptions closures;
  const ClosureModel model = closure_model(closures);
  out.effects = closure_effects(stage.graph, stage.candidates, closures, model);
  const std::vector<Matrix6d> covariances = marginals(stage.graph).covariances;
  out.input = graph_input(stage.graph, GnnFeatures::kWorld, covariances);
  for (const LoopCandidate& c : stage.candidates) {
    out.ends.emplace_back(static_cast<std::uint32_t>(stage.graph.index_of(c.from)),
                          static_cast<std::uint32_t>(stage.graph.index_of(c.to)));
  }
  const Matrix6d information = closure_information(model);
  for (const std::vector<std::size_t>& members : choose_sets(stage, options, rng)) {
    if (stop.stop_requested()) throw Error("interrupted");
    PoseGraph with = stage.graph;
    for (const std::size_t c : members) {
      with.add_edge(closure_at_estimate(stage.graph, stage.candidates[c], information));
    }
    const Marginals solved = marginals(with);
    TrainingSet set;
    for (const std::size_t c : members) set.members.push_back(static_cast<std::uint32_t>(c));
    set.trace_m2 = solved.trace_translation;
    set.log_reduction = unit_log_reductions(out.effects, stage.graph, solved.covariances).cast<float>();
    out.sets.push_back(std::move(set));
  }
  return out;
}

}  // namespace

MissionRecord record_of(const Mission& mission, std::string group, bool other_size) {
  MissionRecord record;
  record.name = mission.name;
  record.group = std::move(group);
  record.other_size = other_size;
  record.robots = mission.robots;
  record.graph = mission.graph;
  record.graph.remove_edges_if([](const Edge& edge) { return edge.kind != EdgeKind::kOdometry; });
  if (record.graph.nodes().size() < kFewestNodes) {
    throw InputError("mission " + mission.name + " has " + std::to_string(record.graph.nodes().size()) +
                     " nodes, " + std::to_string(kFewestNodes) + " are needed");
  }
  if (record.graph.edges().empty()) throw InputError("mission " + mission.name + " has no odometry");
  return record;
}

const std::vector<Stage>& stages() {
  static const std::vector<Stage> all{{0.3, 0.0}, {0.6, 0.0}, {1.0, 0.0}, {0.6, 0.03}, {1.0, 0.06}};
  return all;
}

StageGraph stage_graph(const MissionRecord& record, const Stage& stage, std::size_t count,
                       std::uint64_t seed) {
  std::vector<std::int64_t> stamps;
  for (const Node& node : record.graph.nodes()) stamps.push_back(node.stamp_ns);
  const std::size_t keep = std::clamp<std::size_t>(
      static_cast<std::size_t>(std::lround(stage.fraction * static_cast<double>(stamps.size()))), 1,
      stamps.size());
  std::nth_element(stamps.begin(), stamps.begin() + static_cast<std::ptrdiff_t>(keep - 1), stamps.end());
  const std::int64_t last = stamps[keep - 1];

  StageGraph out;
  for (const Node& node : record.graph.nodes()) {
    if (node.stamp_ns <= last) out.graph.add_node(node);
  }
  for (const PriorFactor& prior : record.graph.priors()) {
    if (out.graph.contains(prior.key)) out.graph.add_prior(prior);
  }
  for (const Edge& edge : record.graph.edges()) {
    if (out.graph.contains(edge.from) && out.graph.contains(edge.to)) out.graph.add_edge(edge);
  }
  ProximityGenerator generator(proximity_preset("lamp_base"), record.robots);
  for (const Node& node : out.graph.nodes()) {
    for (const LoopCandidate& c : generator.on_node(out.graph, node.key, 0.0)) out.candidates.push_back(c);
  }
  Rng rng(combine_seeds(seed, hash_of_text(record.name)));
  rng.shuffle(out.candidates);
  const auto closed = std::min(out.candidates.size() / 2,
                               static_cast<std::size_t>(std::lround(
                                   stage.closures_per_node * static_cast<double>(out.graph.nodes().size()))));
  const Matrix6d information = closure_information(closure_model({}));
  for (std::size_t k = 0; k < closed; ++k) {
    out.graph.add_edge(closure_at_estimate(out.graph, out.candidates.back(), information));
    out.candidates.pop_back();
  }
  if (out.candidates.size() > count) out.candidates.resize(count);
  return out;
}

MissionData make_mission_data(const MissionRecord& record, const DataOptions& options,
                              const StopToken& stop) {
  validate(options);
  MissionData out;
  out.record = record;
  for (std::size_t s = 0; s < stages().size(); ++s) {
    const std::uint64_t seed = combine_seeds(options.seed, s);
    const StageGraph stage =
        stage_graph(record, stages()[s], static_cast<std::size_t>(options.candidates), seed);
    if (stage.candidates.size() < kFewestCandidates) continue;
    Rng rng(combine_seeds(seed, hash_of_text(record.name + " sets")));
    out.graphs.push_back(solve(stage, s, options, rng, stop));
  }
  if (out.graphs.empty()) {
    throw InputError("mission " + record.name + " has fewer than " + std::to_string(kFewestCandidates) +
                     " loop candidates: it does not revisit places");
  }
  return out;
}

std::vector<Role> split_by_mission(const std::vector<DataSetEntry>& entries, std::uint64_t seed) {
  std::vector<Role> roles(entries.size(), Role::kTest);
  std::map<std::string, std::vector<std::size_t>> groups;
  std::set<std::string> names;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    if (!names.insert(entries[i].name).second) {
      throw InputError(
          "mission " + entries[i].name +
          " is in the data twice: one copy could be used for training and the other for the test");
    }
    if (!entries[i].other_size) groups[entries[i].group].push_back(i);
  }
  constexpr Role kDealt[] = {Role::kTrain, Role::kValidation, Role::kTest,  Role::kTrain,
                             Role::kTrain, Role::kTest,       Role::kTrain, Role::kTrain};
  std::vector<std::size_t> order;
  for (auto& [group, members] : groups) {
    std::sort(members.begin(), members.end(), [&](std::size_t a, std::size_t b) {
      const auto rank = [&](std::size_t i) { return combine_seeds(seed, hash_of_text(entries[i].name)); };
      return rank(a) != rank(b) ? rank(a) < rank(b) : entries[a].name < entries[b].name;
    });
    order.insert(order.end(), members.begin(), members.end());
  }
  for (std::size_t k = 0; k < order.size(); ++k) roles[order[k]] = kDealt[k % std::size(kDealt)];
  if (order.size() < 3) {
    throw InputError("the data hold " + std::to_string(order.size()) +
                     (order.size() == 1 ? " mission" : " missions") +
                     " to train with, 3 are needed: one each for training, validation and test");
  }
  return roles;
}

}  // namespace loopwise::training
