// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Small missions to train with: quick to make and to solve.
#pragma once

#include <string>
#include <vector>

#include <loopwise/training/training_data.hpp>

#include "optimization/support.hpp"

namespace loopwise::testing {

/// A walk of one robot, about 1 m from node to node.
inline training::MissionRecord small_record(const std::string& name, std::uint64_t seed,
                                            std::size_t nodes = 40, const std::string& group = "walk") {
  Rng rng(seed);
  RandomGraphOptions shape;
  shape.nodes = nodes;
  shape.closures = 0;
  Mission mission;
  mission.name = name;
  const PoseGraph made = random_graph(rng, shape).graph;
  for (Node node : made.nodes()) {
    node.stamp_ns = static_cast<std::int64_t>(node.key) * 1000000000;
    mission.graph.add_node(node);
  }
  for (const PriorFactor& prior : made.priors()) mission.graph.add_prior(prior);
  for (const Edge& edge : made.edges()) mission.graph.add_edge(edge);
  mission.robots = Robots::from_keys(mission.graph.keys());
  return training::record_of(mission, group, false);
}

inline training::DataOptions small_options() {
  training::DataOptions options;
  options.candidates = 20;
  options.max_set = 8;
  options.random_sets = 10;
  options.annealing_runs = 1;
  return options;
}

inline std::vector<training::MissionData> small_data(std::size_t count, std::uint64_t seed = 1) {
  std::vector<training::MissionData> out;
  for (std::size_t k = 0; k < count; ++k) {
    out.push_back(training::make_mission_data(small_record("walk" + std::to_string(k), seed + k, 34 + 4 * k),
                                              small_options()));
  }
  return out;
}

/// A finished data set in a folder.
inline void write_small_data_set(const fs::path& folder, std::size_t count) {
  fs::create_directories(folder / "missions");
  std::vector<training::DataSetEntry> entries;
  for (const training::MissionData& mission : small_data(count)) {
    const std::string file = "missions/" + mission.record.name + ".cbor";
    training::write_mission_data(folder / file, mission);
    entries.push_back({mission.record.name, mission.record.group, file, false});
  }
  training::write_data_set(folder, entries, small_options());
}

}  // namespace loopwise::testing
