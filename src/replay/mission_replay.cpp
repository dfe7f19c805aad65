// SPDX-License-Identifier: BSD-3-Clause
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/replay/replay.hpp>

#include "virtual_run.hpp"

namespace loopwise {

MissionReplay::MissionReplay(const Mission& mission, const ReplayOptions& options, Registration registration,
                             PrioritizerFactory prioritizers)
    : mission_(mission),
      options_(options),
      registration_(std::move(registration)),
      prioritizers_(std::move(prioritizers)) {
  validate_replay(options_);
  if (!registration_.features) throw InputError("MissionReplay needs a feature cache");
  if (!registration_.registrar) throw InputError("MissionReplay needs a registrar");
}

ReplayResult MissionReplay::run(ThreadPool& threads, const ReplayHooks& hooks,
                                const KnownOutcomes& known) const {
  return run_on_virtual_clock(mission_, options_, registration_, prioritizers_, threads, hooks, known);
}

ReplayResult replay(const Mission& mission, const ReplayOptions& options, const ReplayHooks& hooks,
                    int threads) {
  ThreadPool pool(threads);
  return MissionReplay(mission, options, make_registration(options.registration, mission.scans->loader()))
      .run(pool, hooks);
}

}  // namespace loopwise
