// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Results of registrations as bytes: what the outcome store keeps and ranks of a job send each other. As
/// lines of JSON they are written by outcome_line().
#pragma once

#include <string>
#include <string_view>

#include <loopwise/core/export.hpp>
#include <loopwise/core/registration_result.hpp>

namespace loopwise {

/// A result to the bit, without the candidate, which whoever asked for it knows. Numbers stand as this
/// machine has them.
[[nodiscard]] LOOPWISE_EXPORT std::string pack_result(const RegistrationResult& result);

/// The result of pack_result() for this candidate. \throws InputError on bytes that are none
[[nodiscard]] LOOPWISE_EXPORT RegistrationResult unpack_result(std::string_view bytes,
                                                               const LoopCandidate& candidate);

}  // namespace loopwise
