// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Options on the command line for reading missions. Each command adds those that it needs.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "common/common_options.hpp"

namespace loopwise::cli {

/// Values of options that stand for fields of the section `mission` of a configuration; empty if not given.
struct MissionArguments {
  std::string robots, odometry, frames, bin_layout;
  bool start_together = false;
};

/// Writes the given values to the configuration. \throws OptionError
void apply(const MissionArguments& arguments, Config& config);

/// Adds --robots.
void add_robots_option(Command& command, std::string& robots);
/// Adds --odometry.
void add_odometry_option(Command& command, std::string& odometry);
/// Adds --bin-layout, for the fields of a point in .bin files.
void add_bin_layout_option(Command& command, std::string& layout);
/// Adds the options for joining several sources to one mission.
void add_joining_options(Command& command, MissionArguments& arguments);
/// Adds the options for making key frames from odometry and sweeps.
void add_key_frame_options(Command& command, CommonOptions& options);

/// Adds --decisions.
void add_decisions_option(Command& command, std::string& decisions);

/// Adds --truth, for set_truth().
void add_truth_option(Command& command, std::vector<std::string>& truth);
/// The files of --truth for one of several missions: all of them if it is the only mission, otherwise the
/// file with the same index. \throws OptionError unless several missions have no file or one each
[[nodiscard]] std::vector<std::string> truth_of_mission(const std::vector<std::string>& truth,
                                                        std::size_t mission, std::size_t missions);

}  // namespace loopwise::cli
