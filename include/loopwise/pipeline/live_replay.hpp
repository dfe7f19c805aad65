// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/pipeline/config.hpp>
#include <loopwise/pipeline/replay.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Replays a recorded mission on a real clock: the online LoopClosureModule is fed key frames, beacons and
/// radio readings when the clock comes to their times (as arrival_times() has them), and works beside that on
/// `num_threads` threads. Registrations take what they take: `registration_time_s`, `workers` and
/// `gi_evaluation_time_s` do not count, and unlike MissionReplay's the outcome depends on the machine.
///
/// Ends with the last key frame; with ReplayOptions::after_mission when nothing is pending; soon after a stop
/// request. Of the hooks, `moment` is shown the run after each estimate and at its end, `outcome` takes each
/// result, and the journal has the events start, result and end. Reasons of candidates that were pruned or
/// expired are not kept.
///
/// `clock` must allow now() from several threads, as RealClock does.
/// \throws OptionError on options that only a virtual clock knows (`max_registrations`, `thin`,
/// `measured_time`, a guess by odometry); InputError on a null pointer.
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay_live(const Mission& mission, const Config& config,
                                                       std::shared_ptr<const Registrar> registrar,
                                                       Clock& clock, int num_threads = 0,
                                                       const ReplayHooks& hooks = {});

}  // namespace loopwise
