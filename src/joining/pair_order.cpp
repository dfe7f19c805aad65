// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include <loopwise/core/random.hpp>

#include "tie_search.hpp"

namespace loopwise::joining {
namespace {

/// Proposed pairs of the two components, most similar first.
std::vector<std::pair<NodePair, double>> proposed(const ComponentPaths& paths, std::size_t a, std::size_t b,
                                                  const std::vector<ProposedPair>& proposals) {
  std::map<NodePair, double> best;
  for (const ProposedPair& proposal : proposals) {
    if (!paths.contains(proposal.from) || !paths.contains(proposal.to)) continue;
    std::size_t x = paths.of(proposal.from), y = paths.of(proposal.to);
    if (paths[x].component == a) std::swap(x, y);
    if (paths[x].component != b || paths[y].component != a) continue;
    const auto [entry, is_new] = best.emplace(NodePair{x, y}, proposal.similarity);
    if (!is_new) entry->second = std::max(entry->second, proposal.similarity);
  }
  std::vector<std::pair<NodePair, double>> out(best.begin(), best.end());
  std::stable_sort(out.begin(), out.end(), [](const auto& x, const auto& y) { return x.second > y.second; });
  return out;
}

/// Nodes of a component at least `step_m` apart along their paths.
std::vector<std::size_t> thinned(const ComponentPaths& paths, std::size_t component, double step_m) {
  std::vector<std::size_t> out;
  for (std::size_t s = paths.begin(component); s < paths.end(component); ++s) {
    const bool far = out.empty() || paths[out.back()].path != paths[s].path ||
                     paths[s].path_length_m - paths[out.back()].path_length_m >= step_m;
    if (far) out.push_back(s);
  }
  return out;
}

}  // namespace

std::vector<NodePair> ordered_pairs(const ComponentPaths& paths, std::size_t a, std::size_t b,
                                    const std::vector<ProposedPair>& proposals, const JoinOptions& options) {
  const auto cell = [&](std::size_t station) {
    return std::pair(paths[station].path,
                     static_cast<std::int64_t>(paths[station].path_length_m / options.place_m));
  };
  // Neighbouring key frames look alike, so the second-best pair of two places follows the best pairs of all.
  std::map<std::pair<std::pair<std::size_t, std::int64_t>, std::pair<std::size_t, std::int64_t>>, int> taken;
  std::vector<std::pair<int, NodePair>> ranked;
  for (const auto& [pair, similarity] : proposed(paths, a, b, proposals)) {
    ranked.emplace_back(taken[{cell(pair.first), cell(pair.second)}]++, pair);
  }
  std::stable_sort(ranked.begin(), ranked.end(),
                   [](const auto& x, const auto& y) { return x.first < y.first; });
  const auto most = static_cast<std::size_t>(options.max_pairs);
  std::vector<NodePair> order;
  order.reserve(ranked.size());
  for (const auto& [rank, pair] : ranked) order.push_back(pair);
  if (order.size() < most) {
    double step_m = 0.4 * options.place_m;
    std::vector<std::size_t> of_a = thinned(paths, a, step_m), of_b = thinned(paths, b, step_m);
    while (of_a.size() * of_b.size() > most && step_m < 1000.0) {
      step_m *= 1.2;
      of_a = thinned(paths, a, step_m);
      of_b = thinned(paths, b, step_m);
    }
    std::vector<NodePair> spread;
    for (const std::size_t x : of_b) {
      for (const std::size_t y : of_a) spread.emplace_back(x, y);
    }
    Rng rng(pair_seed(0, paths[paths.begin(a)].key, paths[paths.begin(b)].key));
    rng.shuffle(spread);
    const std::set<NodePair> known(order.begin(), order.end());
    for (const NodePair& pair : spread) {
      if (known.count(pair) == 0) order.push_back(pair);
    }
  }
  order.resize(std::min(order.size(), most));
  return order;
}

}  // namespace loopwise::joining
