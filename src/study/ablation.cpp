// SPDX-License-Identifier: BSD-3-Clause
// The paper's Table I over worlds and seeds, and the value of the order of computation.
#include <algorithm>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <tuple>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/io/csv.hpp>
#include <loopwise/study/study.hpp>

#include "../core/constants.hpp"
#include "scheduler.hpp"
#include "tables.hpp"

namespace loopwise::study {
namespace {

/// Name of the rows of odometry alone, which need no run of their own.
constexpr const char* kOdometry = "odom";

/// A figure of one run, with its names in tables and files.
struct Column {
  std::string name;  ///< In CSV and JSON.
  std::string title;
  int decimals;
  std::function<double(const Json& summary)> value;
};

double share(const Json& summary, const std::vector<std::string>& of, const std::vector<std::string>& in) {
  const double whole = figure(summary, in);
  return whole > 0.0 ? 100.0 * figure(summary, of) / whole : (whole == 0.0 ? 0.0 : kNan);
}

std::vector<Column> columns(bool with_maps) {
  const std::vector<std::string> queued{"candidates", "queued"}, computed{"candidates", "computed"};
  const auto count = [](std::string name, std::string title, std::vector<std::string> path) {
    return Column{std::move(name), std::move(title), 0,
                  [path = std::move(path)](const Json& summary) { return figure(summary, path); }};
  };
  const auto percent_of = [](std::string name, std::string title, int decimals, std::vector<std::string> of,
                             std::vector<std::string> in) {
    return Column{
        std::move(name), std::move(title), decimals,
        [of = std::move(of), in = std::move(in)](const Json& summary) { return share(summary, of, in); }};
  };
  std::vector<Column> all{count("generated", "generated", {"candidates", "generated"}),
                          count("queued", "queued", queued),
                          count("computed", "computed", computed),
                          count("verified", "verified", {"closures", "verified"}),
                          count("gnc_inliers", "GNC inliers", {"closures", "gnc_inliers"}),
                          count("true_inliers", "true inliers", {"closures", "true_inliers"}),
                          count("right_inliers", "GNC inliers that are true", {"closures", "right_inliers"}),
                          count("near_inliers", "within 0.5 m and 3°", {"closures", "near_inliers"}),
                          percent_of("computed_of_queued", "computed, % of queued", 2, computed, queued)};
  for (const auto& [name, title] :
       {std::pair("verified", "verified"), std::pair("gnc_inliers", "GNC inliers"),
        std::pair("true_inliers", "true inliers"), std::pair("near_inliers", "within 0.5 m and 3°")}) {
    all.push_back(percent_of(std::string(name) + "_of_queued", std::string(title) + ", % of queued", 3,
                             {"closures", name}, queued));
    all.push_back(percent_of(std::string(name) + "_of_computed", std::string(title) + ", % of computed", 1,
                             {"closures", name}, computed));
  }
  const auto error = [](std::string name, std::string title, std::vector<std::string> path) {
    return Column{std::move(name), std::move(title), 3,
                  [path = std::move(path)](const Json& summary) { return figure(summary, path); }};
  };
  all.push_back(error("ate_m", "ATE, m", {"ate_m", "optimized"}));
  all.push_back(error("ate_se3_m", "ATE aligned, m", {"ate_se3_m", "optimized"}));
  all.push_back(error("odometry_ate_m", "", {"ate_m", "odometry"}));
  all.push_back(error("odometry_ate_se3_m", "", {"ate_se3_m", "odometry"}));
  if (!with_maps) return all;
  all.push_back(count("map_revisits", "revisits that judge the map", {"map_quality", "revisits"}));
  all.push_back(count("map_stretches", "pairs of stretches at which they lie", {"map_quality", "stretches"}));
  all.push_back({"map_coverage", "path at which they lie, %", 0, [](const Json& summary) {
                   return 100.0 * figure(summary, {"map_quality", "coverage"});
                 }});
  all.push_back(error("map_displacement_m", "displacement there, m",
                      {"map_quality", "displacement_m", "estimate", "mean"}));
  all.push_back(
      error("odometry_map_displacement_m", "", {"map_quality", "displacement_m", "recording", "mean"}));
  all.push_back(
      error("map_thickness_m", "thickness of surfaces there, m", {"map_quality", "thickness_m", "estimate"}));
  all.push_back(error("odometry_map_thickness_m", "", {"map_quality", "thickness_m", "recording"}));
  return all;
}

/// Figures of all runs: by method, then mission, then seed.
class Figures {
 public:
  Figures(const std::vector<StudyUnit>& units, const std::vector<UnitResult>& results,
          const std::vector<Column>& columns) {
    std::set<std::pair<std::size_t, std::uint64_t>> seen;
    const bool has_odometry = std::any_of(units.begin(), units.end(), [](const StudyUnit& unit) {
      return unit.config.replay.prioritization.method.empty();
    });
    for (std::size_t i = 0; i < units.size(); ++i) {
      const ReplayOptions& replay = units[i].config.replay;
      const Json& summary = results[i].summary;
      for (const Column& column : columns) {
        values_[{to_string(replay.prioritization.method), column.name, units[i].mission}].push_back(
            column.value(summary));
      }
      // Odometry is the same in every run of a mission and seed.
      if (has_odometry || !seen.emplace(units[i].mission, replay.engine.seed).second) continue;
      for (const Column& column : columns) {
        constexpr std::string_view kOf = "odometry_";
        if (column.name.rfind(kOf, 0) != 0) continue;
        values_[{kOdometry, column.name.substr(kOf.size()), units[i].mission}].push_back(
            column.value(summary));
      }
    }
  }

  /// All seeds of each of these missions.
  [[nodiscard]] std::vector<std::vector<double>> grouped(const std::string& method, const std::string& column,
                                                         const std::vector<std::size_t>& missions) const {
    std::vector<std::vector<double>> groups;
    for (const std::size_t mission : missions) {
      const auto found = values_.find({method, column, mission});
      if (found != values_.end()) groups.push_back(found->second);
    }
    return groups;
  }
  /// All seeds of all these missions.
  [[nodiscard]] std::vector<double> of(const std::string& method, const std::string& column,
                                       const std::vector<std::size_t>& missions) const {
    std::vector<double> all;
    for (const std::vector<double>& seeds : grouped(method, column, missions)) {
      all.insert(all.end(), seeds.begin(), seeds.end());
    }
    return all;
  }
  /// One value for each mission, the mean over its seeds: only missions are independent.
  [[nodiscard]] std::vector<double> by_mission(const std::string& method, const std::string& column,
                                               std::size_t missions) const {
    std::vector<double> all;
    for (std::size_t m = 0; m < missions; ++m) {
      const std::vector<double> seeds = of(method, column, {m});
      double sum = 0.0;
      for (const double v : seeds) sum += v;
      all.push_back(seeds.empty() ? kNan : sum / static_cast<double>(seeds.size()));
    }
    return all;
  }

 private:
  std::map<std::tuple<std::string, std::string, std::size_t>, std::vector<double>> values_;
};

std::string runs_csv(const Study& study, const std::vector<StudyUnit>& units,
                     const std::vector<UnitResult>& results, const std::vector<Column>& columns) {
  std::vector<std::string> names = run_columns();
  for (const Column& column : columns) names.push_back(column.name);
  CsvText csv(names);
  for (std::size_t i = 0; i < units.size(); ++i) {
    std::vector<std::string> row = run_cells(study, units[i], results[i]);
    for (const Column& column : columns) row.push_back(number_text(column.value(results[i].summary)));
    csv.row(row);
  }
  return csv.text();
}

/// The data of the tables, and their two formats.
struct Tables {
  std::vector<Column> columns;
  Figures figures;
  std::vector<std::string> methods;  ///< Odometry alone is first, unless another place is requested.
  std::vector<World> worlds;
  std::size_t missions;
  Json json;
  std::string text;

  [[nodiscard]] bool has(const std::string& method) const {
    return std::find(methods.begin(), methods.end(), method) != methods.end();
  }
};

void add_world(Tables& t, const World& world) {
  Json of_world = {{"world", world.name},
                   {"missions", world.missions.size()},
                   {"parameters_sha256", world.parameters},
                   {"methods", Json::object()}};
  std::vector<std::vector<std::string>> rows{{"figure"}};
  for (const std::string& method : t.methods) rows.front().push_back(method);
  for (const Column& column : t.columns) {
    if (column.title.empty()) continue;
    std::vector<std::string> row{column.title};
    for (const std::string& method : t.methods) {
      const std::vector<double> values = t.figures.of(method, column.name, world.missions);
      row.push_back(cell(quartiles(values), column.decimals));
      if (values.empty()) continue;
      object_at(of_world["methods"], method)[column.name] = quartiles_json(values);
    }
    rows.push_back(row);
    if (column.name != "ate_m") continue;
    rows.push_back({"ATE, m: interval of the median"});
    for (const std::string& method : t.methods) {
      const Interval interval = bootstrap_median(t.figures.grouped(method, column.name, world.missions));
      rows.back().push_back(text_of(interval, 3));
      object_at(object_at(of_world["methods"], method), column.name)["interval_95"] = interval_json(interval);
    }
  }
  t.json["worlds"].push_back(of_world);
  t.text += "\n## " + describe(world) + "\n\n" + markdown_table(rows);
}

/// Explains the figures of maps, and counts the runs without such figures.
std::string map_text(const std::vector<UnitResult>& results) {
  const auto weak = std::count_if(results.begin(), results.end(), [](const UnitResult& result) {
    const Json quality = result.summary.value("map_quality", Json());
    return !quality.is_object() || quality.value("not_meaningful", Json()).is_string();
  });
  std::string text =
      "\nMaps are judged without the truth: displacement of the poses from registrations of revisits that "
      "took "
      "no part in the estimate, and thickness of the surfaces that both scans of a revisit saw.";
  if (weak > 0) {
    text += " Not meaningful for " + std::to_string(weak) + " of " + counted(results.size(), "run") +
            ": their revisits are too few.";
  }
  return text + "\n";
}

/// All missions together.
void add_pooled(Tables& t) {
  t.json["pooled"] = Json::object();
  std::vector<std::vector<std::string>> rows{
      {"ATE", "against", "lower in", "mean difference, m", "ratio (geometric mean)"}};
  for (const std::string& method : t.methods) {
    for (const std::string& other :
         {std::string("baseline"), std::string(kOdometry), std::string("random")}) {
      if (method == other || method == kOdometry || (method == "baseline" && other == "random")) continue;
      if (!t.has(other)) continue;
      const PairedComparison c = compare_paired(t.figures.by_mission(method, "ate_m", t.missions),
                                                t.figures.by_mission(other, "ate_m", t.missions));
      object_at(t.json["pooled"], method)[other] = comparison_json(c);
      rows.push_back({method, other, std::to_string(c.better) + " of " + std::to_string(c.count),
                      cell(c.mean_difference, c.difference, 3), cell(c.ratio, c.ratio_interval, 3)});
    }
  }
  if (rows.size() > 1)
    t.text += "\n## All " + counted(t.missions, "mission") + ", paired\n\n" + markdown_table(rows);
}

void add_reductions(Tables& t) {
  std::vector<std::vector<std::string>> rows{{"median ATE lower by, %"}};
  for (const World& world : t.worlds) rows.front().push_back(world.name);
  rows.front().push_back("mean");
  t.json["reductions_percent"] = Json::object();
  for (const std::string& method : t.methods) {
    for (const std::string& other : {std::string(kOdometry), std::string("baseline")}) {
      if (method == other || method == kOdometry || !t.has(other)) continue;
      std::vector<std::string> row{method + " than " + other};
      double sum = 0.0;
      Json& entry = object_at(object_at(t.json["reductions_percent"], method), other);
      for (const World& world : t.worlds) {
        const double of_other = quartiles(t.figures.of(other, "ate_m", world.missions)).median;
        const double reduction =
            100.0 * (1.0 - quartiles(t.figures.of(method, "ate_m", world.missions)).median / of_other);
        sum += reduction;
        row.push_back(fixed(reduction, 1));
        entry[world.name] = number_or_null(reduction);
      }
      const double mean = sum / static_cast<double>(t.worlds.size());
      entry["mean"] = number_or_null(mean);
      row.push_back(fixed(mean, 1));
      rows.push_back(row);
    }
  }
  if (rows.size() > 1)
    t.text +=
        "\n## Reductions\n\nThe paper reports 51 % against odometry and 75 % against baseline (full, mean "
        "over its data sets).\n\n" +
        markdown_table(rows);
}

}  // namespace

std::optional<StudyReport> ablation(const StudyOptions& options, const AblationOptions& wanted,
                                    const StudyHooks& hooks) {
  std::vector<std::string> methods = canonical_methods(wanted.methods);
  Study study("ablation", options, hooks);
  std::vector<StudyUnit> units = units_by_method(study, methods, wanted.workers);
  for (StudyUnit& unit : units) unit.map_quality = wanted.map_quality;
  const auto results = study.run(units);
  if (!results) return std::nullopt;

  const std::vector<Column> all = columns(wanted.map_quality);
  if (std::find(methods.begin(), methods.end(), kOdometry) == methods.end()) {
    methods.insert(methods.begin(), kOdometry);
  }
  const Config& config = units.front().config;
  Tables t{all,
           Figures(units, *results, all),
           methods,
           worlds_of(study.missions()),
           study.missions().size(),
           study_json(study),
           {}};
  t.json["options"] = parse_json(config_json(config), "options");
  t.json["methods"] = methods;
  t.json["worlds"] = Json::array();
  t.text =
      "# Ablation\n\n" + budget_text(config) +
      " Medians over missions and seeds, quartiles in brackets. ATE is the mean error of the positions " +
      frame_text(study.missions()) +
      "; true inliers are within 0.05 m and 0.05 rad of the truth. Intervals are percentile bootstraps over "
      "missions, 95 %.\n";
  if (wanted.map_quality) t.text += map_text(*results);
  for (const World& world : t.worlds) add_world(t, world);
  add_pooled(t);
  add_reductions(t);
  return StudyReport{json_text(t.json, 2) + "\n", t.text, runs_csv(study, units, *results, all)};
}

}  // namespace loopwise::study
