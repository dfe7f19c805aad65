// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Parts of the output of `loopwise info`, some of which `loopwise simulate` prints too.
#pragma once

#include <string>

#include <loopwise/evaluation/mission_statistics.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise::cli {

/// Adds the number of candidates by proximity, and the number of those that saw the same place.
void add_candidates(const Mission& mission, const CandidateStatisticsOptions& options, Json& json,
                    std::string& text);
/// Adds the drift of odometry, if ground truth is known.
void add_drift(const Mission& mission, Json& json, std::string& text);
/// Adds the topics of the bags and the data taken from each.
void add_topics(const Mission& mission, Json& json, std::string& text);

}  // namespace loopwise::cli
