// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>

#include <loopwise/core/key.hpp>

namespace loopwise {

/// Power of one radio link from a node to a beacon, dBm.
struct RadioReading {
  Key key = 0;         ///< The node of the measurement.
  std::string beacon;  ///< Name of the beacon.
  /// Transmit power of the beacon; NaN if unknown.
  double transmit_dbm = std::numeric_limits<double>::quiet_NaN();
  std::string receiver;  ///< Antenna or channel: a node has one reading for each.
  double receive_dbm = std::numeric_limits<double>::quiet_NaN();  ///< NaN: nothing received.
};

/// A radio beacon that a robot dropped at a node.
struct BeaconDrop {
  std::string beacon;         ///< Name of the beacon.
  std::size_t robot = 0;      ///< Number of the robot that dropped it.
  Key drop_key = 0;           ///< The node of the drop.
  std::int64_t stamp_ns = 0;  ///< Time of the drop, ns.
};

}  // namespace loopwise
