// SPDX-License-Identifier: BSD-3-Clause
// Messages in an otherwise valid bag, so that each gets through our check to the library. The first byte is
// the number of messages per chunk, 1 to 8. Then up to 8 records follow: a byte for the type, one for the
// second, two for the length, and the message. Type 5 is defined by the fuzzer in a record of type 6: topic,
// name and definition, separated by zero bytes.
#include <rosbag/bag.h>

#include <algorithm>
#include <string>
#include <tuple>
#include <vector>

#include "bag.hpp"
#include "checks.hpp"
#include "lamp_data.hpp"

namespace {

/// Second, topic, type, definition and bytes of a message.
using Recorded = std::tuple<std::int64_t, std::string, std::string, std::string, std::string>;

bool earlier(const Recorded& a, const Recorded& b) {
  return std::get<0>(a) < std::get<0>(b);
}

/// The text before the next zero byte; removes both.
std::string take_word(std::string_view& bytes) {
  const std::string word(bytes.substr(0, bytes.find('\0')));
  bytes.remove_prefix(std::min(bytes.size(), word.size() + 1));
  return word;
}

}  // namespace

LOOPWISE_FUZZ_TARGET(bag_made, bytes) {
  using namespace loopwise;
  static const rosbag::Bag open_all_the_time;  // see the target of whole bags
  const std::string_view input = bytes;
  fuzz::BagLayout layout;
  // Not the fuzzer's choice: it would choose the slowest ones, and chunks have a separate target.
  const std::size_t compression = std::hash<std::string_view>()(bytes) / 64 % 16;
  layout.compression = compression == 1 ? "bz2" : compression == 2 ? "lz4" : "none";
  layout.messages_per_chunk = 1 + fuzz::take_choice(bytes, 8);
  std::vector<fuzz::BagConnection> types = fuzz::bag_connections();
  types.push_back({"std_msgs/Empty", "/own", ""});
  std::vector<fuzz::TypedMessage> messages;
  constexpr std::size_t kMost = 8;  // more of them take longer and show nothing else
  while (bytes.size() >= 4 && messages.size() < kMost) {
    fuzz::TypedMessage message;
    message.type = fuzz::take_choice(bytes, types.size() + 1);
    message.second = static_cast<std::uint32_t>(fuzz::take_choice(bytes, 256));
    const std::size_t high = fuzz::take_choice(bytes, 256), low = fuzz::take_choice(bytes, 256);
    message.bytes = bytes.substr(0, high * 256 + low);
    bytes.remove_prefix(message.bytes.size());
    if (message.type < types.size()) {
      messages.push_back(std::move(message));
      continue;
    }
    std::string_view description = message.bytes;
    fuzz::BagConnection& own = types.back();
    own.topic = take_word(description);
    if (own.topic.empty()) own.topic = "/own";  // the check requires one
    own.name = take_word(description);
    own.definition = description;
  }
  const auto file = fuzz::scratch() / "made.bag";
  fuzz::put_file(file, fuzz::bag(messages, layout, types));
  Problems problems;
  bags::BagSet bag({{file, "made.bag"}}, [](const std::string&) { return true; }, problems, {}, {});
  fuzz::expect(problems.empty(), "a bag that is as it should be passes without a problem");
  std::vector<Recorded> recorded, read;
  for (const fuzz::TypedMessage& message : messages) {
    const fuzz::BagConnection& type = types[message.type];
    recorded.emplace_back(fuzz::kBagStart + message.second, type.topic, type.name, type.definition,
                          message.bytes);
  }
  const auto visit = [&](const bags::Message& message) {
    const bags::Connection& type = bag.connections().at(message.connection);
    read.emplace_back(message.stamp_ns / 1'000'000'000, type.topic, type.type, type.definition,
                      message.bytes);
    return false;
  };
  bag.for_each([](std::size_t) { return true; }, visit, {}, {});
  fuzz::expect(std::is_sorted(read.begin(), read.end(), earlier), "messages come in the order of time");
  std::sort(recorded.begin(), recorded.end());
  std::sort(read.begin(), read.end());
  fuzz::expect(read == recorded, "messages are read as they were recorded");
  if (!fuzz::one_in(16, input)) return;  // the contents of messages have separate targets
  const auto mission = fuzz::attempt([&] { return read_mission(file); });
  if (mission) fuzz::check_mission(*mission);
}
