// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// One replay: drives the engine on a virtual clock.
[[nodiscard]] ReplayResult run_on_virtual_clock(const Mission& mission, const ReplayOptions& options,
                                                const Registration& registration,
                                                const PrioritizerFactory& prioritizers, ThreadPool& threads,
                                                const ReplayHooks& hooks, const KnownOutcomes& known);

}  // namespace loopwise
