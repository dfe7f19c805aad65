// SPDX-License-Identifier: BSD-3-Clause
// Lines of traces: the header, and events as replay_trace() hands them to an engine.
#include <loopwise/replay/trace.hpp>

#include "checks.hpp"

namespace {

using namespace loopwise;

std::string line_of(const TraceEvent& traced) {
  std::string written;
  TraceWriter writer(Robots(), ModuleOptions(), [&](const std::string& line) { written = line; });
  writer.add({traced.event, traced.now_s, traced.observability});
  return written;
}

}  // namespace

LOOPWISE_FUZZ_TARGET(trace, bytes) {
  for (std::size_t begin = 0; begin < bytes.size();) {
    const std::size_t end = std::min(bytes.find('\n', begin), bytes.size());
    const std::string line(bytes.substr(begin, end - begin));
    begin = end + 1;
    if (const auto header = fuzz::attempt([&] { return parse_trace_header(line); })) {
      std::string again;
      const TraceWriter writer(header->robots, header->options,
                               [&](const std::string& text) { again = text; });
      std::string twice;
      const TraceHeader read = parse_trace_header(again);
      const TraceWriter second(read.robots, read.options, [&](const std::string& text) { twice = text; });
      fuzz::expect(again == twice, "a header that is written and read again is the same");
    }
    const auto traced = fuzz::attempt([&] { return parse_trace_event(line); });
    if (!traced) continue;
    const std::string again = line_of(*traced);
    fuzz::expect(line_of(parse_trace_event(again)) == again,
                 "an event that is written and read again is the same");
    static_cast<void>(fuzz::attempt([&] {
      check_event(traced->event, parse_robots("a,b"));
      return true;
    }));
  }
}
