// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/prioritization/gnn_features.hpp>
#include <loopwise/prioritization/graph_objective.hpp>

namespace loopwise {

/// The paper's network (§III-B), any number of layers and kernels:
///
///     h = W x + b
///     h_i ← [tanh] mean over edges j→i of Σ_k w_k(e_ji)·h_j·G_k + h_i·Root + bias,
///           w_k(e) = exp(−½ Σ_d (e_d − μ_kd)² / (1e-15 + σ_kd²))        no tanh after the last
///     p = Σ_i h_i;  p ← tanh(Lin_l(BatchNorm(p))) for each dense layer;  y = lin(BatchNorm(p))
///
/// **File**: JSON `{"__meta__": {...}, NAME: {"shape": [...], "data": [flat, by rows]}, ...}` with the
/// tensors node_encoder.{weight H×F, bias H}; conv1 and gcs.0, gcs.1, ... each with {g H×(K·H), mu K×D, sigma
/// K×D, root H×H, bias H}; lins.0, ... {weight H×H, bias H}; batch_norms.1, ... one more than lins, {weight,
/// bias, running_mean, running_var: H}; lin {weight 1×H, bias 1}. Optional: input.mean and input.std (F),
/// with which features are normalised; output.mean and output.std (1), with which y is scaled back;
/// output.log (1): if it is not 0, the scaled y is a logarithm, and the network returns its exponential.
/// Other tensors are ignored. `kind` of `__meta__`, if present, is "paper".
class LOOPWISE_EXPORT GraphNetwork {
 public:
  /// \throws IoError; InputError naming file and tensor on invalid JSON, a network of another kind, and a
  /// tensor that is missing, has another shape or a value that is not finite.
  explicit GraphNetwork(const std::filesystem::path& weights);
  ~GraphNetwork();
  GraphNetwork(GraphNetwork&&) noexcept;
  GraphNetwork& operator=(GraphNetwork&&) noexcept;

  /// Features of a node: F.
  [[nodiscard]] Eigen::Index node_features() const;
  /// Features of an edge: D.
  [[nodiscard]] Eigen::Index edge_features() const;
  /// Width of the hidden layers: H.
  [[nodiscard]] Eigen::Index hidden() const;
  /// Number of graph convolutions.
  [[nodiscard]] std::size_t convolutions() const;

  /// The network's view of a graph.
  struct Input {
    Eigen::MatrixXd nodes;                                       ///< A row of features for each node.
    std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;  ///< Messages go from first to second.
    Eigen::MatrixXd edge_attributes;                             ///< A row for each edge.
  };
  /// y of a whole graph in double precision. \throws InputError if shapes do not fit.
  [[nodiscard]] double evaluate(const Input& input) const;
  /// The same in single precision, as the network was trained.
  [[nodiscard]] float evaluate_single(const Input& input) const;

 private:
  friend class GnnObjective;
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

/// The network's input for a graph without a set: features of the nodes, a self loop for each prior, a
/// directed edge for each odometry and each closure that the back end keeps; types one-hot. `covariances` as
/// GnnObjective takes them. \throws InputError on another number of covariances
[[nodiscard]] LOOPWISE_EXPORT GraphNetwork::Input graph_input(const PoseGraph& graph, GnnFeatures features,
                                                              const std::vector<Matrix6d>& covariances);

/// The prediction of the network for the graph with a set of closures. One direction, from → to, as in
/// training. A swap is evaluated on the nodes downstream of the two `to` nodes alone.
class LOOPWISE_EXPORT GnnObjective final : public GraphObjective {
 public:
  /// `covariances` are the marginal ones of the graph's nodes, as in Marginals; if they are not finite or
  /// missing (an empty list) features are 0.
  /// \throws UnknownKeyError; InputError on another number of covariances or a null or unfit network
  GnnObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
               std::shared_ptr<const GraphNetwork> network, GnnFeatures features,
               const std::vector<Matrix6d>& covariances);
  ~GnnObjective() override;

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

  /// The network's input for the current set, as for a full evaluation.
  [[nodiscard]] GraphNetwork::Input input() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
