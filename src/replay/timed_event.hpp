// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <tuple>

namespace loopwise {

/// Order of events with the same time.
enum class EventKind { kKeyFrame, kResult };

/// A future event on the virtual clock.
struct TimedEvent {
  double time_s;
  EventKind kind;
  std::uint64_t number;  ///< Key of the key frame; place of the result within the run.
  std::size_t index;     ///< Arrival of the feed; result of the batch.

  bool operator<(const TimedEvent& other) const {
    return std::tie(time_s, kind, number) < std::tie(other.time_s, other.kind, other.number);
  }
};

}  // namespace loopwise
