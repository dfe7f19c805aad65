// SPDX-License-Identifier: BSD-3-Clause
// A message sensor_msgs/PointCloud2. The first byte chooses its definition: the usual one, or one whose sizes
// have 64 bits.
#include "point_cloud2.hpp"

#include "checks.hpp"
#include "lamp_data.hpp"

namespace {

using namespace loopwise;

std::string definition(bool wide) {
  std::string text = fuzz::message_types()[0].definition;
  for (std::size_t at = text.find("uint32"); wide && at != std::string::npos; at = text.find("uint32", at)) {
    text.replace(at, 6, "uint64");
  }
  return text;
}

}  // namespace

LOOPWISE_FUZZ_TARGET(point_cloud2, bytes) {
  static const ros1::Schema usual("pose_graph_msgs/KeyedScan", definition(false));
  static const ros1::Schema wide("pose_graph_msgs/KeyedScan", definition(true));
  const ros1::Schema& schema = fuzz::take_choice(bytes, 2) == 0 ? usual : wide;
  const auto message = fuzz::attempt([&] { return ros1::Value(schema, bytes); });
  if (!message) return;
  const ros1::Value scan = message->at("scan");
  const auto checked = fuzz::attempt([&] {
    ros1::check_point_cloud2("scan", scan);
    return true;
  });
  const auto file = fuzz::attempt([&] { return ros1::read_point_cloud2("scan", scan); });
  fuzz::expect(checked.has_value() == file.has_value(), "what was checked can be read, and the reverse");
  if (!file) return;
  fuzz::check_cloud(file->cloud);
  fuzz::check_problems(file->problems);
}
