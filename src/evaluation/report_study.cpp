// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

#include "../core/constants.hpp"
#include "report_parts.hpp"

namespace loopwise {

namespace fs = std::filesystem;

Json csv_cell(const std::string& text) {
  if (text.empty() || text == "nan") return nullptr;
  char* end = nullptr;
  const double number = std::strtod(text.c_str(), &end);
  if (end == text.c_str() + text.size() && std::isfinite(number)) return number;
  return text;
}

std::vector<std::string> csv_header(const fs::path& path) {
  std::ifstream in(path);
  std::string line;
  if (!in) throw IoError(path.string(), "cannot be opened");
  if (!std::getline(in, line)) {
    if (in.bad()) throw IoError(path.string(), "cannot be read");
    throw ParseError(path.string(), 1, "no header line");
  }
  std::vector<std::string> columns;
  std::string name;
  for (const char c : line + ",") {
    if (c == ',') {
      try {  // names become keys of an object, where two that differ only in such bytes would be equal
        static_cast<void>(Json(name).dump());
      } catch (const Json::type_error&) {
        throw ParseError(path.string(), 1, "the name of a column is not UTF-8");
      }
      columns.push_back(name);
      name.clear();
    } else if (c != '\r' && c != ' ' && c != '"') {
      name += c;
    }
  }
  return columns;
}

namespace {

/// Columns of the kind of a run: runs that differ only in mission and seed are repetitions.
const std::vector<std::string> kVariant{"world",   "method", "registration_time_s", "refused_time_share",
                                        "workers", "thin",   "after_mission",       "truth_alignment"};

/// Values for columns of kVariant that tables and units of earlier versions lack.
Json former(const std::string& name) {
  if (name == "refused_time_share") return 1.0;
  if (name == "truth_alignment") return "none";
  return nullptr;
}

struct StudyMoment {
  double share = 0.0;  ///< Of the mission's time; beyond 1 after its end.
  double queued = 0.0, verified = 0.0, gnc_inliers = 0.0, true_inliers = 0.0, ate_m = kNan;
};

/// A run of a study over time.
struct StudyCurve {
  Json run = Json::object();  ///< The columns of runs.csv that identify it, as far as known.
  std::vector<StudyMoment> moments;
};

std::vector<StudyCurve> read_curves(const fs::path& path) {
  const std::vector<std::string> names = csv_header(path);
  const CsvTable table(path, names);
  const auto column = [&](const std::string& name) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) throw ParseError(path.string(), 1, "no column \"" + name + "\"");
    return static_cast<std::size_t>(found - names.begin());
  };
  std::vector<std::size_t> about;
  for (const char* name : {"mission", "seed"}) about.push_back(column(name));
  for (const std::string& name : kVariant) {
    if (former(name).is_null() || std::find(names.begin(), names.end(), name) != names.end())
      about.push_back(column(name));
  }
  const std::size_t end = column("mission_end_s"), time = column("time_s");
  // The rows of a run are consecutive, in order of time. Only this distinguishes missions of one name.
  std::vector<std::string> last;
  double last_time_s = 0.0;
  std::vector<StudyCurve> curves;
  for (std::size_t r = 0; r < table.size(); ++r) {
    std::vector<std::string> key;
    key.reserve(about.size());
    for (const std::size_t c : about) key.push_back(table.text(r, c));
    const double time_s = table.number(r, time);
    if (curves.empty() || key != last || time_s <= last_time_s) {
      curves.emplace_back();
      for (std::size_t c = 0; c < names.size() && c < time; ++c)
        curves.back().run[names[c]] = csv_cell(table.text(r, c));
    }
    last = std::move(key);
    last_time_s = time_s;
    const auto number = [&](const char* name) { return table.number_or_nan(r, column(name)); };
    curves.back().moments.push_back({time_s / table.number(r, end), number("queued"), number("verified"),
                                     number("gnc_inliers"), number("true_inliers"), number("ate_m")});
  }
  return curves;
}

/// From the files that a study keeps for each run. Files of another format are skipped.
std::vector<StudyCurve> read_units(const fs::path& folder) {
  std::vector<fs::path> paths;
  if (fs::is_directory(folder)) {
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() == ".json") paths.push_back(entry.path());
    }
  }
  std::sort(paths.begin(), paths.end());
  std::vector<StudyCurve> curves;
  for (const fs::path& path : paths) {
    try {
      const Json unit = parse_json(read_file(path), path.string());
      const Json& summary = unit.at("summary");
      const Json &options = summary.at("options"), &cost = options.at("cost");
      StudyCurve curve;
      curve.run = {{"world", unit.at("mission").at("world")},
                   {"mission", summary.at("mission")},
                   {"method", summary.at("method")},
                   {"seed", summary.at("seed")},
                   {"registration_time_s", cost.at("registration_time_s")},
                   {"refused_time_share", cost.value("refused_time_share", 1.0)},
                   {"workers", cost.at("workers")},
                   {"thin", options.at("engine").value("thin", 1)},
                   {"after_mission", options.at("replay").at("after_mission").get<bool>() ? 1 : 0}};
      if (cost.value("measured_time", false)) curve.run["registration_time_s"] = "measured";
      if (summary.contains("truth") && summary["truth"].is_object())
        curve.run["truth_alignment"] = summary["truth"].value("alignment", Json("none"));
      if (summary.contains("ate_m") && summary["ate_m"].is_object())
        curve.run["ate_m"] = summary["ate_m"].value("optimized", Json());
      const double end_s = summary.at("mission_end_s").get<double>();
      for (const Json& row : unit.at("history")) {  // the columns of history.csv
        const auto number = [&row](std::size_t c) {
          return row.at(c).is_number() ? row[c].get<double>() : kNan;
        };
        curve.moments.push_back({number(0) / end_s, number(3), number(5), number(6), number(7), number(9)});
      }
      curves.push_back(std::move(curve));
    } catch (const Json::exception&) {
    } catch (const InputError&) {
    }
  }
  return curves;
}

/// Medians and quartiles of repetitions over the share of mission time.
Json curves_json(const std::vector<StudyCurve>& curves) {
  constexpr int kSteps = 100;
  constexpr std::array<const char*, 4> kMeasures = {"ate_m", "gnc_share", "true_share", "verified"};
  std::map<std::string, std::vector<const StudyCurve*>> groups;
  std::vector<std::string> order;
  for (const StudyCurve& curve : curves) {
    if (curve.moments.empty() || !std::isfinite(curve.moments.back().share)) continue;
    Json key = Json::array();
    for (const std::string& name : kVariant)
      key.push_back(curve.run.contains(name) ? curve.run[name] : former(name));
    auto& group = groups[key.dump(-1, ' ', true, Json::error_handler_t::replace)];
    if (group.empty()) order.push_back(key.dump(-1, ' ', true, Json::error_handler_t::replace));
    group.push_back(&curve);
  }
  Json list = Json::array();
  for (const std::string& key : order) {
    const auto& group = groups[key];
    double last = 0.0;
    for (const StudyCurve* curve : group) last = std::max(last, curve->moments.back().share);
    Json series = Json::object();
    for (const std::string& name : kVariant) {
      if (group.front()->run.contains(name)) series[name] = group.front()->run[name];
    }
    series["runs"] = group.size();
    std::vector<double> shares;
    std::array<std::array<std::vector<double>, 3>, kMeasures.size()> quarters;
    for (int step = 0; step <= kSteps; ++step) {
      const double share = last * step / kSteps;
      shares.push_back(share);
      std::array<std::vector<double>, kMeasures.size()> values;
      for (const StudyCurve* curve : group) {
        const StudyMoment* now = nullptr;
        for (const StudyMoment& moment : curve->moments) {
          if (moment.share <= share * (1.0 + 1e-9)) now = &moment;
        }
        const bool queued = now != nullptr && now->queued > 0.0;
        values[0].push_back(now != nullptr ? now->ate_m : kNan);
        values[1].push_back(queued ? 100.0 * now->gnc_inliers / now->queued : kNan);
        values[2].push_back(queued ? 100.0 * now->true_inliers / now->queued : kNan);
        values[3].push_back(now != nullptr ? now->verified : kNan);
      }
      for (std::size_t m = 0; m < kMeasures.size(); ++m) {
        const Quartiles q = quartiles(values[m]);
        quarters[m][0].push_back(q.lower);
        quarters[m][1].push_back(q.median);
        quarters[m][2].push_back(q.upper);
      }
    }
    series["share"] = shares;
    for (std::size_t m = 0; m < kMeasures.size(); ++m) {
      series[kMeasures[m]] = {
          {"lower", quarters[m][0]}, {"median", quarters[m][1]}, {"upper", quarters[m][2]}};
    }
    list.push_back(std::move(series));
  }
  return list;
}

/// All rows of a CSV file; `names` become its columns.
Json rows_of(const fs::path& path, std::vector<std::string>& names) {
  names = csv_header(path);
  const CsvTable table(path, names);
  Json rows = Json::array();
  for (std::size_t r = 0; r < table.size(); ++r) {
    Json row = Json::object();
    for (std::size_t c = 0; c < names.size(); ++c) row[names[c]] = csv_cell(table.text(r, c));
    rows.push_back(std::move(row));
  }
  return rows;
}

/// The units that belong to the rows: the same run with the same error, each once. The folder may also have
/// units of other studies or of earlier options.
std::vector<StudyCurve> units_of(const Json& rows, const fs::path& folder) {
  const auto which = [](const Json& row) {
    Json key = Json::array();
    for (const char* name : {"world", "mission", "method", "seed", "refused_time_share", "workers", "thin",
                             "after_mission", "truth_alignment", "ate_m"}) {
      const Json value = row.contains(name) ? row[name] : former(name);
      key.push_back(value.is_number() ? Json(value.get<double>()) : value);
    }
    return key.dump(-1, ' ', true, Json::error_handler_t::replace);
  };
  std::multiset<std::string> wanted;
  for (const Json& row : rows) wanted.insert(which(row));
  std::vector<StudyCurve> curves;
  for (StudyCurve& curve : read_units(folder)) {
    const auto found = wanted.find(which(curve.run));
    if (found == wanted.end()) continue;
    wanted.erase(found);
    curves.push_back(std::move(curve));
  }
  return curves;
}

/// The end of each run.
Json rows_of(const std::vector<StudyCurve>& curves, std::vector<std::string>& names) {
  Json rows = Json::array();
  for (const StudyCurve& curve : curves) {
    Json row = curve.run;
    const StudyMoment& end = curve.moments.back();
    row["queued"] = end.queued;
    row["verified"] = end.verified;
    row["gnc_inliers"] = end.gnc_inliers;
    row["true_inliers"] = end.true_inliers;
    row["ate_m"] = end.ate_m;
    rows.push_back(std::move(row));
  }
  names.clear();
  if (!rows.empty()) {
    for (const auto& [name, value] : rows.front().items()) names.push_back(name);
  }
  return rows;
}

}  // namespace

Json studies_json(const fs::path& folder, const std::string& label) {
  Json studies = Json::array();
  const auto add = [&](const char* kind, const std::vector<std::string>& names, Json rows,
                       const std::vector<StudyCurve>& curves) {
    const fs::path result = folder / (std::string(kind) + ".json");
    studies.push_back({{"kind", kind},
                       {"label", label},
                       {"columns", names},
                       {"rows", std::move(rows)},
                       {"curves", curves_json(curves)},
                       {"result", fs::exists(result) ? read_json_file(result) : Json()}});
  };
  std::vector<std::string> names;
  if (fs::exists(folder / "runs.csv")) {
    Json rows = rows_of(folder / "runs.csv", names);
    const std::vector<StudyCurve> curves = units_of(rows, folder / "units");
    add("ablation", names, std::move(rows), curves);
  }
  if (fs::exists(folder / "curves.csv")) {
    const std::vector<StudyCurve> curves = read_curves(folder / "curves.csv");
    add("budget", names, rows_of(curves, names), curves);
  }
  if (fs::exists(folder / "robots.csv")) {
    add("rssi", names, rows_of(folder / "robots.csv", names), {});
  }
  if (studies.size() > 1) {
    for (Json& study : studies) study["label"] = label + ", " + study["kind"].get<std::string>();
  }
  return studies;
}

}  // namespace loopwise
