// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// ROS 2 messages as ROS 1 messages. Both have the same fields in the same order. ROS 2 writes them as CDR,
/// with aligned numbers of either byte order and a zero at the end of strings. So one reader of messages
/// serves both. Private to io.
#pragma once

#include <string>
#include <string_view>

#include "ros_message.hpp"

namespace loopwise::cdr {

/// The name of a type as ROS 1 writes it: "nav_msgs/Odometry" for "nav_msgs/msg/Odometry".
[[nodiscard]] std::string ros1_type(std::string_view type);

/// Converts a message definition of ROS 2 for Schema: without bounds, default values and constants, and with
/// times as primitives. Other text stays unchanged, so that Schema reports it.
[[nodiscard]] std::string ros1_definition(std::string_view definition);

/// Definition, in the form of ROS 1, of a type whose definition may be missing in a recording; empty if the
/// type is not known.
[[nodiscard]] std::string known_definition(const std::string& ros1_type);

/// Converts a message in plain CDR (XCDR1) of either byte order to the bytes of ROS 1. The output is never
/// longer. \throws InputError if the message has another encoding, is cut short, or does not end where its
/// definition does
[[nodiscard]] std::string to_ros1(const ros1::Schema& schema, std::string_view bytes);

}  // namespace loopwise::cdr
