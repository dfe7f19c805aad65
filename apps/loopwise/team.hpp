// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Output of the commands about joined sources without a common frame.
#pragma once

#include <string>

#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/read_team.hpp>

namespace loopwise::cli {

/// A line for each component: its frame and the source of that frame, or the reason why it is separate.
[[nodiscard]] std::string frames_text(const TeamFrames& frames);
/// The same with all figures.
[[nodiscard]] Json frames_json(const TeamFrames& frames);

}  // namespace loopwise::cli
