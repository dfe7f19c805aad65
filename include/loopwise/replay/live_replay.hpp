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

/// Options of a module that works like a replay with these options, with the registrar `fast`. `options.cost`
/// is not used.
/// \param options of the replay
/// \param threads number of threads that compute registrations; 0: one per processor
[[nodiscard]] LOOPWISE_EXPORT ModuleOptions module_options(const ReplayOptions& options, int threads = 0);

/// Replays a recorded mission on a real clock: the online LoopClosureModule gets key frames, beacons and
/// radio readings at the times of arrival_times(), and works on `threads` threads. Registrations take their
/// time on this machine, so `options.cost` is not used, and unlike MissionReplay the outcome depends on the
/// machine. ReplayHooks::event records a run for repetition.
///
/// Ends with the last key frame; with ReplayOptions::after_mission when no candidate is pending; soon after a
/// stop request. Of the hooks, `moment` gets the run after each estimate and at its end, `outcome` gets each
/// result, and the journal has the events start, result and end. Reasons of pruned and expired candidates are
/// not stored.
///
/// `clock` must allow now() from several threads, as RealClock does.
/// \throws OptionError on options of the virtual clock (`replay.max_registrations`, `cost.measured_time`);
/// InputError on a null pointer.
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay_live(const Mission& mission, const ReplayOptions& options,
                                                       std::shared_ptr<const Registrar> registrar,
                                                       Clock& clock, int threads = 0,
                                                       const ReplayHooks& hooks = {});

}  // namespace loopwise
