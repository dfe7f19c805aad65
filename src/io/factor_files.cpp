// SPDX-License-Identifier: BSD-3-Clause
// Files of factors that g2o has no line for.
#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>

#include "mission_parts.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

const std::vector<std::string> kRangeColumns = {"from", "to", "range_m", "sigma_m"};
const std::vector<std::string> kGravityColumns = {"key", "x", "y", "z", "sigma_rad"};

/// Calls `add` for every row. Errors of the graph become errors of the row.
template <class Add>
void add_rows(const CsvTable& table, Add&& add) {
  for (std::size_t row = 0; row < table.size(); ++row) {
    try {
      add(row);
    } catch (const ParseError&) {
      throw;
    } catch (const InputError& error) {
      table.fail(row, 0, error.what());
    }
  }
}

}  // namespace

void read_ranges(const fs::path& file, PoseGraph& graph) {
  const CsvTable table(file, kRangeColumns);
  add_rows(table, [&](std::size_t row) {
    graph.add_range({table.key(row, 0), table.key(row, 1), table.number(row, 2), table.number(row, 3)});
  });
}

bool points_up(const PoseGraph& graph, Key key, const Eigen::Vector3d& direction) {
  return (graph.node(key).pose.linear() * direction).z() > 0.0;
}

void read_gravity(const fs::path& file, PoseGraph& graph, Problems& problems) {
  const CsvTable table(file, kGravityColumns);
  add_rows(table, [&](std::size_t row) {
    GravityFactor gravity;
    gravity.key = table.key(row, 0);
    gravity.direction = {table.number(row, 1), table.number(row, 2), table.number(row, 3)};
    gravity.sigma_rad = table.number(row, 4);
    if (graph.contains(gravity.key) && points_up(graph, gravity.key, gravity.direction)) {
      problems.add_altered(kGravityUp, file.string() + ":" + std::to_string(table.line(row)));
    } else {
      graph.add_gravity(gravity);
    }
  });
}

std::string ranges_text(const PoseGraph& graph) {
  CsvText text(kRangeColumns);
  for (const RangeFactor& r : graph.ranges()) text.row(r.from, r.to, r.range_m, r.sigma_m);
  return text.text();
}

std::string gravity_text(const PoseGraph& graph) {
  CsvText text(kGravityColumns);
  for (const GravityFactor& g : graph.gravities()) {
    if (g.reference != -Eigen::Vector3d::UnitZ()) {
      throw InputError("gravity at node " + key_name(g.key) +
                       ": its reference is not -z, which the file format cannot store");
    }
    text.row(g.key, g.direction.x(), g.direction.y(), g.direction.z(), g.sigma_rad);
  }
  return text.text();
}

}  // namespace loopwise::parts
