// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/decisions.hpp>

#include <algorithm>
#include <cstddef>
#include <map>
#include <utility>

#include <loopwise/io/csv.hpp>

namespace loopwise {

std::vector<ClosureDecision> read_decisions(const std::filesystem::path& path) {
  constexpr std::size_t kFrom = 0, kTo = 1, kDecision = 2;
  const CsvTable table(path, {"from", "to", "decision"});
  std::vector<ClosureDecision> decisions;
  std::map<std::pair<Key, Key>, std::size_t> rows;
  for (std::size_t row = 0; row < table.size(); ++row) {
    ClosureDecision decision;
    decision.from = table.key(row, kFrom);
    decision.to = table.key(row, kTo);
    const std::string& word = table.text(row, kDecision);
    if (word != "accept" && word != "reject") {
      table.fail(row, kDecision, "\"" + word + "\" is neither accept nor reject");
    }
    decision.accepted = word == "accept";
    const auto [earlier, is_new] = rows.emplace(std::minmax(decision.from, decision.to), row);
    if (is_new) {
      decisions.push_back(decision);
    } else if (table.text(earlier->second, kDecision) != word) {
      table.fail(row, kDecision,
                 "line " + std::to_string(table.line(earlier->second)) +
                     " has the opposite decision for the same pair; remove one of the two lines");
    }
  }
  return decisions;
}

std::string decisions_csv(const std::vector<ClosureDecision>& decisions) {
  CsvText csv({"from", "to", "decision"});
  for (const ClosureDecision& decision : decisions) {
    csv.row(decision.from, decision.to, std::string(decision.accepted ? "accept" : "reject"));
  }
  return csv.text();
}

}  // namespace loopwise
