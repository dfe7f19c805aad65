// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/closure_decision.hpp>

#include <algorithm>
#include <map>
#include <utility>

namespace loopwise {

AppliedDecisions apply_decisions(PoseGraph& graph, const std::vector<ClosureDecision>& decisions) {
  struct Word {
    ClosureDecision decision;
    bool matched = false;
  };
  using Pair = std::pair<Key, Key>;
  std::map<Pair, Word> words;
  for (const ClosureDecision& decision : decisions) {
    words[std::minmax(decision.from, decision.to)] = {decision};
  }
  const auto word_on = [&words](const Edge& edge) -> Word* {
    if (edge.kind != EdgeKind::kLoopClosure) return nullptr;
    const auto found = words.find(std::minmax(edge.from, edge.to));
    return found == words.end() ? nullptr : &found->second;
  };

  AppliedDecisions applied;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    Word* word = word_on(graph.edges()[e]);
    if (word == nullptr) continue;
    word->matched = true;
    if (!word->decision.accepted) continue;
    graph.set_trusted(e, true);
    ++applied.trusted;
  }
  applied.removed = graph.remove_edges_if([&](const Edge& edge) {
    const Word* word = word_on(edge);
    return word != nullptr && !word->decision.accepted;
  });
  for (const auto& [pair, word] : words) {
    if (!word.matched) applied.without_match.push_back(word.decision);
  }
  return applied;
}

}  // namespace loopwise
