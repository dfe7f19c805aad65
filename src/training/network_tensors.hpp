// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The two networks as libtorch computes them: graphs as tensors, what a network puts out, and its loss.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

// Before libtorch, which brings macros of its own.
#include <loopwise/training/training_data.hpp>

#include <torch/torch.h>

namespace loopwise::training {

/// Weights by their names.
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
  torch::Tensor edges;          // L × U × 9, as they are
  torch::Tensor units;          // U × 5
  torch::Tensor share;          // U
  torch::Tensor active;         // L: 0 for connecting candidates
  torch::Tensor members;        // S × L
  torch::Tensor log_e;          // S: log(e / e(PG))
  torch::Tensor log_reduction;  // S × U
  torch::Tensor beside;         // U × U: means over the anchors next on the chain
  torch::Tensor swaps;          // S: 1 where the set differs from the one before by a swap
  double trace_m2 = 0.0;
};

[[nodiscard]] EffectBatch effect_batch(const TrainingGraph& graph, torch::ScalarType type);

/// y by set and unit, and log(ê / e(PG)) by set.
[[nodiscard]] std::pair<torch::Tensor, torch::Tensor> effect_forward(const TensorMap& w,
                                                                     const EffectBatch& batch);

/// Squared error of log e; of each unit's logarithm, units weighed by what is left of them; and of the
/// changes by single swaps, in units of the graph's own.
[[nodiscard]] torch::Tensor effect_loss(const TensorMap& w, const EffectBatch& batch);

// ---- the paper's network

/// Graphs side by side, each with a set.
struct PaperBatch {
  torch::Tensor nodes;                           // N × 7, as they are
  std::array<torch::Tensor, kEdgeTypes> source;  // by edge type
  std::array<torch::Tensor, kEdgeTypes> target;
  torch::Tensor incoming;           // N × 1, at least 1
  torch::Tensor graph;              // N: which sample a node belongs to
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

/// What the last layer puts out, by sample, before it is taken back to m².
[[nodiscard]] torch::Tensor paper_forward(const TensorMap& w, const PaperBatch& batch, bool training);

/// Squared error of the normalised target, and of its differences within each graph, in units of the graph's
/// own: they are what a choice of closures goes by.
[[nodiscard]] torch::Tensor paper_loss(const TensorMap& w, const PaperBatch& batch, bool training,
                                       bool logarithm);

}  // namespace loopwise::training
