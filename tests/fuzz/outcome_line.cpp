// SPDX-License-Identifier: BSD-3-Clause
// Lines of outcomes, as a run that is resumed reads them.
#include <loopwise/pipeline/replay.hpp>

#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(outcome_line, bytes) {
  using namespace loopwise;
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
