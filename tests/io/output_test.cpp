// SPDX-License-Identifier: BSD-3-Clause
// Files and folders that programs write: logs, folders for results, tables of an optimisation.
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/graph_tables.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/io/line_log.hpp>
#include <loopwise/io/output_folder.hpp>

#include "testing.hpp"

namespace loopwise::output_test {
namespace {

using testing::read_text;
using testing::TemporaryFolder;
using testing::write_text;
namespace fs = std::filesystem;

PoseGraph two_nodes() {
  PoseGraph graph;
  for (const Key key : {make_key('a', 0), make_key('a', 1)}) {
    Node node;
    node.key = key;
    graph.add_node(node);
  }
  for (const EdgeKind kind : {EdgeKind::kOdometry, EdgeKind::kLoopClosure, EdgeKind::kLandmark}) {
    Edge edge;
    edge.from = make_key('a', 0);
    edge.to = make_key('a', 1);
    edge.kind = kind;
    graph.add_edge(edge);
  }
  return graph;
}

}  // namespace

TEST_CASE("line log: a line is in the file before the next one is written", "[io][log]") {
  const TemporaryFolder folder;
  write_text(folder / "log", "before\n");
  LineLog log(folder / "log");
  REQUIRE(read_text(folder / "log").empty());
  log.add("one");
  REQUIRE(read_text(folder / "log") == "one\n");
  log.add("");
  REQUIRE(read_text(folder / "log") == "one\n\n");
  log.finish();
  LineLog more(folder / "log", LineLog::Mode::kAppend);
  more.add("two");
  more.finish();
  REQUIRE(read_text(folder / "log") == "one\n\ntwo\n");
}

TEST_CASE("line log: failures name the file", "[io][log][error]") {
  const TemporaryFolder folder;
  const std::string absent = (folder / "absent" / "log").string();
  REQUIRE_THROWS_AS(LineLog(absent), IoError);
  REQUIRE_THROWS_WITH(LineLog(absent), absent + ": cannot be written");
  if (!fs::exists("/dev/full")) return;
  LineLog full("/dev/full");
  REQUIRE_THROWS_WITH(full.add("x"), "/dev/full: cannot be written");
}

TEST_CASE("output folder: a folder that was made for no results is removed, others stay", "[io][folder]") {
  const TemporaryFolder folder;
  const fs::path made = folder / "made";
  { const NewFolder unused(made); }
  REQUIRE_FALSE(fs::exists(made));
  {
    NewFolder results(made);
    results.keep();
  }
  REQUIRE(fs::is_directory(made));
  { const NewFolder was_there(made); }  // empty, but made by somebody else
  REQUIRE(fs::is_directory(made));
  write_text(made / "data", "x");
  REQUIRE_THROWS_AS(NewFolder(made), OptionError);
  REQUIRE(read_text(made / "data") == "x");
  const fs::path partial = folder / "partial";
  {
    const NewFolder results(partial);
    write_text(partial / "data", "x");
  }
  REQUIRE(fs::exists(partial / "data"));
}

TEST_CASE("output folder: recordings are not overwritten", "[io][folder]") {
  const TemporaryFolder folder;
  const fs::path mission = folder / "mission", bags = folder / "bags", results = folder / "results";
  for (const fs::path& path : {mission, bags, results}) fs::create_directories(path);
  write_text(mission / "mission.json", "{}");
  write_text(bags / "a.bag", "");
  REQUIRE_NOTHROW(refuse_recording(results, {mission.string(), (bags / "a.bag").string()}));
  REQUIRE_NOTHROW(refuse_recording(folder / "absent", {mission.string()}));
  REQUIRE_THROWS_WITH(refuse_recording(mission, {}), Contains("there is a recording (mission.json)"));
  REQUIRE_THROWS_WITH(refuse_recording(bags, {(bags / "a.bag").string()}), Contains("a.bag lies there"));
  REQUIRE_THROWS_AS(refuse_recording(results, {results.string()}), OptionError);

  write_text(results / "former", "x");
  remove_former(results / "former");
  remove_former(results / "former");
  REQUIRE_FALSE(fs::exists(results / "former"));
  write_text(results / "below", "x");
  REQUIRE_THROWS_AS(remove_former(folder / "results"), IoError);  // a folder with contents
}

TEST_CASE("graph tables: weights and covariances in the order of the graph", "[io][csv]") {
  const PoseGraph graph = two_nodes();
  const CsvTable weights = CsvTable::parse(weights_csv(graph, {1.0, 0.25, 0.0}), "weights",
                                           {"edge", "from", "to", "weight", "kind"});
  REQUIRE(weights.size() == 3);
  const char* kinds[] = {"odometry", "closure", "landmark"};
  for (std::size_t row = 0; row < 3; ++row) {
    REQUIRE(weights.integer(row, 0) == static_cast<std::int64_t>(row));
    REQUIRE(weights.key(row, 1) == make_key('a', 0));
    REQUIRE(weights.key(row, 2) == make_key('a', 1));
    REQUIRE(weights.text(row, 4) == kinds[row]);
  }
  REQUIRE(weights.number(1, 3) == 0.25);
  REQUIRE_THROWS_AS(weights_csv(graph, {1.0}), InputError);

  std::vector<Matrix6d> covariances(2, Matrix6d::Zero());
  covariances[1] = Matrix6d::Random();
  const CsvTable table = CsvTable::parse(
      covariances_csv(graph, covariances), "covariances",
      {"key",  "x_x", "x_y",  "x_z",  "x_rx", "x_ry",  "x_rz",  "y_y",   "y_z",   "y_rx",  "y_ry",
       "y_rz", "z_z", "z_rx", "z_ry", "z_rz", "rx_rx", "rx_ry", "rx_rz", "ry_ry", "ry_rz", "rz_rz"});
  REQUIRE(table.size() == 2);
  std::size_t column = 1;
  for (int r = 0; r < 6; ++r) {
    for (int c = r; c < 6; ++c, ++column) {
      REQUIRE(table.number(0, column) == 0.0);
      REQUIRE(table.number(1, column) == covariances[1](r, c));  // to the bit
    }
  }
  REQUIRE(table.key(1, 0) == make_key('a', 1));
  REQUIRE_THROWS_AS(covariances_csv(graph, {}), InputError);
}

TEST_CASE("json values: numbers, matrices and problems", "[io][json]") {
  REQUIRE(number_or_null(0.5) == 0.5);
  REQUIRE(number_or_null(std::nan("")).is_null());
  REQUIRE(number_or_null(-INFINITY).is_null());
  Eigen::Matrix2d matrix;
  matrix << 1.0, 2.0, 3.0, 4.0;
  REQUIRE(json_text(row_major_json(matrix)) == "[1.0,2.0,3.0,4.0]");
  REQUIRE(json_text(row_major_json(Eigen::Vector3d(1.0, 2.0, 3.0))) == "[1.0,2.0,3.0]");
  Problems problems;
  REQUIRE(json_text(problems_json(problems)) == "[]");
  problems.add("flaw", "file:1", 2);
  REQUIRE(problems_json(problems) == Json{"flaw (2 times, first: file:1)"});
}

}  // namespace loopwise::output_test
