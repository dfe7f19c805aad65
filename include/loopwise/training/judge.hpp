// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Quality of a network: its error, its order of sets of one graph, and the exact trace of the sets that are
/// chosen with it. Nothing here needs libtorch.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/prioritization/effect_network.hpp>
#include <loopwise/prioritization/gnn.hpp>
#include <loopwise/training/training_data.hpp>

namespace loopwise::training {

/// Effort of the evaluation of networks.
struct JudgeOptions {
  /// Sizes B of the sets.
  std::vector<double> set_sizes = {5.0, 20.0, 50.0};
  /// Maximum number of loop candidates of a graph.
  std::int64_t candidates = 300;
  /// Number of random sets of each kind and size.
  std::int64_t sets = 100;
  /// Evaluations of the objective in a run of annealing, including those that find its scale.
  std::int64_t evaluations = 3000;
  /// Number of swaps of a run of exact annealing for which the sign of the change is compared.
  std::int64_t swaps = 150;
  /// Seed of all random draws.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("set_sizes", self.set_sizes, between(1.0, 1000.0));
    field("candidates", self.candidates, between(8, 5000));
    field("sets", self.sets, between(3, 10000));
    field("evaluations", self.evaluations, between(1, 10000000));
    field("swaps", self.swaps, between(1, 100000));
    field("seed", self.seed, at_least(0));
  }
};

/// A network under evaluation.
struct Judged {
  std::string name;                               ///< In the tables.
  std::shared_ptr<const GraphNetwork> paper;      ///< A network of the paper's kind; otherwise null.
  std::shared_ptr<const EffectNetwork> loopwise;  ///< A network of Loopwise's own kind; otherwise null.
  GnnFeatures features = GnnFeatures::kWorld;     ///< Input features for a network of the paper's kind.
};
/// Reads a weights file. "FILE:lamp" gives the network the inputs of LAMP. The name is that of the file.
/// \throws IoError, InputError
[[nodiscard]] LOOPWISE_EXPORT Judged read_judged(const std::string& argument);

/// One method on one graph with one B.
struct Judgement {
  std::string mission;       ///< Mission of the graph.
  std::string group;         ///< As MissionRecord::group.
  std::string method;        ///< A network's name, or that of another method.
  bool other_size = false;   ///< As MissionRecord::other_size.
  std::size_t stage = 0;     ///< Place in stages().
  std::size_t nodes = 0;     ///< Of the graph.
  std::size_t set_size = 0;  ///< B.
  /// Median |log(ê / e)| over (a): the relative error of the trace. NaN if the method gives no prediction;
  /// this also holds for the following figures.
  double log_error = 0.0;
  double spearman_mixed = 0.0;  ///< (a) Random sets of 0 to B closures.
  double spearman_fixed = 0.0;  ///< (b) Random sets of B closures.
  double signs = 0.0;           ///< (c) Share of swaps along an annealing run whose δ has the right sign.
  double chosen = 0.0;          ///< Exact e / e(PG) of the chosen set.
};

/// Spearman's rank correlation; ties have their mean rank. NaN for fewer than 3 pairs or if either is
/// constant.
[[nodiscard]] LOOPWISE_EXPORT double spearman(const std::vector<double>& a, const std::vector<double>& b);

/// All methods on the stages of a mission: each network; `additive`, the sum of the exact gains of the single
/// closures; exact annealing and greedy choice; maximal separation; random choice.
/// \throws Error if stopped
[[nodiscard]] LOOPWISE_EXPORT std::vector<Judgement> judge(const MissionRecord& record,
                                                           const std::vector<Judged>& networks,
                                                           const JudgeOptions& options,
                                                           const StopToken& stop = {});

/// Medians by set size, over the missions of training sizes and over those of other sizes.
struct JudgementTables {
  std::string json;      ///< A list of rows, with quartiles.
  std::string markdown;  ///< The same as a table.
};
/// Makes tables of evaluations.
[[nodiscard]] LOOPWISE_EXPORT JudgementTables summarize(const std::vector<Judgement>& judgements);

}  // namespace loopwise::training
