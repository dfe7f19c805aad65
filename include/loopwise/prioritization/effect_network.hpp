// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/prioritization/closure_effects.hpp>
#include <loopwise/prioritization/graph_objective.hpp>

namespace loopwise {

/// The Loopwise network: predicts e(PG ∪ l) from the effect of each closure alone (ClosureEffects). A graph
/// network on the bipartite graph of the set's closures c and the units u:
///
///     m_cu   = exp(W₂ s(W₁ a_cu + b₁) + b₂ + W₀ a_cu)
///     P_u    = log(1 + Σ_{c∈l} m_cu)
///     p_u    = log(1 + Σ_c (e^r_cu − 1))
///     q_u    = ⅙ log(1 + Σ_c (e^(6 r_cu) − 1))
///     g      = Σ_u share_u · [P_u, p_u, q_u]
///     n_u    = mean of [P, p, q] over the anchors next to u's on its chain of odometry
///     (α, β) = V₃ s(V₂ s(V₁ [P_u, p_u, q_u, n_u, g, f_u] + c₁) + c₂) + c₃
///     y_u    = q_u + σ(α)(p_u − q_u) + β (1 − e^−p_u)
///     e      = e(PG) · Σ_u share_u · e^−y_u
///
/// with a_cu the normalised edge features, f_u the normalised unit features, r_cu the log_reduction of c at
/// u, s(x) = x / (1 + |x|) and σ the logistic function. m and P have K channels, with which P can represent
/// values between the largest message and the sum of all; g is the mean over the whole graph; y_u predicts
/// log(v / v'), and is 0 without closures.
///
/// p is the effect of independent closures, q nearly that of the best alone. Differences from the paper's
/// network: exact single effects on the edges, an aggregation that is neither sum nor mean, and a logarithm
/// relative to no closures as output.
///
/// **File**: JSON as GraphNetwork's, `kind` of `__meta__` "loopwise"; tensors edge.mean, edge.std (9),
/// unit.mean, unit.std (5), message.0.{weight M×9, bias M}, message.1.{weight K×M, bias K},
/// message.skip.weight K×9, readout.0.{weight H×(3(K+2)+5), bias H}, readout.1.{weight H×H, bias H},
/// readout.2.{weight 2×H, bias 2}.
class LOOPWISE_EXPORT EffectNetwork {
 public:
  /// \throws IoError; InputError naming file and tensor if the file holds no such network
  explicit EffectNetwork(const std::filesystem::path& weights);
  ~EffectNetwork();
  EffectNetwork(EffectNetwork&&) noexcept;
  EffectNetwork& operator=(EffectNetwork&&) noexcept;

  /// e(PG ∪ set), m². \throws InputError on a candidate that does not exist
  [[nodiscard]] double evaluate(const ClosureEffects& effects, const std::vector<std::size_t>& set) const;

 private:
  friend class EffectObjective;
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

/// The prediction of the Loopwise network for the graph with a set of closures. A swap changes two messages
/// of each unit: its cost does not depend on the size of the graph, and hardly on that of the set.
class LOOPWISE_EXPORT EffectObjective final : public GraphObjective {
 public:
  /// \throws as CovarianceObjective; InputError on a null network
  EffectObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                  std::shared_ptr<const EffectNetwork> network, const ClosureModelOptions& options,
                  const ClosureModel& model);
  /// An objective with known effects.
  EffectObjective(ClosureEffects effects, std::shared_ptr<const EffectNetwork> network);
  ~EffectObjective() override;

  [[nodiscard]] std::string_view name() const override { return "gnn"; }
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

  /// The network's input.
  [[nodiscard]] const ClosureEffects& effects() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The kind of network in a weights file: "paper" (GraphNetwork) or "loopwise" (EffectNetwork).
/// \throws IoError; InputError if it is not a weights file, or of another kind
[[nodiscard]] LOOPWISE_EXPORT std::string network_kind(const std::filesystem::path& weights);

}  // namespace loopwise
