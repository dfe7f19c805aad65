// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The input of `loopwise optimize`: the configuration and the graph, with decisions on its closures and
/// priors.
#pragma once

#include <string>
#include <vector>

#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>

#include "common/command_line.hpp"
#include "common/console.hpp"
#include "mission_options.hpp"

namespace loopwise::cli {

struct OptimizeInput {
  CommonOptions common;
  std::string input, decisions, initialization;
  MissionArguments reading;
  std::vector<std::string> priors;
  double inlier_probability = 0.0;  ///< 0: as configured.
  bool gnc = false;
};

/// Adds --odometry, --decisions, --robots and --prior.
void add_graph_options(Command& command, OptimizeInput& input);

/// The configuration with the given options. The default options of the optimiser are not those of a growing
/// graph, because a file has no earlier estimate. \throws OptionError
[[nodiscard]] Config configured(const OptimizeInput& input);

/// Reads the graph of a file, a run or a recording, and applies the decisions to its closures.
[[nodiscard]] PoseGraph graph_of(const OptimizeInput& input, const MissionOptions& options, Console& console,
                                 const StopToken& stop);

/// Adds the priors of the command line. If the graph then has no prior, adds one at the first node of each
/// component. \throws OptionError
void add_priors(PoseGraph& graph, const std::vector<std::string>& priors, Console& console);

}  // namespace loopwise::cli
