// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/prioritization/graph_objective.hpp>

namespace loopwise {

/// Which coordinates of the poses the trace counts.
enum class TraceKind {
  kTranslation,  ///< Positions, m².
  kFull,         ///< Positions and rotations, m² + rad².
};
[[nodiscard]] inline EnumNames<TraceKind> enum_names(TraceKind) {
  return {{TraceKind::kTranslation, "translation"}, {TraceKind::kFull, "full"}};
}

/// Representation of the data for evaluations in CovarianceObjective.
enum class BlockStorage {
  kAutomatic,  ///< Dense for few candidates, columns otherwise; the bound is measured.
  kColumns,    ///< Columns of Σ by sparse solves with the factor of the current set: a move costs one
               ///< factorisation for any number of candidates, and nothing drifts.
  kDense,      ///< S and M of all pairs of candidates: an evaluation costs a 12×12 problem, a move a rank-12
               ///< and a rank-24 update; recomputed from a factorisation after some moves.
};
[[nodiscard]] inline EnumNames<BlockStorage> enum_names(BlockStorage) {
  return {{BlockStorage::kAutomatic, "automatic"},
          {BlockStorage::kColumns, "columns"},
          {BlockStorage::kDense, "dense"}};
}

/// Model of a candidate's closure, and the computation of its effect.
struct ClosureModelOptions {
  /// Standard deviation of the translation of a hypothetical closure along each axis, m.
  double sigma_m = 0.1;
  /// Standard deviation of the rotation of a hypothetical closure about each axis, rad.
  double sigma_rad = 0.02;
  /// Part of the covariance in the trace: translation or full.
  TraceKind trace = TraceKind::kTranslation;
  /// Storage of the blocks: automatic, columns or dense.
  BlockStorage storage = BlockStorage::kAutomatic;
  /// Dense storage: number of moves between two factorisations from scratch.
  std::int64_t dense_refresh = 64;
  /// Number of threads. 0: one per processor. It changes the run time, never a result.
  int threads = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("sigma_m", self.sigma_m, above(0.0));
    field("sigma_rad", self.sigma_rad, above(0.0));
    field("trace", self.trace, any_value());
    field("storage", self.storage, any_value());
    field("dense_refresh", self.dense_refresh, at_least(1));
    field("threads", self.threads, between(0, 1024));
  }
};

/// Hypothetical closures of a list of candidates at a graph's estimate: Z = T_from⁻¹·T_to, information from
/// the sigmas or a covariance.
struct ClosureModel {
  Matrix6d covariance;  ///< Of every candidate, [translation, rotation], m² and rad².
  /// Factor of each candidate's information, in [0, 1]; empty: 1. Below 1 for less certain closures.
  std::vector<double> information_factors;
};

/// Σ⁻¹ = diag(sigma_m², sigma_rad²). \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT ClosureModel closure_model(const ClosureModelOptions& options);

/// e(PG ∪ l), exact: the trace of the poses' marginal covariances with the set's closures added, Σ = H⁻¹ of
/// the Gauss-Newton Hessian at the graph's poses and weights. The paper trains a network to predict this
/// figure.
///
/// With J, W the stacked Jacobians and information of a change (W negative for closures that leave), the
/// trace changes by −tr((W⁻¹ + JΣJᵀ)⁻¹ · JΣPᵀPΣJᵀ), with Σ of the current set and the selection P of
/// coordinates: a 6×6 problem for one closure, 12×12 for a swap.
///
/// Poses of a component without a prior count relative to its first node; connecting candidates change
/// nothing.
class LOOPWISE_EXPORT CovarianceObjective final : public GraphObjective {
 public:
  /// \throws OptionError; UnknownKeyError if a candidate's node is not in the graph; InputError on a model
  /// that is not finite, and naming a node if the graph's factors do not determine its pose.
  CovarianceObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                      const ClosureModelOptions& options = {});
  /// With a user-defined model.
  CovarianceObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                      const ClosureModelOptions& options, const ClosureModel& model);
  ~CovarianceObjective() override;

  [[nodiscard]] std::string_view name() const override { return "covariance"; }
  [[nodiscard]] std::size_t size() const override;
  [[nodiscard]] const std::vector<std::size_t>& selected() const override;
  [[nodiscard]] bool contains(std::size_t candidate) const override;
  [[nodiscard]] double value() override;
  [[nodiscard]] double add_change(std::size_t candidate) override;
  [[nodiscard]] double remove_change(std::size_t candidate) override;
  [[nodiscard]] double swap_change(std::size_t out, std::size_t in) override;
  [[nodiscard]] std::vector<double> add_changes() override;
  void assign(const std::vector<std::size_t>& set) override;
  void add(std::size_t candidate) override;
  void remove(std::size_t candidate) override;
  void swap(std::size_t out, std::size_t in) override;
  [[nodiscard]] bool connecting(std::size_t candidate) const override;

  /// The representation in use: kColumns or kDense.
  [[nodiscard]] BlockStorage storage() const;
  /// Numeric factorisations made so far.
  [[nodiscard]] std::size_t factorizations() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// log det Σ of the graph with the set's closures: D-optimality, for pose graphs the count of spanning trees
/// (Khosoussi et al., IJRR 2019). Submodular, so lazy greedy choice is exact. Otherwise like
/// CovarianceObjective.
class LOOPWISE_EXPORT LogDetObjective final : public GraphObjective {
 public:
  /// \throws as CovarianceObjective
  LogDetObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                  const ClosureModelOptions& options = {});
  /// With a user-defined model.
  LogDetObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                  const ClosureModelOptions& options, const ClosureModel& model);
  ~LogDetObjective() override;

  [[nodiscard]] std::string_view name() const override { return "log_det"; }
  [[nodiscard]] std::size_t size() const override;
  [[nodiscard]] const std::vector<std::size_t>& selected() const override;
  [[nodiscard]] bool contains(std::size_t candidate) const override;
  [[nodiscard]] double value() override;
  [[nodiscard]] double add_change(std::size_t candidate) override;
  [[nodiscard]] double remove_change(std::size_t candidate) override;
  [[nodiscard]] double swap_change(std::size_t out, std::size_t in) override;
  [[nodiscard]] std::vector<double> add_changes() override;
  void assign(const std::vector<std::size_t>& set) override;
  void add(std::size_t candidate) override;
  void remove(std::size_t candidate) override;
  void swap(std::size_t out, std::size_t in) override;
  [[nodiscard]] bool connecting(std::size_t candidate) const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Gains of single closures on the graph without a set, −add_change(), estimated from random probes: with U =
/// L⁻ᵀz and V = ΣPᵀz for `probes` random sign vectors z, S ≈ JUUᵀJᵀ and M ≈ JVVᵀJᵀ. The error of an entry is
/// about √(2/probes) of it; apart from the solves, the cost does not depend on the graph's size. 0 for
/// connecting candidates. \throws like CovarianceObjective.
[[nodiscard]] LOOPWISE_EXPORT std::vector<double> sketched_gains(
    const PoseGraph& graph, const std::vector<LoopCandidate>& candidates, const ClosureModelOptions& options,
    const ClosureModel& model, std::size_t probes = 64, std::uint64_t seed = 1);

/// Up to `count` candidates of high gain, spread over the graph: within each pair of cells of `cell_m` that
/// candidates join the best by gain, then the second best of each, and so on, each round by falling gain.
/// \returns places in the list, ascending.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::size_t> spread_shortlist(
    const PoseGraph& graph, const std::vector<LoopCandidate>& candidates, const std::vector<double>& gains,
    std::size_t count, double cell_m = 10.0);

}  // namespace loopwise
