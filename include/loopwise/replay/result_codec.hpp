// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Results of registrations as bytes, for the outcome store and for messages between the ranks of a job.
/// outcome_line() writes them as lines of JSON.
#pragma once

#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>
#include <loopwise/core/registration_result.hpp>

namespace loopwise {

/// A result as bytes, exact to the bit, without the candidate, which the receiver knows. Numbers have the
/// byte order of this machine.
[[nodiscard]] LOOPWISE_EXPORT std::string pack_result(const RegistrationResult& result);

/// The result of pack_result() for this candidate. \throws InputError on invalid bytes
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult unpack_result(std::string_view bytes,
                                                               const LoopCandidate& candidate);

}  // namespace loopwise
