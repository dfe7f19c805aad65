// SPDX-License-Identifier: BSD-3-Clause
// The file that a study keeps of a unit.
#include <cmath>

#include "target.hpp"
#include "unit_file.hpp"

LOOPWISE_FUZZ_TARGET(study_unit, bytes) {
  using namespace loopwise;
  const auto unit = fuzz::attempt([&] { return study::parse_unit_file(parse_json(bytes, "unit"), "unit"); });
  if (!unit) return;
  static_cast<void>(study::figure(unit->summary, {"mission_end_s"}));
  for (const auto& [robot, of_robot] : unit->summary.at("robots").items()) {
    static_cast<void>(study::figure(of_robot, {"path_length_m"}));
  }
  const std::string text = json_text(study::unit_file_json(Json::object(), unit->summary, unit->history));
  const study::UnitResult again = study::parse_unit_file(parse_json(text, "again"), "again");
  fuzz::expect(again.history.size() == unit->history.size(), "written and read again: as many rows");
  for (std::size_t r = 0; r < again.history.size(); ++r) {
    const HistoryRow &a = again.history[r], &b = unit->history[r];
    fuzz::expect(a.computed == b.computed && a.right_inliers == b.right_inliers &&
                     (a.ate_m == b.ate_m || (std::isnan(a.ate_m) && std::isnan(b.ate_m))),
                 "written and read again: the same rows");
  }
}
