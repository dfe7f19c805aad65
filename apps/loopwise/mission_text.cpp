// SPDX-License-Identifier: BSD-3-Clause
#include "mission_text.hpp"

#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>

#include "units.hpp"

namespace loopwise::cli {

void add_candidates(const Mission& mission, const CandidateStatisticsOptions& options, Json& json,
                    std::string& text) {
  const CandidateStatistics found = candidate_statistics(mission, options);
  json["candidates"] = {{"radius_m", options.radius_m},
                        {"generated", found.candidates},
                        {"looked_at", found.looked_at},
                        {"mean_overlap", number_or_null(found.mean_overlap)},
                        {"overlapping", number_or_null(found.overlapping)},
                        {"within_radius", number_or_null(found.within_radius)}};
  text += "pairs        " + std::to_string(found.candidates) + " of nodes within " +
          fixed(options.radius_m, 0) + " m";
  if (found.looked_at > 0) {
    text += "; the scans of " + fixed(100.0 * found.overlapping, 1) +
            " % overlap at the true poses (sample of " + std::to_string(found.looked_at) + ")";
  }
  text += "\n";
}

void add_drift(const Mission& mission, Json& json, std::string& text) {
  const std::vector<RobotDrift> drifts = odometry_drift(mission);
  Json all = Json::array();
  std::vector<std::vector<std::string>> rows{
      {"drift of", "largest m", "% of length", "largest deg", "end m"}};
  for (const RobotDrift& drift : drifts) {
    all.push_back({{"robot", drift.robot},
                   {"length_m", drift.length_m},
                   {"largest_error_m", drift.largest_m},
                   {"largest_error_rad", drift.largest_rad},
                   {"end_error_m", drift.end_m}});
    rows.push_back({drift.robot, fixed(drift.largest_m, 2),
                    fixed(100.0 * drift.largest_m / drift.length_m, 2),
                    fixed(drift.largest_rad * kDegreesPerRadian, 2), fixed(drift.end_m, 2)});
  }
  json["drift"] = all;
  if (!drifts.empty()) text += "\n" + table(rows);
}

void add_topics(const Mission& mission, Json& json, std::string& text) {
  if (mission.topics.empty()) return;
  Json all = Json::array();
  std::vector<std::vector<std::string>> rows{{"topic", "type", "messages", "used as"}};
  for (const RecordedTopic& topic : mission.topics) {
    all.push_back(
        {{"name", topic.name}, {"type", topic.type}, {"messages", topic.messages}, {"use", topic.use}});
    rows.push_back(
        {topic.name, topic.type, std::to_string(topic.messages), topic.use.empty() ? "-" : topic.use});
  }
  json["topics"] = all;
  text += "\n" + table(rows);
}

}  // namespace loopwise::cli
