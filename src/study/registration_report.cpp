// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <numeric>

#include <nlohmann/json.hpp>

#include <loopwise/study/registration.hpp>

#include "tables.hpp"

namespace loopwise::study {
namespace {

Json to_json(const PairSummary& s) {
  return {{"pairs", s.pairs},
          {"overlapping", s.overlapping},
          {"recalled", s.recalled},
          {"recall", number_or_null(s.recall)},
          {"accepted", s.accepted},
          {"wrong", s.wrong},
          {"false_accepts", s.false_accepts},
          {"false_accept_bound_95", number_or_null(s.false_accept_bound)},
          {"error",
           {{"median_m", number_or_null(s.median_m)},
            {"median_rad", number_or_null(s.median_rad)},
            {"max_m", number_or_null(s.largest_m)}}},
          {"normalized_error",
           {{"mean", number_or_null(s.mean_squared_error)},
            {"beyond_5_percent_point", number_or_null(s.beyond_5)},
            {"beyond_95_percent_point", number_or_null(s.beyond_95)},
            {"beyond_999_permille_point", number_or_null(s.beyond_999)},
            {"degenerate", s.degenerate},
            {"degenerate_beyond_95_percent_point", number_or_null(s.degenerate_beyond_95)}}},
          {"milliseconds",
           {{"features", number_or_null(s.features_ms)},
            {"global", number_or_null(s.global_ms)},
            {"refine", number_or_null(s.refine_ms)},
            {"accepted", number_or_null(s.accepted_ms)},
            {"rejected", number_or_null(s.rejected_ms)},
            {"mean", number_or_null(s.mean_ms)}}}};
}

const std::vector<std::string> kColumns{"registrar", "pairs",  "overlapping", "recall %",   "accepted",
                                        "wrong",     "false",  "bound %",     "median m",   "median deg",
                                        "chi2/6",    "> 95 %", "ms accepted", "ms refused", "ms mean"};

std::vector<std::string> row(const std::string& name, const PairSummary& s) {
  return {name,
          std::to_string(s.pairs),
          std::to_string(s.overlapping),
          fixed(100.0 * s.recall, 1),
          std::to_string(s.accepted),
          std::to_string(s.wrong),
          std::to_string(s.false_accepts),
          fixed(100.0 * s.false_accept_bound, 2),
          fixed(s.median_m, 3),
          fixed(57.29577951308232 * s.median_rad, 2),
          fixed(s.mean_squared_error / 6.0, 2),
          fixed(100.0 * s.beyond_95, 1),
          fixed(s.accepted_ms, 2),
          fixed(s.rejected_ms, 2),
          fixed(s.mean_ms, 2)};
}

std::string range(const Stratum& stratum) {
  const int decimals = stratum.property == "distance_m" ? 0 : stratum.property == "overlap" ? 1 : 2;
  const std::string from = fixed(stratum.from, decimals);
  return std::isfinite(stratum.to) ? from + "-" + fixed(stratum.to, decimals) : "from " + from;
}

std::string csv_rows(const std::string& registrar, const std::vector<StudyPair>& pairs,
                     const std::vector<PairOutcome>& outcomes) {
  std::string out;
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const StudyPair& p = pairs[i];
    const PairOutcome& o = outcomes[i];
    const auto cell = [](double value, int decimals) {
      return std::isnan(value) ? "" : fixed(value, decimals);
    };
    out += registrar + "," + std::to_string(p.candidate.from) + "," + std::to_string(p.candidate.to) + "," +
           cell(p.distance_m, 3) + "," + cell(p.overlap, 4) + "," + cell(p.observability, 5) + "," +
           enum_name(o.reason) + "," + cell(o.error_m, 4) + "," + cell(o.error_rad, 5) + "," +
           cell(o.squared_mahalanobis, 3) + "," + cell(o.weak_sigma_m, 4) + "," + cell(o.weak_error, 3) +
           "," + cell(o.features_s, 6) + "," + cell(o.global_s, 6) + "," + cell(o.refine_s, 6) + "\n";
  }
  return out;
}

}  // namespace

RegistrationReport report_registration(const RegistrationStudy& study, const std::string& mission,
                                       int threads, double seconds) {
  RegistrationReport report;
  Json json = {{"mission", mission},
               {"candidates", study.generated},
               {"sampled", study.pairs.size()},
               {"threads", threads},
               {"registrars", Json::object()}};
  std::vector<std::vector<std::string>> rows{kColumns};
  std::string markdown;
  report.csv =
      "registrar,from,to,distance_m,overlap,observability,reason,error_m,error_rad,squared_mahalanobis,"
      "weak_sigma_m,weak_error,features_s,global_s,refine_s\n";
  for (const RegistrarOutcomes& of : study.registrars) {
    const std::string name = enum_name(of.registrar);
    std::vector<std::size_t> all(of.outcomes.size());
    std::iota(all.begin(), all.end(), 0);
    const PairSummary summary = summarize(study.pairs, of.outcomes, all);
    Json entry = to_json(summary);
    entry["rejected"] = of.rejected;
    entry["seconds"] = of.seconds;
    entry["strata"] = Json::array();
    rows.push_back(row(name, summary));
    std::vector<std::vector<std::string>> table_rows{kColumns};
    table_rows.front().front() = name;
    for (const Stratum& stratum : strata(study.pairs, of.outcomes.size())) {
      const PairSummary within = summarize(study.pairs, of.outcomes, stratum.pairs);
      Json cell = to_json(within);
      cell["property"] = stratum.property;
      cell["from"] = stratum.from;
      cell["to"] = number_or_null(stratum.to);
      entry["strata"].push_back(cell);
      table_rows.push_back(row(stratum.property + " " + range(stratum), within));
    }
    report.strata += "\n" + table(table_rows);
    markdown += "\n" + markdown_table(table_rows);
    json["registrars"][name] = entry;
    report.csv += csv_rows(name, study.pairs, of.outcomes);
  }
  json["seconds"] = seconds;
  report.json = json_text(json, 2) + "\n";
  report.summary = table(rows);
  report.markdown = markdown_table(rows) + markdown;
  return report;
}

}  // namespace loopwise::study
