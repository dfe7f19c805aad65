// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Data for training and evaluation of networks: sets of closures added to pose graphs, with the exact trace
/// of each. Nothing here needs libtorch.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/closure_effects.hpp>
#include <loopwise/prioritization/gnn.hpp>

namespace loopwise::training {

/// Which graphs are cut out of a mission and which sets are added to them.
struct DataOptions {
  std::int64_t candidates = 200;
  std::int64_t max_set = 50;
  std::int64_t random_sets = 40;
  std::int64_t annealing_runs = 4;
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("candidates", self.candidates, between(8, 5000), "Loop candidates of a graph, at most.");
    field("max_set", self.max_set, between(2, 1000), "Closures of a set, at most.");
    field("random_sets", self.random_sets, between(8, 10000), "Random sets of each graph.");
    field("annealing_runs", self.annealing_runs, between(0, 1000),
          "Runs of annealing on the exact objective that sets are taken from, for each graph.");
    field("seed", self.seed, at_least(0), "Of everything random.");
  }
};

/// Input of the graphs from a mission: odometry, priors and stamps, no scans.
struct MissionRecord {
  std::string name;
  std::string group;        ///< Missions of one world; the split takes from every group.
  bool other_size = false;  ///< Of a size that nothing is trained on: for the test alone.
  Robots robots;
  PoseGraph graph;
};
/// \throws InputError if the mission has fewer than 20 nodes or nothing joins them
[[nodiscard]] MissionRecord record_of(const Mission& mission, std::string group, bool other_size);

/// A moment of a mission: the nodes of its first part, and closures found so far.
struct Stage {
  double fraction = 1.0;           ///< Of the nodes, by their stamps.
  double closures_per_node = 0.0;  ///< Random candidates already closed.
};
[[nodiscard]] const std::vector<Stage>& stages();

/// The graph of a stage, with candidates in random order. A function of (record, stage, count, seed).
struct StageGraph {
  PoseGraph graph;
  std::vector<LoopCandidate> candidates;
};
[[nodiscard]] StageGraph stage_graph(const MissionRecord& record, const Stage& stage, std::size_t count,
                                     std::uint64_t seed);

/// A set of candidates of a graph, and the exact answer.
struct TrainingSet {
  std::vector<std::uint32_t> members;
  double trace_m2 = 0.0;   ///< e(PG ∪ set)
  Eigen::VectorXf relief;  ///< unit_reliefs()
};

struct TrainingGraph {
  std::size_t stage = 0;
  GraphNetwork::Input input;                                  ///< Of the paper's network, without a set.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> ends;  ///< Node numbers of the candidates.
  ClosureEffects effects;
  std::vector<TrainingSet> sets;  ///< The first is empty. Some differ from the one before by one swap.
};

/// Everything of one mission: one file.
struct MissionData {
  MissionRecord record;
  std::vector<TrainingGraph> graphs;
};

/// Cuts the stages out of a mission and solves the sets exactly. Stages with fewer than 8 candidates are left
/// out. A function of (record, options). \throws InputError
[[nodiscard]] MissionData make_mission_data(const MissionRecord& record, const DataOptions& options,
                                            const StopToken& stop = {});

/// Of all that a file of it holds.
[[nodiscard]] ContentHash hash_of(const MissionData& data);

/// One binary file (CBOR) for a mission, written in one step. `made_with` says what it is a function of.
void write_mission_data(const std::filesystem::path& path, const MissionData& data,
                        const std::string& made_with = "");
/// A whole file that was made with the same is there.
[[nodiscard]] bool has_mission_data(const std::filesystem::path& path, const std::string& made_with);
/// \throws IoError; InputError naming the file and the field on a file that was cut short, is of another
/// version, contradicts itself or holds a number that is not finite
[[nodiscard]] MissionData read_mission_data(const std::filesystem::path& path);

/// A folder of data: dataset.json, written last, and missions/NAME.cbor.
struct DataSetEntry {
  std::string name, group, file;
  bool other_size = false;
};
void write_data_set(const std::filesystem::path& folder, const std::vector<DataSetEntry>& entries,
                    const DataOptions& options);
struct DataSet {
  std::filesystem::path folder;
  DataOptions options;
  std::vector<DataSetEntry> entries;
  [[nodiscard]] MissionData read(std::size_t entry) const;
};
/// \throws IoError; InputError if the folder is no finished data set or holds no missions
[[nodiscard]] DataSet read_data_set(const std::filesystem::path& folder);

enum class Role { kTrain, kValidation, kTest };
[[nodiscard]] inline EnumNames<Role> enum_names(Role) {
  return {{Role::kTrain, "train"}, {Role::kValidation, "validation"}, {Role::kTest, "test"}};
}

/// Gives each whole mission one role: 5 of 8 train, 1 validates, 2 test, in each group as far as it goes;
/// those of other sizes test. A function of (names, groups, seed), for any order of the entries. \throws
/// InputError unless every role gets a mission: 3 are needed.
[[nodiscard]] std::vector<Role> split_by_mission(const std::vector<DataSetEntry>& entries,
                                                 std::uint64_t seed);

}  // namespace loopwise::training
