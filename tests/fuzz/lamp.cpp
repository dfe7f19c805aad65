// SPDX-License-Identifier: BSD-3-Clause
// The first byte selects the robots: those of the messages, or also those that the messages call landmarks.
// Then messages follow: a byte for the type, two for the length, and the message.
#include "lamp_messages.hpp"

#include "checks.hpp"
#include "lamp_data.hpp"

LOOPWISE_FUZZ_TARGET(lamp, bytes) {
  using namespace loopwise;
  static const std::vector<ros1::Schema> schemas = [] {
    std::vector<ros1::Schema> out;
    for (const fuzz::MessageType& type : fuzz::message_types()) out.emplace_back(type.name, type.definition);
    return out;
  }();
  MissionOptions options;
  if (fuzz::take_choice(bytes, 2) == 1) options.robots = "a,A,u";
  Problems problems;
  lamp::Gatherer gatherer(options, problems);
  while (bytes.size() >= 3) {
    const std::size_t type = fuzz::take_choice(bytes, schemas.size());
    const std::size_t high = fuzz::take_choice(bytes, 256), low = fuzz::take_choice(bytes, 256);
    const std::string_view message = bytes.substr(0, high * 256 + low);
    bytes.remove_prefix(message.size());
    static_cast<void>(fuzz::attempt([&] {
      const ros1::Value value(schemas[type], message);
      switch (lamp::message_kind(fuzz::message_types()[type].name)) {
        case lamp::MessageKind::kPoseGraph:
          gatherer.add_graph("bag", fuzz::message_types()[type].topic, 1, value);
          break;
        case lamp::MessageKind::kBeacons:
          gatherer.add_beacons(value, 1);
          break;
        case lamp::MessageKind::kRadio:
          gatherer.add_radio(value, 1);
          break;
        case lamp::MessageKind::kOdometry:
          gatherer.add_truth({"/husky1/truth", "truth.bag"}, value, 1);
          break;
        default:
          break;
      }
      return true;
    }));
  }
  Mission mission;
  const auto whole = fuzz::attempt([&] {
    gatherer.finish(mission, "bag");
    return true;
  });
  if (whole) fuzz::check_mission(mission);
  fuzz::check_problems(problems);
}
