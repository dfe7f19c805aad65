// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Lines of the replay's journal: one JSON object per event, with the candidates' account after it. They do
/// not depend on the wall clock, except those of the online module.
#pragma once

#include <string>
#include <vector>

#include <loopwise/engine/candidate_pool.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/registration/registrar.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise::journal {

[[nodiscard]] std::string start_line(const Mission& mission, const ReplayOptions& options);
[[nodiscard]] std::string key_frame_line(double time_s, Key key, std::size_t candidates,
                                         const CandidateAccounting& a);
[[nodiscard]] std::string batch_line(double time_s, const std::vector<RegistrationTask>& batch,
                                     const CandidateAccounting& a);
[[nodiscard]] std::string result_line(double time_s, const RegistrationResult& result,
                                      const CandidateAccounting& a);
/// A result of the online module, with the numbers of waiting events and candidates.
[[nodiscard]] std::string live_result_line(double time_s, const RegistrationResult& result,
                                           const ModuleStatistics& statistics);
[[nodiscard]] std::string estimate_line(double time_s, const GncResult& gnc, const CandidateAccounting& a);
[[nodiscard]] std::string end_line(double time_s, bool interrupted, const CandidateAccounting& a);

}  // namespace loopwise::journal
