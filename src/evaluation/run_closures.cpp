// SPDX-License-Identifier: BSD-3-Clause
#include "run_closures.hpp"

#include <algorithm>
#include <array>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>

#include "report_parts.hpp"

namespace loopwise {

std::vector<RunClosure> read_run_closures(const std::filesystem::path& path) {
  const std::vector<std::string> names = csv_header(path);
  const CsvTable table(path, names);
  const auto column = [&](const char* name) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) throw ParseError(path.string(), 1, std::string("no column \"") + name + "\"");
    return static_cast<std::size_t>(found - names.begin());
  };
  const std::size_t from = column("from"), to = column("to"), outcome = column("outcome"),
                    weight = column("weight"), time = column("mission_time_s"), overlap = column("overlap");
  const std::array<std::size_t, 7> pose{column("x"),  column("y"),  column("z"), column("qx"),
                                        column("qy"), column("qz"), column("qw")};
  std::vector<RunClosure> rows;
  rows.reserve(table.size());
  for (std::size_t r = 0; r < table.size(); ++r) {
    RunClosure row;
    row.from = table.key(r, from);
    row.to = table.key(r, to);
    row.verified = table.text(r, outcome) == "verified";
    row.weight = table.number_or_nan(r, weight);
    row.time_s = table.number_or_nan(r, time);
    row.overlap = table.number_or_nan(r, overlap);
    std::array<double, 7> p{};
    for (std::size_t k = 0; k < p.size(); ++k) p[k] = table.number_or_nan(r, pose[k]);
    row.T_from_to.translation() << p[0], p[1], p[2];
    row.T_from_to.linear() = Eigen::Quaterniond(p[6], p[3], p[4], p[5]).toRotationMatrix();
    rows.push_back(row);
  }
  return rows;
}

}  // namespace loopwise
