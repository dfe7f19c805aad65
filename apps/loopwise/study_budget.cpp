// SPDX-License-Identifier: BSD-3-Clause
// Errors against what may be computed: on larger computers, later in the mission, and after it until
// everything is computed.
#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <tuple>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

#include "study.hpp"
#include "study_tables.hpp"
#include "study_units.hpp"

namespace loopwise::cli {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
/// Moments after the mission, in units of its duration.
constexpr double kAfter[] = {1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0};

struct Options {
  StudyOptions study;
  std::vector<std::string> methods{"baseline", "full"};
  std::vector<std::int64_t> workers{2, 10, 50};
  std::string everything = "baseline";
};

/// Role of a unit in the study.
struct Role {
  std::string method;
  std::int64_t workers = 0;
  bool everything = false;  ///< Goes on after the mission until nothing is pending.
  bool operator<(const Role& other) const {
    return std::tie(everything, workers, method) < std::tie(other.everything, other.workers, other.method);
  }
};

std::string label(const Role& role) {
  return role.method + "-w" + std::to_string(role.workers) + (role.everything ? "-everything" : "");
}

std::string title(const Role& role) {
  return role.method + ", " + counted(static_cast<std::size_t>(role.workers), "worker");
}

/// The last row at or before a time; null before the first.
const HistoryRow* row_at(const std::vector<HistoryRow>& history, double time_s) {
  const HistoryRow* last = nullptr;
  for (const HistoryRow& row : history) {
    if (row.mission_time_s <= time_s) last = &row;
  }
  return last;
}

struct Run {
  std::size_t mission = 0;
  double mission_end_s = 0.0;
  const UnitResult* result = nullptr;
};

/// A value of each run of some missions.
template <class Value>
std::vector<double> values(const std::vector<Run>& runs, const std::vector<std::size_t>& missions,
                           Value&& value) {
  std::vector<double> out;
  for (const Run& run : runs) {
    if (std::find(missions.begin(), missions.end(), run.mission) != missions.end()) out.push_back(value(run));
  }
  return out;
}

double ate(const Run& run) {
  return figure(run.result->summary, {"ate_m", "optimized"});
}
double odometry_ate(const Run& run) {
  return figure(run.result->summary, {"ate_m", "odometry"});
}

/// Mean over the seeds of each mission.
std::vector<double> by_mission(const std::vector<Run>& runs, std::size_t missions) {
  std::vector<double> out;
  for (std::size_t m = 0; m < missions; ++m) {
    const std::vector<double> seeds = values(runs, {m}, ate);
    double sum = 0.0;
    for (const double v : seeds) sum += v;
    out.push_back(seeds.empty() ? kNan : sum / static_cast<double>(seeds.size()));
  }
  return out;
}

int run(Options options) {
  Console console(options.study.common.quiet);
  const InterruptGuard interrupt;
  options.methods = canonical_methods(options.methods);
  if (options.everything != "none") static_cast<void>(parse_method(options.everything));
  if (options.workers.empty()) throw OptionError("--workers names none");
  for (std::size_t i = 0; i < options.workers.size(); ++i) {
    if (std::count(options.workers.begin(), options.workers.end(), options.workers[i]) > 1) {
      throw OptionError("--workers names " + std::to_string(options.workers[i]) + " twice");
    }
  }
  Study study("budget", options.study, console);
  const std::int64_t thin = study.config().replay.engine.thin;
  if (thin > 1 && options.everything == "none")
    throw OptionError("--thin thins what is computed after the mission, which --everything none leaves out");
  // The everything-run comes after the mission in any case: the computer decides how soon, not what it finds.
  const bool has_usual = std::find(options.workers.begin(), options.workers.end(),
                                   study.config().replay.cost.workers) != options.workers.end();
  const std::int64_t usual = has_usual ? study.config().replay.cost.workers : options.workers.front();

  std::vector<Role> roles;
  for (const std::int64_t workers : options.workers) {
    for (const std::string& method : options.methods) roles.push_back({method, workers, false});
  }
  const Role everything{options.everything, usual, true};
  if (options.everything != "none") roles.push_back(everything);
  std::vector<StudyUnit> units;
  std::vector<Role> role_of;
  for (std::size_t m = 0; m < study.missions().size(); ++m) {
    for (const std::uint64_t seed : study.seeds()) {
      for (const Role& role : roles) {
        StudyUnit unit{m, label(role), study.config()};
        unit.config.replay.prioritization.method = parse_method(role.method);
        unit.config.replay.cost.workers = role.workers;
        unit.config.replay.engine.seed = seed;
        unit.config.replay.after_mission = role.everything;
        unit.config.replay.engine.thin = role.everything ? thin : 1;
        units.push_back(unit);
        role_of.push_back(role);
      }
    }
  }
  const auto results = study.run(units, interrupt.token());
  if (!results) return study.status_without_results();

  std::map<Role, std::vector<Run>> runs;
  std::vector<std::string> header = run_columns();
  header.insert(header.end(), {"time_s", "computed", "queued", "verified", "gnc_inliers", "true_inliers",
                               "ate_m", "odometry_ate_m"});
  CsvText csv(header);
  for (std::size_t i = 0; i < units.size(); ++i) {
    const UnitResult& result = (*results)[i];
    runs[role_of[i]].push_back({units[i].mission, figure(result.summary, {"mission_end_s"}), &result});
    for (const HistoryRow& row : result.history) {
      std::vector<std::string> cells = run_cells(study, units[i], result);
      cells.insert(cells.end(), {number_text(row.mission_time_s), std::to_string(row.computed),
                                 std::to_string(row.queued), std::to_string(row.verified),
                                 std::to_string(row.gnc_inliers), std::to_string(row.true_inliers),
                                 number_text(row.ate_m), number_text(row.odometry_ate_m)});
      csv.row(cells);
    }
  }

  Json json = study_json(study);
  json["workers"] = options.workers;
  json["methods"] = options.methods;
  json["everything"] = {{"method", options.everything}, {"workers", usual}, {"thin", thin}};
  json["worlds"] = Json::array();
  Config shown = study.config();
  shown.replay.cost.workers = usual;
  shown.replay.engine.thin = 1;
  std::string text =
      "# Errors against computation\n\n" + budget_text(shown) +
      " Other numbers of workers are named. Medians over missions and seeds, quartiles in brackets; ATE "
      "in m, " +
      frame_text(study.missions()) +
      ", over the nodes that have arrived; not known before a run's end where the truth stands in another "
      "frame.";
  if (options.everything != "none") {
    text +=
        " *Everything computed*: after the mission's end until no candidate is pending, in the order of " +
        options.everything +
        (thin > 1 ? ", one candidate in " + std::to_string(thin) + " drawn uniformly by pair and seed."
                  : ".");
  }
  text += "\n";
  for (const World& world : worlds_of(study.missions())) {
    Json of_world = {
        {"world", world.name}, {"missions", world.missions.size()}, {"parameters_sha256", world.parameters}};
    text += "\n## " + describe(world) + "\n\nAt the mission's end:\n\n";

    std::vector<std::vector<std::string>> rows{{"", "computed", "ATE"}};
    const std::vector<double> odometry = values(runs.begin()->second, world.missions, odometry_ate);
    rows.push_back({"odometry", "0", cell(quartiles(odometry), 3)});
    of_world["odometry_ate_m"] = quartiles_json(odometry);
    of_world["at_end"] = Json::array();
    for (const Role& role : roles) {
      const auto computed = [](const Run& r) {
        return figure(r.result->summary, {"candidates", "computed"});
      };
      const std::vector<double> counts = values(runs[role], world.missions, computed),
                                errors = values(runs[role], world.missions, ate);
      const std::vector<double> durations = values(runs[role], world.missions, [](const Run& r) {
        return figure(r.result->summary, {"mission_time_s"}) / r.mission_end_s;
      });
      std::string name = title(role);
      if (role.everything) {
        name = "everything computed, " + fixed(quartiles(durations).median, 1) + " mission durations";
      }
      rows.push_back({name, cell(quartiles(counts), 0), cell(quartiles(errors), 3)});
      of_world["at_end"].push_back({{"method", role.method},
                                    {"workers", role.workers},
                                    {"everything", role.everything},
                                    {"durations", quartiles_json(durations)},
                                    {"computed", quartiles_json(counts)},
                                    {"ate_m", quartiles_json(errors)}});
    }
    text += markdown_table(rows);

    // Over time: within the mission every way, after it the run that goes on.
    rows = {{"share of the mission", "odometry"}};
    for (const Role& role : roles) {
      if (!role.everything) rows.front().push_back(title(role));
    }
    of_world["over_time"] = Json::array();
    for (int tenth = 1; tenth <= 10; ++tenth) {
      const auto at = [&](auto&& value) {
        return [&, value](const Run& r) {
          const HistoryRow* row = row_at(r.result->history, 0.1 * tenth * r.mission_end_s);
          return row ? value(*row) : kNan;
        };
      };
      const std::vector<double> alone = values(runs.begin()->second, world.missions,
                                               at([](const HistoryRow& row) { return row.odometry_ate_m; }));
      rows.push_back({std::to_string(10 * tenth) + " %", cell(quartiles(alone), 3)});
      Json entry = {
          {"share", 0.1 * tenth}, {"odometry_ate_m", quartiles_json(alone)}, {"runs", Json::array()}};
      for (const Role& role : roles) {
        if (role.everything) continue;
        const std::vector<double> errors =
            values(runs[role], world.missions, at([](const HistoryRow& row) { return row.ate_m; }));
        rows.back().push_back(cell(quartiles(errors), 3));
        entry["runs"].push_back(
            {{"method", role.method}, {"workers", role.workers}, {"ate_m", quartiles_json(errors)}});
      }
      of_world["over_time"].push_back(entry);
    }
    text += "\nDuring the mission, ATE:\n\n" + markdown_table(rows);

    if (options.everything != "none") {
      rows = {{"mission durations", "computed", "ATE"}};
      of_world["after_mission"] = Json::array();
      const std::vector<double> ends = values(runs[everything], world.missions, [](const Run& r) {
        return figure(r.result->summary, {"mission_time_s"}) / r.mission_end_s;
      });
      const double last = ends.empty() ? 0.0 : *std::max_element(ends.begin(), ends.end());
      for (const double factor : kAfter) {
        const auto at = [&](auto&& value) {
          return values(runs[everything], world.missions, [&](const Run& r) {
            const HistoryRow* row = row_at(r.result->history, factor * r.mission_end_s);
            return row ? value(*row) : kNan;
          });
        };
        const std::vector<double> counts = at(
                                      [](const HistoryRow&row) { return static_cast<double>(row.computed); }),
                                  errors = at([](const HistoryRow&row) { return row.ate_m; });
        rows.push_back({fixed(factor, 2), cell(quartiles(counts), 0), cell(quartiles(errors), 3)});
        of_world["after_mission"].push_back(
            {{"durations", factor}, {"computed", quartiles_json(counts)}, {"ate_m", quartiles_json(errors)}});
        if (factor >= last) break;
      }
      text += "\nGoing on after the mission (" + title(everything) + "):\n\n" + markdown_table(rows);
    }
    json["worlds"].push_back(of_world);
  }

  // All missions together, paired: computers against each other, and within the mission against everything.
  const std::size_t missions = study.missions().size();
  std::vector<std::vector<std::string>> rows{
      {"ATE", "against", "lower in", "mean difference, m", "ratio (geometric mean)"}};
  json["pooled"] = Json::array();
  const auto compare = [&](const Role& a, const Role& b) {
    const PairedComparison c = compare_paired(by_mission(runs[a], missions), by_mission(runs[b], missions));
    const auto name = [](const Role& r) {
      return r.everything ? std::string("everything computed") : title(r);
    };
    rows.push_back({name(a), name(b), std::to_string(c.better) + " of " + std::to_string(c.count),
                    cell(c.mean_difference, c.difference, 3), cell(c.ratio, c.ratio_interval, 3)});
    Json entry = comparison_json(c);
    entry["run"] = label(a);
    entry["against"] = label(b);
    json["pooled"].push_back(entry);
  };
  for (const std::string& method : options.methods) {
    for (const std::int64_t workers : options.workers) {
      if (workers != usual) compare({method, workers, false}, {method, usual, false});
    }
    if (options.everything != "none") compare({method, usual, false}, everything);
  }
  if (rows.size() > 1)
    text += "\n## All " + counted(missions, "mission") + ", paired\n\n" + markdown_table(rows);

  write_file(study.folder() / "curves.csv", csv.text());
  write_file(study.folder() / "budget.json", json_text(json, 2) + "\n");
  write_file(study.folder() / "budget.md", text);
  print_results(options.study.common, json, text);
  return kDone;
}

}  // namespace

void add_budget_study(CLI::App& study, Action& chosen, Transport* job) {
  const auto options = std::make_shared<Options>();
  options->study.job = job;
  CLI::App* command = study.add_subcommand(
      "budget", "Errors against computation: computers, mission time, everything computed");
  command->footer(
      "  loopwise study budget tunnel-* -o budget --workers 2,10,50\n"
      "  loopwise study budget mine-* -o budget --thin 20      everything computed: one candidate in 20\n"
      "DIR gets curves.csv, budget.json, budget.md and budget_timings.csv. Runs are kept as by 'study "
      "ablation', and\n"
      "shared with it if DIR is the same.");
  command->add_option("--methods", options->methods, "Methods, by commas (default baseline,full)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("LIST");
  command
      ->add_option("--workers", options->workers,
                   "Computers, by their registrations at a time, by commas (default 2,10,50)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("LIST");
  command
      ->add_option(
          "--everything", options->everything,
          "Method in whose order everything is computed after the mission, or none (default baseline)")
      ->type_name("M");
  add_study_options(*command, options->study);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
