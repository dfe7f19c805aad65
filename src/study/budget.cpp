// SPDX-License-Identifier: BSD-3-Clause
// Errors against the amount of computation: on larger computers, later in the mission, and after it until
// everything is computed.
#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <tuple>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/study/study.hpp>

#include "../core/constants.hpp"
#include "scheduler.hpp"
#include "tables.hpp"

namespace loopwise::study {
namespace {

/// Moments after the mission, in units of its duration.
constexpr double kAfter[] = {1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0};

/// The role of a unit in the study.
struct Role {
  std::string method;
  std::int64_t workers = 0;
  bool everything = false;  ///< Continues after the mission until nothing is pending.
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

double durations(const Run& run) {
  return figure(run.result->summary, {"mission_time_s"}) / run.mission_end_s;
}

/// Values of the last row at or before a moment of each run, NaN before the first row.
template <class Value>
auto at_time(double durations_of_mission, Value value) {
  return [durations_of_mission, value](const Run& run) {
    const HistoryRow* row = row_at(run.result->history, durations_of_mission * run.mission_end_s);
    return row ? value(*row) : kNan;
  };
}

void check(const BudgetOptions& wanted) {
  if (wanted.everything != "none") static_cast<void>(parse_method(wanted.everything));
  if (wanted.workers.empty()) throw OptionError("--workers names none");
  for (const std::int64_t workers : wanted.workers) {
    if (std::count(wanted.workers.begin(), wanted.workers.end(), workers) > 1) {
      throw OptionError("--workers names " + std::to_string(workers) + " twice");
    }
  }
}

/// The ways of computing that are compared, and their runs.
class Budget {
 public:
  Budget(const Study& study, const BudgetOptions& wanted, std::vector<std::string> methods)
      : study_(study),
        wanted_(wanted),
        methods_(std::move(methods)),
        thin_(study.config().replay.engine.thin) {
    if (thin_ > 1 && !goes_on())
      throw OptionError(
          "--thin thins what is computed after the mission, which --everything none leaves out");
    // The run that computes everything ends after the mission in any case. The computer determines its
    // duration, not its results.
    const std::int64_t configured = study.config().replay.cost.workers;
    const bool has_usual =
        std::find(wanted.workers.begin(), wanted.workers.end(), configured) != wanted.workers.end();
    usual_ = has_usual ? configured : wanted.workers.front();
    for (const std::int64_t workers : wanted.workers) {
      for (const std::string& method : methods_) roles_.push_back({method, workers, false});
    }
    everything_ = {wanted.everything, usual_, true};
    if (goes_on()) roles_.push_back(everything_);
  }

  [[nodiscard]] std::vector<StudyUnit> units() {
    std::vector<StudyUnit> units;
    for (std::size_t m = 0; m < study_.missions().size(); ++m) {
      for (const std::uint64_t seed : study_.seeds()) {
        for (const Role& role : roles_) {
          StudyUnit unit{m, label(role), study_.config()};
          unit.config.replay.prioritization.method = parse_method(role.method);
          unit.config.replay.cost.workers = role.workers;
          unit.config.replay.engine.seed = seed;
          unit.config.replay.after_mission = role.everything;
          unit.config.replay.engine.thin = role.everything ? thin_ : 1;
          units.push_back(unit);
          role_of_.push_back(role);
        }
      }
    }
    return units;
  }

  /// The results of units(). `results` must outlive this object.
  [[nodiscard]] StudyReport report(const std::vector<StudyUnit>& units,
                                   const std::vector<UnitResult>& results) {
    for (std::size_t i = 0; i < units.size(); ++i) {
      runs_[role_of_[i]].push_back(
          {units[i].mission, figure(results[i].summary, {"mission_end_s"}), &results[i]});
    }
    begin();
    for (const World& world : worlds_of(study_.missions())) add_world(world);
    add_pooled();
    return {json_text(json_, 2) + "\n", text_, curves_csv(units, results)};
  }

 private:
  [[nodiscard]] bool goes_on() const { return wanted_.everything != "none"; }
  [[nodiscard]] std::string curves_csv(const std::vector<StudyUnit>& units,
                                       const std::vector<UnitResult>& results) const;
  void begin();
  void add_world(const World& world);
  void add_end(const World& world, Json& of_world);
  void add_during(const World& world, Json& of_world);
  void add_after(const World& world, Json& of_world);
  void add_pooled();

  const Study& study_;
  const BudgetOptions& wanted_;
  std::vector<std::string> methods_;
  std::int64_t thin_, usual_ = 0;
  std::vector<Role> roles_, role_of_;
  Role everything_;
  std::map<Role, std::vector<Run>> runs_;
  Json json_;
  std::string text_;
};

std::string Budget::curves_csv(const std::vector<StudyUnit>& units,
                               const std::vector<UnitResult>& results) const {
  std::vector<std::string> header = run_columns();
  header.insert(header.end(), {"time_s", "computed", "queued", "verified", "gnc_inliers", "true_inliers",
                               "ate_m", "odometry_ate_m"});
  CsvText csv(header);
  for (std::size_t i = 0; i < units.size(); ++i) {
    for (const HistoryRow& row : results[i].history) {
      std::vector<std::string> cells = run_cells(study_, units[i], results[i]);
      cells.insert(cells.end(), {number_text(row.mission_time_s), std::to_string(row.computed),
                                 std::to_string(row.queued), std::to_string(row.verified),
                                 std::to_string(row.gnc_inliers), std::to_string(row.true_inliers),
                                 number_text(row.ate_m), number_text(row.odometry_ate_m)});
      csv.row(cells);
    }
  }
  return csv.text();
}

void Budget::begin() {
  json_ = study_json(study_);
  json_["workers"] = wanted_.workers;
  json_["methods"] = methods_;
  json_["everything"] = {{"method", wanted_.everything}, {"workers", usual_}, {"thin", thin_}};
  json_["worlds"] = Json::array();
  Config shown = study_.config();
  shown.replay.cost.workers = usual_;
  shown.replay.engine.thin = 1;
  text_ =
      "# Errors against computation\n\n" + budget_text(shown) +
      " Other numbers of workers are named. Medians over missions and seeds, quartiles in brackets; ATE "
      "in m, " +
      frame_text(study_.missions()) +
      ", over the nodes that have arrived; not known before a run's end where the truth stands in another "
      "frame.";
  if (goes_on()) {
    text_ +=
        " *Everything computed*: after the mission's end until no candidate is pending, in the order of " +
        wanted_.everything +
        (thin_ > 1 ? ", one candidate in " + std::to_string(thin_) + " drawn uniformly by pair and seed."
                   : ".");
  }
  text_ += "\n";
}

void Budget::add_world(const World& world) {
  Json of_world = {
      {"world", world.name}, {"missions", world.missions.size()}, {"parameters_sha256", world.parameters}};
  text_ += "\n## " + describe(world) + "\n\nAt the mission's end:\n\n";
  add_end(world, of_world);
  add_during(world, of_world);
  if (goes_on()) add_after(world, of_world);
  json_["worlds"].push_back(of_world);
}

void Budget::add_end(const World& world, Json& of_world) {
  std::vector<std::vector<std::string>> rows{{"", "computed", "ATE"}};
  const std::vector<double> odometry = values(runs_.begin()->second, world.missions, odometry_ate);
  rows.push_back({"odometry", "0", cell(quartiles(odometry), 3)});
  of_world["odometry_ate_m"] = quartiles_json(odometry);
  of_world["at_end"] = Json::array();
  for (const Role& role : roles_) {
    const auto computed = [](const Run& r) { return figure(r.result->summary, {"candidates", "computed"}); };
    const std::vector<double> counts = values(runs_[role], world.missions, computed),
                              errors = values(runs_[role], world.missions, ate),
                              times = values(runs_[role], world.missions, durations);
    const std::string name =
        role.everything ? "everything computed, " + fixed(quartiles(times).median, 1) + " mission durations"
                        : title(role);
    rows.push_back({name, cell(quartiles(counts), 0), cell(quartiles(errors), 3)});
    of_world["at_end"].push_back({{"method", role.method},
                                  {"workers", role.workers},
                                  {"everything", role.everything},
                                  {"durations", quartiles_json(times)},
                                  {"computed", quartiles_json(counts)},
                                  {"ate_m", quartiles_json(errors)}});
  }
  text_ += markdown_table(rows);
}

/// Over time: within the mission every way of computing, after it the run that continues.
void Budget::add_during(const World& world, Json& of_world) {
  std::vector<std::vector<std::string>> rows{{"share of the mission", "odometry"}};
  for (const Role& role : roles_) {
    if (!role.everything) rows.front().push_back(title(role));
  }
  of_world["over_time"] = Json::array();
  for (int tenth = 1; tenth <= 10; ++tenth) {
    const double share = 0.1 * tenth;
    const std::vector<double> alone =
        values(runs_.begin()->second, world.missions,
               at_time(share, [](const HistoryRow& row) { return row.odometry_ate_m; }));
    rows.push_back({std::to_string(10 * tenth) + " %", cell(quartiles(alone), 3)});
    Json entry = {{"share", share}, {"odometry_ate_m", quartiles_json(alone)}, {"runs", Json::array()}};
    for (const Role& role : roles_) {
      if (role.everything) continue;
      const std::vector<double> errors = values(
          runs_[role], world.missions, at_time(share, [](const HistoryRow& row) { return row.ate_m; }));
      rows.back().push_back(cell(quartiles(errors), 3));
      entry["runs"].push_back(
          {{"method", role.method}, {"workers", role.workers}, {"ate_m", quartiles_json(errors)}});
    }
    of_world["over_time"].push_back(entry);
  }
  text_ += "\nDuring the mission, ATE:\n\n" + markdown_table(rows);
}

void Budget::add_after(const World& world, Json& of_world) {
  std::vector<std::vector<std::string>> rows{{"mission durations", "computed", "ATE"}};
  of_world["after_mission"] = Json::array();
  const std::vector<Run>& runs = runs_[everything_];
  const std::vector<double> ends = values(runs, world.missions, durations);
  const double last = ends.empty() ? 0.0 : *std::max_element(ends.begin(), ends.end());
  for (const double factor : kAfter) {
    const std::vector<double> counts =
        values(runs, world.missions,
               at_time(factor, [](const HistoryRow& row) { return static_cast<double>(row.computed); }));
    const std::vector<double> errors =
        values(runs, world.missions, at_time(factor, [](const HistoryRow& row) { return row.ate_m; }));
    rows.push_back({fixed(factor, 2), cell(quartiles(counts), 0), cell(quartiles(errors), 3)});
    of_world["after_mission"].push_back(
        {{"durations", factor}, {"computed", quartiles_json(counts)}, {"ate_m", quartiles_json(errors)}});
    if (factor >= last) break;
  }
  text_ += "\nGoing on after the mission (" + title(everything_) + "):\n\n" + markdown_table(rows);
}

/// All missions together, paired: computers against each other, and within the mission against everything.
void Budget::add_pooled() {
  const std::size_t missions = study_.missions().size();
  std::vector<std::vector<std::string>> rows{
      {"ATE", "against", "lower in", "mean difference, m", "ratio (geometric mean)"}};
  json_["pooled"] = Json::array();
  const auto compare = [&](const Role& a, const Role& b) {
    const PairedComparison c = compare_paired(by_mission(runs_[a], missions), by_mission(runs_[b], missions));
    const auto name = [](const Role& r) {
      return r.everything ? std::string("everything computed") : title(r);
    };
    rows.push_back({name(a), name(b), std::to_string(c.better) + " of " + std::to_string(c.count),
                    cell(c.mean_difference, c.difference, 3), cell(c.ratio, c.ratio_interval, 3)});
    Json entry = comparison_json(c);
    entry["run"] = label(a);
    entry["against"] = label(b);
    json_["pooled"].push_back(entry);
  };
  for (const std::string& method : methods_) {
    for (const std::int64_t workers : wanted_.workers) {
      if (workers != usual_) compare({method, workers, false}, {method, usual_, false});
    }
    if (goes_on()) compare({method, usual_, false}, everything_);
  }
  if (rows.size() > 1)
    text_ += "\n## All " + counted(missions, "mission") + ", paired\n\n" + markdown_table(rows);
}

}  // namespace

std::optional<StudyReport> budget(const StudyOptions& options, const BudgetOptions& wanted,
                                  const StudyHooks& hooks) {
  const std::vector<std::string> methods = canonical_methods(wanted.methods);
  check(wanted);
  Study study("budget", options, hooks);
  Budget ways(study, wanted, methods);
  const std::vector<StudyUnit> units = ways.units();
  const auto results = study.run(units);
  if (!results) return std::nullopt;
  return ways.report(units, *results);
}

}  // namespace loopwise::study
