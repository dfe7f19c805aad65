// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/replay/options.hpp>

namespace loopwise {

/// A candidate with its scores.
struct CandidateScores {
  LoopCandidate candidate;          ///< Both ends, source and distance.
  std::optional<std::size_t> rank;  ///< Place in the order of the method, from 1; empty if not requested.
  std::string refused;              ///< Why every prioritiser of the method refused it; otherwise empty.
  double observability_from = 0.0;  ///< Score of the newer scan, paper §III-C; NaN without a scan.
  double observability_to = 0.0;    ///< Score of the older scan.
  /// Decrease of the trace of the covariances by this closure alone, m²; 0 if it connects, NaN if the graph
  /// leaves a pose undetermined.
  double gain_m2 = 0.0;
  bool connecting = false;  ///< It connects parts of the graph of which one has no prior.
};

/// Number of ranked candidates, and effort.
struct RankOptions {
  std::size_t count = 0;             ///< Candidates to rank; 0: one batch of the configuration.
  std::uint64_t evaluations = 1000;  ///< Evaluated sets with which graph information improves each batch.
  std::size_t exact_up_to = 5000;    ///< Gains of more candidates than this are estimated from random probes.
};

/// All candidates of a graph and the order of a method.
struct Ranking {
  std::vector<CandidateScores> candidates;     ///< Ranked candidates in order, then the others as generated.
  std::size_t ranked = 0;                      ///< Number of ranked candidates.
  bool gains_exact = true;                     ///< False: estimated, see RankOptions::exact_up_to.
  double trace_m2 = 0.0;                       ///< e(PG): the trace now.
  double trace_ranked_m2 = 0.0;                ///< The trace with closures at all ranked candidates.
  std::map<std::string, std::size_t> refused;  ///< Number of refused candidates, by reason.
  std::string problem;                         ///< Why the trace is missing; empty if it exists.
};

/// A row for every candidate in the order of the ranking: rank (empty if there is no rank), from, to, source,
/// distance_m, observability_from, observability_to, gain_m2, connecting (1 or 0) and refused.
[[nodiscard]] LOOPWISE_EXPORT std::string ranking_csv(const Ranking& ranking);

/// All candidates of a mission's graph at its current poses, in the order of their generation, numbered from
/// 0. Pairs with an edge are left out; pairs of radio beacons are included if the method uses them.
[[nodiscard]] LOOPWISE_EXPORT std::vector<LoopCandidate> all_candidates(const Mission& mission,
                                                                        const ReplayOptions& options);

/// Ranks the candidates of a mission's graph at its current poses, with its closures (whose pairs are left
/// out), in the order in which the method would compute them. No registration is computed. `features` may be
/// null; observability is then unknown.
[[nodiscard]] LOOPWISE_EXPORT Ranking rank_candidates(const Mission& mission, const ReplayOptions& replay,
                                                      std::shared_ptr<FeatureCache> features,
                                                      const RankOptions& options = {},
                                                      const ProgressCallback& progress = {},
                                                      const StopToken& stop = {});

}  // namespace loopwise
