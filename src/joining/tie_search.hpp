// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Searches closures between two components and decides whether they join the components. Private to joining.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/joining/join.hpp>

#include "component_paths.hpp"
#include "consistency.hpp"

namespace loopwise::joining {

/// Data that all searches share.
struct SearchContext {
  const PoseGraph& graph;
  const Robots& robots;
  const ComponentPaths& paths;
  const Registrar& registrar;
  ThreadPool& threads;
  const JoinOptions& options;
  const ProgressCallback& progress;
  const StopToken& stop;
};

/// Nodes of b and a that may have seen the same place.
using NodePair = std::pair<std::size_t, std::size_t>;

/// Pairs between components a and b in the order in which they are registered: proposed ones by similarity,
/// the best of each two places first, then pairs that spread over both paths. At most options.max_pairs.
[[nodiscard]] std::vector<NodePair> ordered_pairs(const ComponentPaths& paths, std::size_t a, std::size_t b,
                                                  const std::vector<ProposedPair>& proposals,
                                                  const JoinOptions& options);

/// Closures that agree on a frame, and the results of pairs that test this frame.
struct Hypothesis {
  std::vector<std::size_t> group;  ///< Numbers in the closure set, ascending.
  std::size_t tested = 0;          ///< Pairs that the frame puts close together.
  std::size_t confirmed = 0;       ///< Pairs among them whose registration agrees with the frame.

  [[nodiscard]] double share() const {
    return tested == 0 ? 0.0 : static_cast<double>(confirmed) / static_cast<double>(tested);
  }
};

/// Searches ties between two components until the evidence suffices or the pairs run out.
class TieSearch {
 public:
  TieSearch(const SearchContext& context, std::size_t a, std::size_t b, std::string name);
  /// Registers pairs in this order and judges. Ends early when a stop is requested.
  [[nodiscard]] Tie run(const std::vector<NodePair>& order);

 private:
  struct Outcome {
    bool counts = true;  ///< False if a circumstance, such as a missing scan, decided the result.
    std::optional<std::size_t> closure;  ///< Number in closures_, if verified.
  };

  void compute(const std::vector<NodePair>& pairs);
  [[nodiscard]] std::vector<NodePair> near_pairs(const std::vector<std::size_t>& group, bool farthest) const;
  [[nodiscard]] std::optional<NodePair> near_pair(std::size_t b, const PairClosure& by, double reach_m,
                                                  bool farthest) const;
  [[nodiscard]] double distance_of(const std::vector<std::size_t>& group, double share) const;
  void confirm(Hypothesis& hypothesis);
  [[nodiscard]] std::vector<std::size_t> against(const std::vector<std::size_t>& group) const;
  [[nodiscard]] Hypothesis grown(const std::vector<std::size_t>& best);
  /// The best frame and the best of those that contradict it.
  [[nodiscard]] std::pair<Hypothesis, Hypothesis> hypotheses();
  void judge(Tie& tie, const Hypothesis& best, const Hypothesis& rival) const;
  [[nodiscard]] std::string refusal(const Tie& tie) const;

  const SearchContext& context_;
  std::size_t a_, b_;
  std::string name_;
  ClosureSet closures_;
  std::map<NodePair, Outcome> outcomes_;
  std::size_t planned_ = 0;
  double best_overlap_ = 0.0;
};

}  // namespace loopwise::joining
