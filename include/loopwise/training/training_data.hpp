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
#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/closure_effects.hpp>
#include <loopwise/prioritization/gnn.hpp>

namespace loopwise::training {

/// Selection of graphs from a mission, and of the sets that are added to them.
struct DataOptions {
  /// Maximum number of loop candidates of a graph.
  std::int64_t candidates = 200;
  /// Maximum number of closures in a set.
  std::int64_t max_set = 50;
  /// Number of random sets of each graph.
  std::int64_t random_sets = 40;
  /// Number of runs of annealing on the exact objective that provide sets, for each graph.
  std::int64_t annealing_runs = 4;
  /// Seed of all random draws.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("candidates", self.candidates, between(8, 5000));
    field("max_set", self.max_set, between(2, 1000));
    field("random_sets", self.random_sets, between(8, 10000));
    field("annealing_runs", self.annealing_runs, between(0, 1000));
    field("seed", self.seed, at_least(0));
  }
};

/// Input of the graphs from a mission: odometry, priors and stamps, no scans.
struct MissionRecord {
  std::string name;         ///< Of the mission.
  std::string group;        ///< Missions of one world; the split takes from every group.
  bool other_size = false;  ///< Its size does not occur in training: for the test only.
  Robots robots;            ///< Owners of the nodes.
  PoseGraph graph;          ///< Only odometry and priors.
};
/// Extracts the input of the graphs from a mission. \throws InputError if the mission has fewer than 20 nodes
/// or no edges between them
[[nodiscard]] LOOPWISE_EXPORT MissionRecord record_of(const Mission& mission, std::string group,
                                                      bool other_size);

/// A moment of a mission: the nodes of its first part, and the closures found so far.
struct Stage {
  double fraction = 1.0;           ///< Share of the nodes, by their stamps.
  double closures_per_node = 0.0;  ///< Number of random closures per node.
};
/// The stages of a mission.
[[nodiscard]] LOOPWISE_EXPORT const std::vector<Stage>& stages();

/// The graph of a stage, and its possible closures.
struct StageGraph {
  PoseGraph graph;                        ///< Nodes of the stage and the closures found so far.
  std::vector<LoopCandidate> candidates;  ///< In random order.
};
/// The graph of a stage with `count` candidates at most. A function of (record, stage, count, seed).
[[nodiscard]] LOOPWISE_EXPORT StageGraph stage_graph(const MissionRecord& record, const Stage& stage,
                                                     std::size_t count, std::uint64_t seed);

/// A set of candidates of a graph, with the exact result.
struct TrainingSet {
  std::vector<std::uint32_t> members;  ///< Numbers of its candidates.
  double trace_m2 = 0.0;               ///< e(PG ∪ set)
  Eigen::VectorXf log_reduction;       ///< unit_log_reductions()
};

/// A graph with its candidates, the inputs of the networks, and the sets with their exact results.
struct TrainingGraph {
  std::size_t stage = 0;                                      ///< Place in stages().
  GraphNetwork::Input input;                                  ///< Of the paper's network, without a set.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> ends;  ///< Node numbers of the candidates.
  ClosureEffects effects;                                     ///< Of the Loopwise network, without a set.
  std::vector<TrainingSet> sets;  ///< The first is empty. Some differ from the previous one by one swap.
};

/// All data of one mission, which are one file.
struct MissionData {
  MissionRecord record;               ///< The input of the graphs.
  std::vector<TrainingGraph> graphs;  ///< Of its stages.
};

/// Makes the graphs of all stages of a mission and solves the sets exactly. Stages with fewer than 8
/// candidates are left out. A function of (record, options). \throws InputError
[[nodiscard]] LOOPWISE_EXPORT MissionData make_mission_data(const MissionRecord& record,
                                                            const DataOptions& options,
                                                            const StopToken& stop = {});

/// Hash of all contents of the file.
[[nodiscard]] LOOPWISE_EXPORT ContentHash hash_of(const MissionData& data);

/// Writes one binary file (CBOR) per mission, in one step. `made_with` states the input that determines the
/// contents.
LOOPWISE_EXPORT void write_mission_data(const std::filesystem::path& path, const MissionData& data,
                                        const std::string& made_with = "");
/// Whether a complete file with the same `made_with` exists.
[[nodiscard]] LOOPWISE_EXPORT bool has_mission_data(const std::filesystem::path& path,
                                                    const std::string& made_with);
/// Reads a file of write_mission_data(). \throws IoError; InputError naming the file and the field if the
/// file is cut short, is of another version, contradicts itself or has a number that is not finite
[[nodiscard]] LOOPWISE_EXPORT MissionData read_mission_data(const std::filesystem::path& path);

/// A mission of a folder of data.
struct DataSetEntry {
  std::string name;         ///< Of the mission.
  std::string group;        ///< As MissionRecord::group.
  std::string file;         ///< Within the folder.
  bool other_size = false;  ///< As MissionRecord::other_size.
};
/// Writes dataset.json, which marks a folder of data as complete. The files of the missions exist already.
LOOPWISE_EXPORT void write_data_set(const std::filesystem::path& folder,
                                    const std::vector<DataSetEntry>& entries, const DataOptions& options);
/// A folder of data: dataset.json and missions/NAME.cbor.
struct LOOPWISE_EXPORT DataSet {
  std::filesystem::path folder;       ///< Path of the folder.
  DataOptions options;                ///< Options of its data.
  std::vector<DataSetEntry> entries;  ///< Its missions.
  /// Reads the file of an entry. \throws as read_mission_data()
  [[nodiscard]] MissionData read(std::size_t entry) const;
};
/// Reads dataset.json. \throws IoError; InputError if the folder is not a complete data set or has no
/// missions
[[nodiscard]] LOOPWISE_EXPORT DataSet read_data_set(const std::filesystem::path& folder);

/// Role of a mission.
enum class Role {
  kTrain,       ///< Weights are fitted to it.
  kValidation,  ///< Decides which epoch is best.
  kTest,        ///< Measures the quality of the network.
};
[[nodiscard]] inline EnumNames<Role> enum_names(Role) {
  return {{Role::kTrain, "train"}, {Role::kValidation, "validation"}, {Role::kTest, "test"}};
}

/// Gives each mission one role: in each group about 5 of 8 train, 1 validates, 2 test; missions of other
/// sizes test. A function of (names, groups, seed), for any order of the entries. \throws InputError unless
/// every role gets a mission, which needs at least 3.
[[nodiscard]] LOOPWISE_EXPORT std::vector<Role> split_by_mission(const std::vector<DataSetEntry>& entries,
                                                                 std::uint64_t seed);

}  // namespace loopwise::training
