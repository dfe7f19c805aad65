// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// ROS 2 messages as ROS 1 messages. Both hold the same fields in the same order; ROS 2 writes them as CDR,
/// where numbers are aligned, of either byte order, and strings end with a zero. One reader of messages
/// serves both. Private to io.
#pragma once

#include <string>
#include <string_view>

#include "ros_message.hpp"

namespace loopwise::cdr {

/// The name of a type as ROS 1 writes it: "nav_msgs/Odometry" for "nav_msgs/msg/Odometry".
[[nodiscard]] std::string ros1_type(std::string_view type);

/// A message definition of ROS 2 as Schema reads it: without bounds, default values and constants, times as
/// primitives. What it cannot read stays as it is, so that Schema complains of it.
[[nodiscard]] std::string ros1_definition(std::string_view definition);

/// The definition, in the form of ROS 1, of a type that recordings use whose files lack definitions; empty if
/// the type is not known.
[[nodiscard]] std::string known_definition(const std::string& ros1_type);

/// A message that is plain CDR (XCDR1), of either byte order, as the bytes of ROS 1. These are never more.
/// \throws InputError if it is of another encoding, is cut short, or does not end where its definition does
[[nodiscard]] std::string to_ros1(const ros1::Schema& schema, std::string_view bytes);

}  // namespace loopwise::cdr
