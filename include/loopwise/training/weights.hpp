// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Weights of networks as plain numbers, and the file that GraphNetwork and EffectNetwork read.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>

namespace loopwise::training {

/// The network of the weights.
enum class NetworkKind {
  kLoopwise,  ///< EffectNetwork
  kPaper,     ///< GraphNetwork with the sizes of the paper: 4 kernels, world-frame covariances.
};
[[nodiscard]] inline EnumNames<NetworkKind> enum_names(NetworkKind) {
  return {{NetworkKind::kLoopwise, "loopwise"}, {NetworkKind::kPaper, "paper"}};
}

/// An array of numbers.
struct PlainTensor {
  std::vector<std::int64_t> shape;  ///< Sizes of its dimensions.
  std::vector<float> data;          ///< Row-major.
};
/// Arrays by their names.
using Tensors = std::map<std::string, PlainTensor>;

/// Writes the JSON that GraphNetwork or EffectNetwork reads. Reading gives the same single-precision values.
/// `meta` becomes `__meta__`, with `kind` as its first entry.
LOOPWISE_EXPORT void write_weights(const std::filesystem::path& path, NetworkKind kind,
                                   const Tensors& tensors, const std::string& meta_json);

/// Names of the missions that a network was trained on and validated with, according to `__meta__` of its
/// file; empty if the file does not name any. \throws IoError, ParseError
[[nodiscard]] LOOPWISE_EXPORT std::set<std::string> missions_of_weights(const std::filesystem::path& path);

}  // namespace loopwise::training
