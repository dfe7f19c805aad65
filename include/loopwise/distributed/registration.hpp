// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>
#include <loopwise/distributed/work.hpp>
#include <loopwise/registration/registrar.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/replay/result_codec.hpp>

namespace loopwise {

/// A task as a message, exact to the bit, 0.1 to 0.6 KiB. \throws InputError on a submap of more than 255
/// scans
[[nodiscard]] LOOPWISE_EXPORT std::string pack_task(const RegistrationTask& task);
/// The task from pack_task(). \throws InputError on invalid bytes
[[nodiscard]] LOOPWISE_EXPORT RegistrationTask unpack_task(std::string_view bytes);

/// Data on which the ranks of a replay must agree: the version of the code, the options, the mission's graph
/// and its list of scans.
[[nodiscard]] LOOPWISE_EXPORT std::string replay_greeting(const Mission& mission,
                                                          const ReplayOptions& options);

/// Computes batches over all ranks, for MissionReplay instead of its own threads. Results equal those of one
/// machine. A pair goes to the rank that had its target last. `local_workers` threads compute on rank 0.
[[nodiscard]] LOOPWISE_EXPORT BatchComputer distributed_batches(std::shared_ptr<WorkServer> server,
                                                                std::shared_ptr<const Registrar> registrar,
                                                                int local_workers);

/// Runs every other rank of a replay: computes tasks until rank 0 ends it.
LOOPWISE_EXPORT void serve_registrations(Transport& transport, std::string_view greeting,
                                         const Registrar& registrar);

}  // namespace loopwise
