// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>
#include <loopwise/prioritization/gnn_features.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/prioritization/selection.hpp>

namespace loopwise {

class EffectNetwork;
class GraphNetwork;

/// Score of a set of closures.
enum class ObjectiveKind {
  kCovariance,  ///< CovarianceObjective
  kLogDet,      ///< LogDetObjective
  kGnn,         ///< GnnObjective or EffectObjective, by the weights file.
};
[[nodiscard]] inline EnumNames<ObjectiveKind> enum_names(ObjectiveKind) {
  return {{ObjectiveKind::kCovariance, "covariance"},
          {ObjectiveKind::kLogDet, "log_det"},
          {ObjectiveKind::kGnn, "gnn"}};
}

/// Selection of the set.
enum class SelectorKind {
  kGreedyAnnealing,    ///< Greedy choice, then annealing from it in the remaining time.
  kGreedy,             ///< Greedy choice alone.
  kAnnealing,          ///< Annealing from the set of maximal spread, as in the paper.
  kSeparated,          ///< Maximal spread of the midpoints alone.
  kLargestCovariance,  ///< Candidates between the nodes of largest uncertainty.
};
[[nodiscard]] inline EnumNames<SelectorKind> enum_names(SelectorKind) {
  return {{SelectorKind::kGreedyAnnealing, "greedy_annealing"},
          {SelectorKind::kGreedy, "greedy"},
          {SelectorKind::kAnnealing, "annealing"},
          {SelectorKind::kSeparated, "separated"},
          {SelectorKind::kLargestCovariance, "largest_covariance"}};
}

/// Covariance of a hypothetical closure.
enum class ClosureCovariance {
  kSigmas,  ///< diag(sigma_m², sigma_rad²)
  kMedian,  ///< Element-wise median of the diagonals of the closures verified so far; the sigmas until then.
};
[[nodiscard]] inline EnumNames<ClosureCovariance> enum_names(ClosureCovariance) {
  return {{ClosureCovariance::kSigmas, "sigmas"}, {ClosureCovariance::kMedian, "median"}};
}

/// Options of graph information.
struct GraphInformationOptions {
  /// Objective that scores sets: covariance, log_det or gnn.
  ObjectiveKind objective = ObjectiveKind::kCovariance;
  /// Method that chooses the set: greedy_annealing, greedy, annealing, separated or largest_covariance.
  SelectorKind selector = SelectorKind::kGreedyAnnealing;
  /// Covariance of a hypothetical closure: sigmas, or the median of the closures verified so far.
  ClosureCovariance covariance = ClosureCovariance::kSigmas;
  /// The set is chosen from a shortlist of this many times its size. The shortlist takes candidates by
  /// approximate gain, spread over the graph.
  double shortlist = 4.0;
  /// Number of random probes for the approximate gain. The relative error is about sqrt(2 / probes).
  std::int64_t probes = 64;
  /// Edge of the cells over which the shortlist is spread, m.
  double cell_m = 10.0;
  /// Candidates are given up if the graph lacks their nodes for longer than this, s. 0: never.
  double max_wait_s = 600.0;
  /// Objective gnn: file with the weights of the network, of the paper's kind or of Loopwise's.
  std::string gnn_weights;
  /// Objective gnn, the paper's kind: node features, world or lamp.
  GnnFeatures gnn_features = GnnFeatures::kWorld;
  /// Seed of annealing and probes.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("objective", self.objective, any_value());
    field("selector", self.selector, any_value());
    field("covariance", self.covariance, any_value());
    field("shortlist", self.shortlist, at_least(1.0));
    field("probes", self.probes, at_least(1));
    field("cell_m", self.cell_m, above(0.0));
    field("max_wait_s", self.max_wait_s, at_least(0.0));
    field("gnn_weights", self.gnn_weights, any_value());
    field("gnn_features", self.gnn_features, any_value());
    field("seed", self.seed, at_least(0));
  }
};

/// Chooses sets that lower the uncertainty of the whole graph (paper §III-B). The set is chosen among all
/// pending candidates, or, when they are many, a shortlist; improve() improves it within its bounds. Every
/// candidate counts as if it were certain to become a closure, as in the paper. ExpectedPrioritizer weights
/// it by the probability of success.
///
/// A set is valid for its candidates, graph and count: when one of them has changed, the next improve() or
/// take() starts again.
///
/// Candidates with nodes that are not yet in the graph wait; take() holds them back.
class LOOPWISE_EXPORT GraphInformationPrioritizer final : public Prioritizer {
 public:
  /// \throws OptionError; IoError or InputError if the objective's weights cannot be read.
  GraphInformationPrioritizer(const GraphInformationOptions& options, const ClosureModelOptions& closures,
                              const AnnealingOptions& annealing, const GreedyOptions& greedy = {});
  ~GraphInformationPrioritizer() override;

  [[nodiscard]] std::string_view name() const override { return "gi"; }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override;
  void on_graph(const PoseGraph& graph) override;
  void on_result(const RegistrationResult& result) override;
  /// The bound and the result count swaps of the annealing. The first call for a set chooses it greedily,
  /// without a bound and without stopping.
  std::uint64_t improve(std::size_t count, const StopToken& stop,
                        std::uint64_t max_evaluations = std::numeric_limits<std::uint64_t>::max()) override;
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override;
  [[nodiscard]] std::size_t size() const override { return held_.size(); }
  [[nodiscard]] std::vector<Refusal> give_up(double now_s) override;

  /// Figures of the prepared set; value and start are 0 without a set.
  struct Status {
    double start_value = 0.0;    ///< Before annealing.
    double value = 0.0;          ///< Of the present set.
    std::uint64_t steps = 0;     ///< Swaps that annealing tried.
    std::uint64_t accepted = 0;  ///< Swaps that were accepted.
    std::size_t pool = 0;        ///< Pending candidates with nodes in the graph.
    std::size_t shortlist = 0;   ///< Those of them from which the set is chosen.
    std::string problem;         ///< Why spread replaced the score of the graph; else empty.
  };
  /// Figures after the last change of the set.
  [[nodiscard]] const Status& status() const { return status_; }

  /// Estimated gains of all pending candidates on the graph without a set, for display; 0 if a node is
  /// missing or the candidate connects.
  [[nodiscard]] std::map<CandidateId, double> sketch() const;

 private:
  struct Prepared;
  void prepare(std::size_t count);
  void choose(Prepared& prepared, std::size_t count);
  /// The next of them, to `count` in `out`; what `held_` had of them goes to `taken`.
  void take(std::size_t count, std::vector<std::map<CandidateId, LoopCandidate>::node_type>& taken,
            std::vector<LoopCandidate>& out);
  void finish();
  [[nodiscard]] ClosureModel model() const;

  GraphInformationOptions options_;
  ClosureModelOptions closure_options_;
  AnnealingOptions annealing_options_;
  GreedyOptions greedy_options_;
  std::shared_ptr<const GraphNetwork> network_;
  std::shared_ptr<const EffectNetwork> effect_network_;
  PoseGraph graph_;
  std::map<CandidateId, LoopCandidate> held_;     // in order of generation
  std::map<CandidateId, LoopCandidate> unknown_;  // of them, those with a node that the graph does not have
  std::vector<Vector6d> accepted_;                // diagonals of the covariances of verified closures
  std::unique_ptr<Prepared> prepared_;
  std::uint64_t round_ = 0;  // sets chosen so far: each has its own seed
  Status status_;
};

}  // namespace loopwise
