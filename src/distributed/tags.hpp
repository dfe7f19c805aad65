// SPDX-License-Identifier: BSD-3-Clause
#pragma once

namespace loopwise::detail {

/// Kinds of messages between a WorkServer and the ranks that it serves.
enum Tag : int {
  kGreeting = 1,  ///< The first word of a rank.
  kFailure,       ///< Why a rank cannot go on, for people.
  kRequest,       ///< Number of a piece (8 bytes), then what it asks for.
  kAnswer,        ///< The same number, then the answer.
  kEnd,           ///< No more will be asked.
};

}  // namespace loopwise::detail
