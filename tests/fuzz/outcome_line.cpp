// SPDX-License-Identifier: BSD-3-Clause
// Lines of outcomes, as a run that is resumed reads them, and the first one of their file, which says whose
// they are.
#include <loopwise/replay/outcome_file.hpp>
#include <loopwise/replay/replay.hpp>

#include "checks.hpp"

namespace {

using namespace loopwise;

void check_file(const std::string& contents) {
  const std::string own = R"({"code":"1","mission":"m","options":{"a":{"b":1,"c":[2,"x"]}}})";
  static_cast<void>(fuzz::attempt([&] { return parse_outcomes(contents, own, "outcomes"); }));
  const auto kept = fuzz::attempt([&] { return parse_outcomes(own + "\n" + contents, own, "outcomes"); });
  if (kept) {
    const auto again = parse_outcomes(own + "\n" + kept->lines, own, "again");
    fuzz::expect(again.lines == kept->lines && again.lost == 0 && again.known.size() == kept->known.size(),
                 "what is kept is kept again");
  }
}

}  // namespace

LOOPWISE_FUZZ_TARGET(outcome_line, bytes) {
  if (fuzz::one_in(4, bytes)) check_file(std::string(bytes));
  for (std::size_t begin = 0; begin < bytes.size();) {
    const std::size_t end = std::min(bytes.find('\n', begin), bytes.size());
    const std::string line(bytes.substr(begin, end - begin));
    begin = end + 1;
    const auto result = fuzz::attempt([&] { return parse_outcome_line(line); });
    if (!result) continue;
    fuzz::expect((result->reason == RejectionReason::kNone) == result->closure.has_value(),
                 "an outcome has a closure exactly if it is not rejected");
    if (result->T_from_to) fuzz::check_pose(*result->T_from_to);
    if (result->closure) fuzz::check_pose(result->closure->T_from_to);
    const std::string again = outcome_line(*result);
    fuzz::expect(outcome_line(parse_outcome_line(again)) == again, "written and read again: the same");
  }
}
