// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Training with libtorch. This header has no types of libtorch, whose headers compile slowly.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/options.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/json_options.hpp>

#include <loopwise/training/training_data.hpp>
#include <loopwise/training/weights.hpp>

namespace loopwise::training {

/// Training target of the paper's network. The Loopwise network always learns the logarithm.
enum class Target { kLog, kTrace };
[[nodiscard]] inline EnumNames<Target> enum_names(Target) {
  return {{Target::kLog, "log"}, {Target::kTrace, "trace"}};
}

struct FitOptions {
  /// Kind of network: loopwise or paper.
  NetworkKind network = NetworkKind::kLoopwise;
  /// Network paper: target to learn, the trace or its logarithm.
  Target target = Target::kLog;
  /// Maximum number of epochs.
  std::int64_t epochs = 40;
  /// Training ends after this many epochs without a better validation loss.
  std::int64_t patience = 10;
  /// Initial learning rate of Adam. It falls to a twentieth along a cosine.
  double learning_rate = 3e-3;
  /// Width of the hidden layers. 0: 24 for loopwise, 64 for paper.
  std::int64_t hidden = 0;
  /// Network loopwise: number of learned channels of aggregation.
  std::int64_t channels = 8;
  /// Network paper: number of Gaussian kernels of a convolution.
  std::int64_t kernels = 4;
  /// Seed of the initial weights and of the order of the data.
  std::uint64_t seed = 1;
  /// Seed of the split by mission.
  std::uint64_t split_seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("network", self.network, any_value());
    field("target", self.target, any_value());
    field("epochs", self.epochs, between(1, 100000));
    field("patience", self.patience, between(1, 100000));
    field("learning_rate", self.learning_rate, above(0.0));
    field("hidden", self.hidden, between(0, 1024));
    field("channels", self.channels, between(1, 256));
    field("kernels", self.kernels, between(1, 64));
    field("seed", self.seed, at_least(0));
    field("split_seed", self.split_seed, at_least(0));
  }
};

struct EpochResult {
  std::int64_t epoch = 0;  ///< From 1.
  double training_loss = 0.0;
  double validation_loss = 0.0;
  bool best = false;
};

/// A network in training. It uses one thread, so that equal data, options and seed give results equal to the
/// bit.
class Trainer {
 public:
  /// Normalises by the statistics of the training missions only. \throws InputError if one of the lists is
  /// empty; OptionError
  Trainer(const std::vector<MissionData>& training, const std::vector<MissionData>& validation,
          const FitOptions& options);
  ~Trainer();

  [[nodiscard]] bool done() const;
  [[nodiscard]] const std::vector<EpochResult>& history() const;
  /// \returns nothing if stopped: this object is then invalid, the last saved state is not.
  /// \throws Error if the loss is no longer finite
  [[nodiscard]] std::optional<EpochResult> run_epoch(const StopToken& stop = {},
                                                     const ProgressCallback& progress = {});

  /// The weights of the epoch with the best validation; the initial ones before the first epoch.
  [[nodiscard]] Tensors weights() const;

  /// Saves the complete state of the training to one file, atomically.
  void save(const std::filesystem::path& checkpoint) const;
  /// \throws IoError; InputError for a file that is cut short, or with other data or options (except
  /// patience)
  void load(const std::filesystem::path& checkpoint);

  /// Compares libtorch's gradient with central differences at random weights in double precision. \returns
  /// the largest difference relative to the largest gradient.
  [[nodiscard]] double gradient_error(std::size_t samples, std::uint64_t seed);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// e(PG ∪ set) as libtorch computes it from these weights, in double precision.
[[nodiscard]] double torch_evaluate(NetworkKind kind, const Tensors& tensors, const TrainingGraph& graph,
                                    const std::vector<std::uint32_t>& set);

}  // namespace loopwise::training
