// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The missions of `loopwise-train data`.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <loopwise/training/data_set.hpp>

namespace loopwise::training {

/// Recorded missions, or the missions to simulate if no recorded ones are given.
struct SourceArguments {
  std::vector<std::string> missions;
  std::vector<std::string> other_size;
  std::string worlds = "tunnel,urban,finals,mine";
  std::vector<double> lengths{300.0, 500.0, 800.0};
  std::vector<double> other_lengths{1600.0};
  std::int64_t seeds = 12;
  std::int64_t other_seeds = 2;
  std::uint64_t first_seed = 1;
};

/// The recorded missions, otherwise the simulated ones. \throws OptionError
[[nodiscard]] std::vector<DataSource> sources_of(const SourceArguments& arguments);

}  // namespace loopwise::training
