// SPDX-License-Identifier: BSD-3-Clause
// A message definition of ROS 2, an empty byte, then a message in CDR. The result is a message of ROS 1.
#include "cdr.hpp"

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(cdr, bytes) {
  using namespace loopwise;
  const std::size_t end = std::min(bytes.find('\0'), bytes.size());
  const std::string definition = cdr::ros1_definition(bytes.substr(0, end));
  const std::string_view message = bytes.substr(std::min(end + 1, bytes.size()));
  const auto schema = fuzz::attempt([&] { return ros1::Schema("fuzz_msgs/Fuzz", definition); });
  if (!schema) return;
  const auto ros1 = fuzz::attempt([&] { return cdr::to_ros1(*schema, message); });
  if (!ros1) return;
  fuzz::expect(ros1->size() <= message.size(), "a message of ROS 1 is no longer than that of ROS 2");
  bool whole = true;
  try {
    static_cast<void>(ros1::Value(*schema, *ros1));
  } catch (const Error&) {
    whole = false;
  }
  fuzz::expect(whole, "what was made is a message of ROS 1");
}
