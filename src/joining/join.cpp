// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/joining/join.hpp>

#include <algorithm>
#include <map>
#include <numeric>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/error.hpp>

#include "component_paths.hpp"
#include "group_frames.hpp"
#include "tie_search.hpp"

namespace loopwise {
namespace {

using joining::ComponentPaths;
using joining::GroupFrames;

/// Components by group: members ascend, and groups follow by falling number of key frames.
std::vector<std::vector<std::size_t>> groups_of(const ComponentPaths& paths, const std::vector<Tie>& ties) {
  DisjointSets sets(paths.components());
  for (const Tie& tie : ties) {
    if (tie.joined) sets.join(tie.a, tie.b);
  }
  std::map<std::uint32_t, std::vector<std::size_t>> by_root;
  for (std::size_t c = 0; c < paths.components(); ++c) by_root[sets.root(c)].push_back(c);
  std::vector<std::vector<std::size_t>> groups;
  groups.reserve(by_root.size());
  for (auto& [root, members] : by_root) groups.push_back(std::move(members));
  const auto size = [&](const std::vector<std::size_t>& members) {
    std::size_t nodes = 0;
    for (const std::size_t c : members) nodes += paths.end(c) - paths.begin(c);
    return std::pair(members.size() > 1, nodes);  // single components come last
  };
  std::stable_sort(groups.begin(), groups.end(),
                   [&](const auto& x, const auto& y) { return size(x) > size(y); });
  return groups;
}

std::vector<std::size_t> joined_ties(const std::vector<Tie>& ties, const std::vector<std::size_t>& members) {
  std::vector<std::size_t> out;
  for (std::size_t t = 0; t < ties.size(); ++t) {
    if (ties[t].joined && std::find(members.begin(), members.end(), ties[t].a) != members.end())
      out.push_back(t);
  }
  return out;
}

/// Drops the ties of a group that the joint optimisation contradicts, and ties with little more support than
/// these: one of them is false, and it is unknown which one. \returns whether there were any
bool drop_contradictory_ties(std::vector<Tie>& ties, const std::vector<std::size_t>& numbers,
                             const GroupFrames& frames) {
  constexpr double kKept = 0.5, kByFar = 2.0;
  std::size_t strongest = 0;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (frames.kept[i] < kKept) strongest = std::max(strongest, ties[numbers[i]].confirmed);
  }
  bool any = false;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    const bool contradicts = frames.kept[i] < kKept;
    any = any || contradicts;
  }
  if (!any) return false;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    Tie& tie = ties[numbers[i]];
    const bool contradicts = frames.kept[i] < kKept;
    const bool weakly_supported =
        static_cast<double>(tie.confirmed) < kByFar * static_cast<double>(strongest);
    if (!contradicts && !weakly_supported) continue;
    tie.joined = false;
    tie.reason = std::to_string(tie.closures.size()) +
                 " closures agree, but they contradict the closures between " + "other components";
  }
  return true;
}

/// Text for a component that is not joined. If there is only one tie, only the later component describes it.
std::string reason_not_joined(const std::vector<JoinComponent>& components, const std::vector<Tie>& ties,
                              std::size_t component) {
  std::size_t computed = 0;
  double overlap = 0.0;
  const Tie* best = nullptr;
  for (const Tie& tie : ties) {
    if (tie.a != component && tie.b != component) continue;
    computed += tie.computed;
    overlap = std::max(overlap, tie.best_overlap);
    if (best == nullptr || tie.closures.size() > best->closures.size()) best = &tie;
  }
  std::string text =
      std::to_string(computed) + " pairs computed, best overlap " + std::to_string(overlap).substr(0, 4);
  const bool described_elsewhere = best != nullptr && best->a == component && ties.size() == 1;
  if (best != nullptr && best->closures.size() > 1 && !described_elsewhere) {
    const std::size_t other = best->a == component ? best->b : best->a;
    text += "; with " + components[other].name + " " + best->reason;
  }
  return text;
}

std::string reason_joined(const std::vector<JoinComponent>& components, const std::vector<Tie>& ties,
                          std::size_t component) {
  std::string text;
  for (const Tie& tie : ties) {
    if (!tie.joined || (tie.a != component && tie.b != component)) continue;
    text += (text.empty() ? "" : "; ") + ("with " + components[tie.a == component ? tie.b : tie.a].name) +
            " " + tie.reason;
  }
  return text;
}

/// Computes the frames of all groups, after dropping ties that contradict each other.
void set_frames(JoinResult& result, const ComponentPaths& paths, const StopToken& stop) {
  for (bool settled = false; !settled;) {
    settled = true;
    const auto groups = groups_of(paths, result.ties);
    result.groups = groups.size();
    for (std::size_t g = 0; g < groups.size(); ++g) {
      const std::vector<std::size_t>& members = groups[g];
      for (const std::size_t c : members) result.frames[c] = ComponentFrame{};
      for (const std::size_t c : members) result.frames[c].group = g;
      if (members.size() == 1) continue;
      const std::vector<std::size_t> numbers = joined_ties(result.ties, members);
      std::vector<const Tie*> ties;
      ties.reserve(numbers.size());
      for (const std::size_t t : numbers) ties.push_back(&result.ties[t]);
      const GroupFrames frames = joining::optimize_group(paths, members, ties, stop);
      if (drop_contradictory_ties(result.ties, numbers, frames)) {
        settled = false;
        break;
      }
      for (std::size_t i = 0; i < members.size(); ++i) {
        result.frames[members[i]].pose = frames.frames[i];
        result.frames[members[i]].covariance = frames.covariances[i];
      }
    }
  }
}

}  // namespace

std::string to_string(const JoinResult& result, const std::vector<JoinComponent>& components) {
  std::size_t joined = 0;
  for (const ComponentFrame& frame : result.frames) joined += frame.group == 0 ? 1 : 0;
  if (joined == 1) joined = 0;
  std::string text = std::to_string(joined) + " of " + std::to_string(components.size()) + " joined";
  for (std::size_t c = 0; c < components.size(); ++c) {
    if (joined > 0 && result.frames[c].group == 0) continue;
    text += "; " + components[c].name + " is not joined: " + result.frames[c].reason;
  }
  return text;
}

JoinResult find_frames(const PoseGraph& graph, const Robots& robots,
                       const std::vector<JoinComponent>& components,
                       const std::vector<ProposedPair>& proposals, const Registrar& registrar,
                       ThreadPool& threads, const JoinOptions& options, const ProgressCallback& progress,
                       const StopToken& stop) {
  validate(options);
  for (const JoinComponent& component : components) {
    if (component.keys.empty()) throw InputError(component.name + ": has no key frames with scans");
  }
  const ComponentPaths paths(graph, components, options);
  JoinResult result;
  result.frames.resize(components.size());
  const joining::SearchContext context{graph, robots, paths, registrar, threads, options, progress, stop};
  for (std::size_t a = 0; a < components.size(); ++a) {
    for (std::size_t b = a + 1; b < components.size(); ++b) {
      const std::string name = components[a].name + " and " + components[b].name;
      const auto order = joining::ordered_pairs(paths, a, b, proposals, options);
      result.ties.push_back(joining::TieSearch(context, a, b, name).run(order));
      result.computed += result.ties.back().computed;
    }
  }
  result.stopped = stop.stop_requested();
  set_frames(result, paths, stop);
  for (std::size_t c = 0; c < components.size(); ++c) {
    const std::string joined = reason_joined(components, result.ties, c);
    result.frames[c].reason = joined.empty() ? reason_not_joined(components, result.ties, c) : joined;
  }
  return result;
}

}  // namespace loopwise
