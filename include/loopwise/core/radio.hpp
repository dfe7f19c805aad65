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
  Key key = 0;         ///< The node that the power was measured at.
  std::string beacon;  ///< Name of the beacon.
  /// What the beacon sends with; NaN if not known.
  double transmit_dbm = std::numeric_limits<double>::quiet_NaN();
  std::string receiver;  ///< Antenna or channel: a node has one reading for each.
  double receive_dbm = std::numeric_limits<double>::quiet_NaN();  ///< NaN: nothing received.
};

/// A radio beacon left behind by a robot at a node.
struct BeaconDrop {
  std::string beacon;         ///< Name of the beacon.
  std::size_t robot = 0;      ///< Number of the robot that dropped it.
  Key drop_key = 0;           ///< The node at which it lies.
  std::int64_t stamp_ns = 0;  ///< When it was dropped, ns.
};

}  // namespace loopwise
