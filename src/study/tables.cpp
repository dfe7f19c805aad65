// SPDX-License-Identifier: BSD-3-Clause
#include "tables.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <loopwise/core/error.hpp>

namespace loopwise::study {

std::string cell(const Quartiles& q, int decimals) {
  if (q.count <= 1) return fixed(q.median, decimals);
  return fixed(q.median, decimals) + " (" + fixed(q.lower, decimals) + "–" + fixed(q.upper, decimals) + ")";
}

std::string text_of(const Interval& interval, int decimals) {
  if (std::isnan(interval.low)) return "-";
  return fixed(interval.low, decimals) + " to " + fixed(interval.high, decimals);
}

std::string cell(double value, const Interval& interval, int decimals) {
  return fixed(value, decimals) + (std::isnan(interval.low) ? "" : " (" + text_of(interval, decimals) + ")");
}

std::string number_text(double value) {
  if (std::isnan(value)) return "";
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

std::vector<std::string> run_columns() {
  return {"world",          "mission",        "mission_seed",        "parameters_sha256",
          "method",         "seed",           "registration_time_s", "refused_time_share",
          "workers",        "thin",           "after_mission",       "mission_end_s",
          "mission_time_s", "truth_alignment"};
}

std::vector<std::string> run_cells(const Study& study, const StudyUnit& unit, const UnitResult& result) {
  const StudyMission& m = study.missions()[unit.mission];
  const ReplayOptions& r = unit.config.replay;
  return {m.world,
          m.name,
          m.seed,
          m.parameters_sha256,
          to_string(r.prioritization.method),
          std::to_string(r.engine.seed),
          r.cost.measured_time ? "measured" : number_text(r.cost.registration_time_s),
          number_text(r.cost.refused_time_share),
          std::to_string(r.cost.workers),
          std::to_string(r.engine.thin),
          r.after_mission ? "1" : "0",
          number_text(figure(result.summary, {"mission_end_s"})),
          number_text(figure(result.summary, {"mission_time_s"})),
          m.truth_is_aligned ? "se3" : "none"};
}

std::vector<std::string> canonical_methods(const std::vector<std::string>& methods) {
  if (methods.empty()) throw OptionError("--methods names none");
  std::vector<std::string> canonical;
  for (const std::string& method : methods) {
    canonical.push_back(to_string(parse_method(method)));
    if (std::find(canonical.begin(), canonical.end() - 1, canonical.back()) != canonical.end() - 1) {
      throw OptionError("--methods names \"" + method + "\" twice");
    }
  }
  return canonical;
}

Json& object_at(Json& parent, const std::string& name) {
  if (!parent.contains(name)) parent[name] = Json::object();
  return parent[name];
}

Json quartiles_json(const std::vector<double>& values) {
  const Quartiles q = quartiles(values);
  return {{"count", q.count},
          {"median", number_or_null(q.median)},
          {"lower_quartile", number_or_null(q.lower)},
          {"upper_quartile", number_or_null(q.upper)}};
}

Json interval_json(const Interval& interval) {
  return {number_or_null(interval.low), number_or_null(interval.high)};
}

Json comparison_json(const PairedComparison& c) {
  return {{"missions", c.count},
          {"better", c.better},
          {"mean_difference_m", number_or_null(c.mean_difference)},
          {"difference_interval_95_m", interval_json(c.difference)},
          {"ratio", number_or_null(c.ratio)},
          {"ratio_interval_95", interval_json(c.ratio_interval)}};
}

std::vector<World> worlds_of(const std::vector<StudyMission>& missions) {
  std::vector<World> worlds;
  for (std::size_t m = 0; m < missions.size(); ++m) {
    auto world = std::find_if(worlds.begin(), worlds.end(),
                              [&](const World& w) { return w.name == missions[m].world; });
    if (world == worlds.end()) world = worlds.insert(worlds.end(), {missions[m].world, {}, {}});
    world->missions.push_back(m);
    const std::string& parameters = missions[m].parameters_sha256;
    if (!parameters.empty() && std::find(world->parameters.begin(), world->parameters.end(), parameters) ==
                                   world->parameters.end()) {
      world->parameters.push_back(parameters);
    }
  }
  return worlds;
}

std::string describe(const World& world) {
  std::string text = world.name + ": " + counted(world.missions.size(), "mission");
  for (const std::string& parameters : world.parameters) text += ", parameters " + parameters.substr(0, 12);
  return text;
}

std::string frame_text(const std::vector<StudyMission>& missions) {
  std::string aligned;
  std::size_t count = 0;
  for (const StudyMission& mission : missions) {
    if (!mission.truth_is_aligned) continue;
    aligned += (count++ > 0 ? ", " : "") + mission.name;
  }
  if (count == 0) return "in the common frame without alignment";
  const std::string after = "after the best rigid motion, since the truth stands in another frame";
  if (count == missions.size()) return after;
  return "in the common frame without alignment, but of " + aligned + " " + after +
         " (aligned errors alone are comparable between these missions and the others)";
}

std::string budget_text(const Config& config) {
  const ReplayOptions& r = config.replay;
  std::string text = r.cost.measured_time
                         ? "A registration takes as long as it took here"
                         : "A registration takes " + fixed(r.cost.registration_time_s, 3) + " s";
  if (r.cost.refused_time_share != 1.0)
    text += " (" + fixed(r.cost.refused_time_share, 2) + " times as long if it is refused)";
  text += " of mission time on one of " + std::to_string(r.cost.workers) + " workers; batches of " +
          std::to_string(batch_size(r)) + "; an evaluation of graph information takes " +
          fixed(r.cost.gi_evaluation_time_s, 3) + " s.";
  if (r.engine.thin > 1) {
    text += " Candidates are thinned: one in " + std::to_string(r.engine.thin) +
            ", drawn uniformly by pair and seed.";
  }
  if (r.max_registrations > 0)
    text += " No more than " + std::to_string(r.max_registrations) + " registrations.";
  return text;
}

}  // namespace loopwise::study
