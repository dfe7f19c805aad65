// SPDX-License-Identifier: BSD-3-Clause
#pragma once

namespace loopwise::detail {

/// Kinds of messages between a WorkServer and the ranks that it serves.
enum Tag : int {
  kGreeting = 1,  ///< First message of a rank.
  kFailure,       ///< Reason why a rank cannot continue, for people.
  kRequest,       ///< Number of a piece of work (8 bytes), then the request.
  kAnswer,        ///< The same number, then the answer.
  kEnd,           ///< There are no more requests.
};

}  // namespace loopwise::detail
