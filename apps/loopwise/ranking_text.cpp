// SPDX-License-Identifier: BSD-3-Clause
#include "ranking_text.hpp"

#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>

namespace loopwise::cli {

Json ranking_json(const Ranking& ranking) {
  Json order = Json::array();
  for (const CandidateScores& s : ranking.candidates) {
    if (!s.rank) break;
    order.push_back(
        {{"rank", *s.rank},
         {"from", std::to_string(s.candidate.from)},
         {"to", std::to_string(s.candidate.to)},
         {"source", enum_name(s.candidate.source)},
         {"distance_m", s.candidate.distance_m},
         {"observability", {number_or_null(s.observability_from), number_or_null(s.observability_to)}},
         {"gain_m2", number_or_null(s.gain_m2)},
         {"connecting", s.connecting}});
  }
  return {
      {"candidates", ranking.candidates.size()},
      {"ranked", ranking.ranked},
      {"refused", ranking.refused},
      {"gains_exact", ranking.gains_exact},
      {"trace_m2",
       {{"now", number_or_null(ranking.trace_m2)}, {"with_ranked", number_or_null(ranking.trace_ranked_m2)}}},
      {"order", order}};
}

std::string ranking_text(const Ranking& ranking, const std::string& method) {
  constexpr std::size_t kShown = 20;
  std::vector<std::vector<std::string>> rows{
      {"rank", "from", "to", "source", "distance", "observability", "gain (m²)"}};
  for (const CandidateScores& s : ranking.candidates) {
    if (!s.rank || *s.rank > kShown) break;
    rows.push_back({std::to_string(*s.rank), key_name(s.candidate.from), key_name(s.candidate.to),
                    enum_name(s.candidate.source), fixed(s.candidate.distance_m, 1),
                    fixed(s.observability_from + s.observability_to, 3),
                    s.connecting ? "connects" : fixed(s.gain_m2, 4)});
  }
  std::string text = table(rows);
  if (ranking.ranked > kShown) text += "... " + std::to_string(ranking.ranked - kShown) + " more ranked\n";
  text += std::to_string(ranking.candidates.size()) + " candidates, " + std::to_string(ranking.ranked) +
          " ranked by method " + method;
  for (const auto& [reason, count] : ranking.refused)
    text += ", " + std::to_string(count) + " refused: " + reason;
  return text + "\ntrace of the covariances " + fixed(ranking.trace_m2, 4) + " m² now, " +
         fixed(ranking.trace_ranked_m2, 4) + " m² with closures at the ranked\n";
}

}  // namespace loopwise::cli
