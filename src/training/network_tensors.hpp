// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The two networks in libtorch: graphs as tensors, outputs, and losses.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

// Included before libtorch, which defines macros.
#include <loopwise/training/training_data.hpp>

#include <torch/torch.h>

namespace loopwise::training {

/// Weights by name.
using TensorMap = std::map<std::string, torch::Tensor>;

inline constexpr std::int64_t kEdge = ClosureEffects::kEdgeFeatures;
inline constexpr std::int64_t kUnit = ClosureEffects::kUnitFeatures;
inline constexpr std::int64_t kFixed = 2;  ///< Channels that are not learned.
inline constexpr std::int64_t kNodeFeatures = 7;
inline constexpr std::int64_t kEdgeTypes = 4;
inline constexpr std::int64_t kConvolutions = 3;
inline constexpr std::int64_t kDense = 3;

// ---- the Loopwise network

/// A graph as tensors: L candidates, U units, S sets.
struct EffectBatch {
  torch::Tensor edges;          // L × U × 9, not normalised
  torch::Tensor units;          // U × 5
  torch::Tensor share;          // U
  torch::Tensor active;         // L: 0 for connecting candidates
  torch::Tensor members;        // S × L
  torch::Tensor log_e;          // S: log(e / e(PG))
  torch::Tensor log_reduction;  // S × U
  torch::Tensor beside;         // U × U: means over the anchors next on the chain
  torch::Tensor swaps;          // S: 1 if the set differs from the one before by a swap
  double trace_m2 = 0.0;
};

[[nodiscard]] EffectBatch effect_batch(const TrainingGraph& graph, torch::ScalarType type);

/// y by set and unit, and log(ê / e(PG)) by set.
[[nodiscard]] std::pair<torch::Tensor, torch::Tensor> effect_forward(const TensorMap& w,
                                                                     const EffectBatch& batch);

/// Sum of three losses: the squared error of log e; that of each unit's logarithm, weighted by its remaining
/// variance; and a pseudo-Huber loss of the changes by single swaps, relative to the graph's mean change.
[[nodiscard]] torch::Tensor effect_loss(const TensorMap& w, const EffectBatch& batch);

// ---- the paper's network

/// Several graphs, each with one set.
struct PaperBatch {
  torch::Tensor nodes;                           // N × 7, not normalised
  std::array<torch::Tensor, kEdgeTypes> source;  // by edge type
  std::array<torch::Tensor, kEdgeTypes> target;
  torch::Tensor incoming;           // N × 1, at least 1
  torch::Tensor graph;              // N: sample of each node
  std::vector<std::int64_t> group;  // by sample: samples of one group share their graph
  torch::Tensor trace;              // by sample, m²
};

/// A graph with one of its sets.
struct PaperSample {
  const TrainingGraph* graph;
  const TrainingSet* set;
  std::int64_t group;
};

[[nodiscard]] PaperBatch paper_batch(const std::vector<PaperSample>& samples, torch::ScalarType type);

/// Output of the last layer by sample, before its conversion to m².
[[nodiscard]] torch::Tensor paper_forward(const TensorMap& w, const PaperBatch& batch, bool training);

/// Squared error of the normalised target, and of its differences within each graph, in units of the graph's
/// own differences. The choice of closures depends on these differences.
[[nodiscard]] torch::Tensor paper_loss(const TensorMap& w, const PaperBatch& batch, bool training,
                                       bool logarithm);

}  // namespace loopwise::training
