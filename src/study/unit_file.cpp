// SPDX-License-Identifier: BSD-3-Clause
#include "unit_file.hpp"

#include <limits>
#include <utility>

#include <loopwise/core/error.hpp>

namespace loopwise::study {
namespace {

constexpr std::size_t kUnitColumns = 11;

double number_or_nan(const Json& json) {
  return json.is_number() ? json.get<double>() : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

Json unit_file_json(Json mission, Json summary, const std::vector<HistoryRow>& history) {
  Json rows = Json::array();
  for (const HistoryRow& r : history) {
    rows.push_back({r.mission_time_s, r.key_frames, r.generated, r.queued, r.computed, r.verified,
                    r.gnc_inliers, r.true_inliers, r.right_inliers, r.ate_m, r.odometry_ate_m});
  }
  Json unit = Json::object();
  unit["format"] = kUnitFormat;
  unit["mission"] = std::move(mission);
  unit["summary"] = std::move(summary);
  unit["history"] = std::move(rows);
  return unit;
}

UnitResult parse_unit_file(const Json& unit, const std::string& name) {
  const auto fail = [&](const std::string& what) { throw InputError(name + ": " + what); };
  if (!unit.is_object() || unit.value("format", Json()) != kUnitFormat) fail("no unit of this version");
  const Json summary = unit.value("summary", Json()), rows = unit.value("history", Json());
  if (!summary.is_object() || !summary.value("robots", Json()).is_object()) fail("summary is incomplete");
  if (!rows.is_array()) fail("history is missing");
  UnitResult out{summary, {}};
  for (const Json& r : rows) {
    if (!r.is_array() || r.size() != kUnitColumns) fail("a row of history has not its columns");
    const auto count = [&](std::size_t c) {
      if (!r[c].is_number_unsigned()) fail("a count of history is not a natural number");
      return r[c].get<std::size_t>();
    };
    out.history.push_back({number_or_nan(r[0]), count(1), count(2), count(3), count(4), count(5), count(6),
                           count(7), count(8), number_or_nan(r[9]), number_or_nan(r[10])});
  }
  return out;
}

double figure(const Json& summary, const std::vector<std::string>& path) {
  const Json* at = &summary;
  for (const std::string& name : path) {
    if (!at->is_object() || !at->contains(name)) return std::numeric_limits<double>::quiet_NaN();
    at = &(*at)[name];
  }
  return number_or_nan(*at);
}

}  // namespace loopwise::study
