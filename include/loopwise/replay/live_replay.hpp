// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/registration/registrar.hpp>
#include <loopwise/replay/options.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// The options of a module that works as a replay with these options does, with the registrar `fast`.
/// `options.cost` has no meaning for it.
/// \param options of the replay
/// \param threads that compute registrations; 0: one per processor
[[nodiscard]] LOOPWISE_EXPORT ModuleOptions module_options(const ReplayOptions& options, int threads = 0);

/// Replays a recorded mission on a real clock: the online LoopClosureModule is fed key frames, beacons and
/// radio readings when the clock comes to their times (as arrival_times() has them), and works beside that on
/// `threads` threads. Registrations take as long as they take on this machine: `options.cost` does not count,
/// and unlike MissionReplay's the outcome depends on the machine. See ReplayHooks::event for how a run is
/// recorded and repeated.
///
/// Ends with the last key frame; with ReplayOptions::after_mission when nothing is pending; soon after a stop
/// request. Of the hooks, `moment` is shown the run after each estimate and at its end, `outcome` takes each
/// result, and the journal has the events start, result and end. Reasons of candidates that were pruned or
/// expired are not kept.
///
/// `clock` must allow now() from several threads, as RealClock does.
/// \throws OptionError on options that only a virtual clock knows (`replay.max_registrations`,
/// `cost.measured_time`); InputError on a null pointer.
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay_live(const Mission& mission, const ReplayOptions& options,
                                                       std::shared_ptr<const Registrar> registrar,
                                                       Clock& clock, int threads = 0,
                                                       const ReplayHooks& hooks = {});

}  // namespace loopwise
