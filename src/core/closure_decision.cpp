// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/closure_decision.hpp>

#include <algorithm>
#include <map>
#include <utility>

namespace loopwise {

AppliedDecisions apply_decisions(PoseGraph& graph, const std::vector<ClosureDecision>& decisions) {
  struct Entry {
    ClosureDecision decision;
    bool matched = false;
  };
  using Pair = std::pair<Key, Key>;
  std::map<Pair, Entry> entries;
  for (const ClosureDecision& decision : decisions) {
    entries[std::minmax(decision.from, decision.to)] = {decision};
  }
  const auto entry_of = [&entries](const Edge& edge) -> Entry* {
    if (edge.kind != EdgeKind::kLoopClosure) return nullptr;
    const auto found = entries.find(std::minmax(edge.from, edge.to));
    return found == entries.end() ? nullptr : &found->second;
  };

  AppliedDecisions applied;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    Entry* entry = entry_of(graph.edges()[e]);
    if (entry == nullptr) continue;
    entry->matched = true;
    if (!entry->decision.accepted) continue;
    graph.set_trusted(e, true);
    ++applied.trusted;
  }
  applied.removed = graph.remove_edges_if([&](const Edge& edge) {
    const Entry* entry = entry_of(edge);
    return entry != nullptr && !entry->decision.accepted;
  });
  for (const auto& [pair, entry] : entries) {
    if (!entry.matched) applied.without_match.push_back(entry.decision);
  }
  return applied;
}

}  // namespace loopwise
