// SPDX-License-Identifier: BSD-3-Clause
// The journal of a run, as the report reads it.
#include "run_journal.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(run_journal, bytes) {
  using namespace loopwise;
  std::istringstream in{std::string(bytes)};
  const auto journal = fuzz::attempt([&] { return parse_run_journal(in, "journal"); });
  if (!journal) return;
  const auto lines = static_cast<std::size_t>(std::count(bytes.begin(), bytes.end(), '\n')) + 1;
  fuzz::expect(journal->moments.size() <= lines, "a line has one moment");
  for (std::size_t i = 1; i < journal->moments.size(); ++i) {
    fuzz::expect(journal->moments[i].time_s != journal->moments[i - 1].time_s, "the last of each time");
  }
  for (const auto& moment : journal->moments) {
    fuzz::expect(std::isfinite(moment.time_s) && moment.queued <= moment.generated,
                 "what waits was generated");
  }
}
