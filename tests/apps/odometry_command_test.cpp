// SPDX-License-Identifier: BSD-3-Clause
// Commands with odometry from other writers, and with trajectories whose stamps are unsorted.
#include <algorithm>
#include <array>

#include <nlohmann/json.hpp>

#include <loopwise/core/random.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>

#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::odometry_command_test {
namespace {

using testing::json_of;
using testing::ProgramRun;
using testing::run_program;
using testing::TemporaryFolder;

/// A circle with noisy odometry, closed at its end, and the same with a false edge between two neighbours.
struct Circle {
  PoseGraph truth, graph;
};

Circle circle(bool backwards) {
  constexpr Key kNodes = 24;
  Rng rng(5);
  Circle out;
  const Vector6d sigma =
      (Vector6d() << Eigen::Vector3d::Constant(0.02), Eigen::Vector3d::Constant(0.004)).finished();
  const auto noise = [&] {
    return se3::exp(
        Vector6d(Vector6d::NullaryExpr([&](Eigen::Index i) { return rng.normal(0.0, sigma[i]); })));
  };
  Vector6d step = Vector6d::Zero();
  step[0] = 2.0;
  step[5] = 6.283185307179586 / static_cast<double>(kNodes);
  Node node, drifted;
  const auto add = [&](Key from, Key to, const Eigen::Isometry3d& T) {
    const Edge edge{from, to, T, sigma.cwiseAbs2().cwiseInverse().asDiagonal()};
    out.graph.add_edge(backwards ? reversed(edge) : edge);
  };
  for (Key i = 0; i < kNodes; ++i) {
    node.key = drifted.key = 3 * i;
    out.truth.add_node(node);
    out.graph.add_node(drifted);
    const Eigen::Isometry3d T = se3::exp(step) * noise();
    if (i > 0) add(3 * (i - 1), 3 * i, out.graph.node(3 * (i - 1)).pose.inverse() * drifted.pose);
    drifted.pose = se3::normalized(drifted.pose * T);
    node.pose = se3::normalized(node.pose * se3::exp(step));
  }
  const auto measure = [&](Key from, Key to) {
    add(from, to, out.truth.node(from).pose.inverse() * out.truth.node(to).pose * noise());
  };
  measure(0, 3 * (kNodes - 1));
  measure(0, 3 * (kNodes - 2));
  Eigen::Isometry3d wrong = se3::exp(2.0 * step);
  wrong.translation().y() += 1.0;
  add(30, 33, wrong);
  return out;
}

}  // namespace

TEST_CASE("optimize: a false edge between neighbours is reported, and --gnc may reject it",
          "[apps][odometry]") {
  const TemporaryFolder folder;
  const Circle made = circle(GENERATE(false, true));
  const std::string in = (folder / "in.g2o").string(), out = (folder / "out.g2o").string(),
                    truth = (folder / "truth.g2o").string(), weights = (folder / "w.csv").string();
  write_g2o(in, made.graph);
  write_g2o(truth, made.truth);
  const ProgramRun run = run_program({"optimize", in, "-o", out, "--gnc", "--weights", weights});
  REQUIRE(run.status == 0);
  REQUIRE_THAT(run.err, Contains("contradicts the odometry"));
  REQUIRE_THAT(run.err, !Contains("chain"));
  const CsvTable table(weights, {"edge", "from", "to", "weight", "kind"});
  REQUIRE(table.size() == 26);
  REQUIRE(table.text(0, 4) == "odometry");
  REQUIRE(table.text(25, 4) == "closure");
  for (std::size_t e = 0; e < table.size(); ++e) REQUIRE(table.number(e, 3) == (e == 25 ? 0.0 : 1.0));
  const Json errors = json_of({"evaluate", out, truth, "--alignment", "se3"});
  REQUIRE(errors.at("ate_m").at("rmse").get<double>() < 0.1);
}

TEST_CASE("optimize, rank, replay: --odometry lists the edges that are odometry", "[apps][odometry]") {
  const TemporaryFolder folder;
  const std::string recording = (folder / "m").string(), pairs = (folder / "pairs.txt").string();
  write_mission(recording, testing::small_mission(4));
  testing::write_text(folder / "pairs.txt", "a0 a1\na2 a1\nb0 b1\nb1 b2\nb2 b3\n");
  const auto complains = [](const std::vector<std::string>& arguments) {
    const ProgramRun run = run_program(arguments);
    INFO(run.err);
    REQUIRE(run.status == 0);
    return run.err.find("odometry chain broken (robot a, between nodes a2 and a3)") != std::string::npos;
  };
  REQUIRE(complains({"optimize", recording, "--odometry", pairs}));
  REQUIRE_FALSE(complains({"optimize", recording}));
  REQUIRE(complains({"rank", recording, "--odometry", pairs}));
  REQUIRE_FALSE(complains({"rank", recording, "--odometry", "consecutive"}));
  const std::string out = (folder / "out").string();
  REQUIRE(complains({"replay", recording, "-o", out, "--method", "odom", "--odometry", pairs}));
  REQUIRE(read_g2o(folder / "out" / "graph.g2o").graph.edges().size() == 5);
  REQUIRE(run_program({"replay", recording, "-o", out, "--method", "odom", "--overwrite"}).status == 0);
  REQUIRE_FALSE(std::filesystem::exists(folder / "out" / "odometry.csv"));

  // An edge that skips a node: the run's folder stores the list, without which the edge would count as a
  // closure.
  Mission skipping = testing::small_mission(4);
  const Edge step = skipping.graph.edges().front();
  skipping.graph.add_edge({step.from, step.from + 2, step.T_from_to * step.T_from_to, step.information});
  const std::string other = (folder / "skipping").string();
  write_mission(other, skipping);
  testing::write_text(folder / "pairs.txt", "a0 a1\na1 a2\na2 a3\na0 a2\nb0 b1\nb1 b2\nb2 b3\n");
  const auto closures = [&] {
    const Json json = json_of({"optimize", out, "--gnc"});
    return json.at("gnc").at("inliers").get<int>() + json.at("gnc").at("outliers").get<int>();
  };
  REQUIRE(run_program({"replay", other, "-o", out, "--method", "odom", "--overwrite", "--odometry", pairs})
              .status == 0);
  REQUIRE(read_g2o(folder / "out" / "graph.g2o").graph.edges().size() == 7);
  REQUIRE(closures() == 0);
  std::filesystem::remove(folder / "out" / "odometry.csv");
  REQUIRE(closures() == 1);

  testing::write_text(folder / "pairs.txt", "a0 a3\n");
  for (const std::string command : {"optimize", "rank"}) {
    const ProgramRun run = run_program({command, recording, "--odometry", pairs});
    REQUIRE(run.status == 3);
    REQUIRE_THAT(run.err, Contains("pairs.txt: the graph has no edge between a0 and a3"));
  }
}

TEST_CASE("evaluate: TUM files in any order have the same errors, and few pairs are reported",
          "[apps][evaluate]") {
  const TemporaryFolder folder;
  const Circle made = circle(false);
  std::vector<StampedPose> truth, estimate;
  for (std::size_t i = 0; i < made.truth.nodes().size(); ++i) {
    const auto stamp = static_cast<std::int64_t>(1500000000000000000 + 100000000 * i);
    truth.push_back({stamp, made.truth.nodes()[i].pose});
    estimate.push_back({stamp, made.graph.nodes()[i].pose});
  }
  const auto file = [&](const std::string& name) { return (folder / name).string(); };
  write_tum(file("truth.tum"), truth);
  write_tum(file("sorted.tum"), estimate);
  std::vector<StampedPose> shuffled = estimate;
  std::rotate(shuffled.begin(), shuffled.begin() + 10, shuffled.end());
  std::swap(shuffled[3], shuffled[17]);
  write_tum(file("shuffled.tum"), shuffled);
  const Json expected = json_of({"evaluate", file("sorted.tum"), file("truth.tum")});
  REQUIRE(json_of({"evaluate", file("shuffled.tum"), file("truth.tum")}) == expected);
  REQUIRE(expected.at("robots").at("0").at("path_length_m").get<double>() == Approx(46.0).epsilon(0.01));
  REQUIRE_THAT(run_program({"evaluate", file("shuffled.tum"), file("truth.tum")}).err,
               Contains("pose with a stamp before the preceding one, sorted"));

  for (std::size_t i = 6; i < estimate.size(); ++i) estimate[i].stamp_ns += 50000000;
  write_tum(file("few.tum"), estimate);
  const ProgramRun run = run_program({"evaluate", file("few.tum"), file("truth.tum")});
  REQUIRE_THAT(run.out, Contains("18 of 24 poses of the estimate have no match in the truth"));
  const Json json = json_of({"evaluate", file("few.tum"), file("truth.tum")});
  REQUIRE(json.at("unpaired").at("estimate") == 18);
  REQUIRE(json.at("unpaired").at("truth") == 18);
}

TEST_CASE("commands: odometry and trajectories of other writers", "[apps][odometry][data]") {
  const auto cases = testing::test_data("../cases");
  if (!cases) return;
  const TemporaryFolder folder;
  const std::string out = (folder / "out.g2o").string();
  const auto file = [&](const std::string& name) { return (*cases / name).string(); };
  REQUIRE(run_program({"optimize", file("graphs/bad.g2o"), "-o", out, "--gnc"}).status == 0);
  REQUIRE(json_of({"evaluate", out, file("graphs/truth.g2o"), "--alignment", "se3"})
              .at("ate_m")
              .at("rmse")
              .get<double>() == Approx(0.039).margin(0.001));
  const Json json = json_of({"evaluate", file("trajectories/shuffled.tum"), file("trajectories/truth.tum")});
  const Json& robot = json.at("robots").at("0");
  REQUIRE(robot.at("path_length_m").get<double>() == Approx(53.3).margin(0.05));
  REQUIRE(robot.at("translation_percent").get<double>() == Approx(1.23).margin(0.005));
  REQUIRE(json.at("rpe").at("translation_m").at("mean").get<double>() == Approx(0.213).margin(0.001));
  for (const std::string name : {"odometry_reversed", "odometry_id_gaps"}) {
    CAPTURE(name);
    const std::string run = (folder / name).string();
    REQUIRE(run_program({"replay", file(name), "-o", run, "--max-registrations", "20", "--method", "obs"})
                .status == 0);
    REQUIRE(read_g2o(folder / name / "graph.g2o").graph.edges().size() == 43);
  }
}

TEST_CASE("optimize: a 2D graph is optimised and written in two dimensions", "[apps][planar]") {
  const TemporaryFolder folder;
  // A square of 10 m a side, driven twice with odometry that turns too far, with a true and a false closure.
  std::string vertices, edges, truth;
  double x = 0.0, y = 0.0, drifted = 0.0;
  for (int i = 0; i < 40; ++i) {
    const int side = i / 5 % 4;
    truth += "VERTEX_SE2 " + std::to_string(i) + " " + std::to_string(x) + " " + std::to_string(y) + " " +
             std::to_string(1.5707963 * side) + "\n";
    vertices += "VERTEX_SE2 " + std::to_string(i) + " 0 0 0\n";
    x += std::array<double, 4>{2, 0, -2, 0}[static_cast<std::size_t>(side)];
    y += std::array<double, 4>{0, 2, 0, -2}[static_cast<std::size_t>(side)];
    drifted = i % 5 == 4 ? 1.5717963 : 0.001;
    if (i < 39) {
      edges += "EDGE_SE2 " + std::to_string(i) + " " + std::to_string(i + 1) + " 2 0 " +
               std::to_string(drifted) + " 2500 0 0 2500 0 1e5\n";
    }
    if (i >= 20)
      edges +=
          "EDGE_SE2 " + std::to_string(i) + " " + std::to_string(i - 20) + " 0 0 0 2500 0 0 2500 0 1e5\n";
  }
  edges += "EDGE_SE2 35 3 1 1 1 2500 0 0 2500 0 1e5\n";
  const std::string in = (folder / "in.g2o").string(), out = (folder / "out.g2o").string(),
                    of_truth = (folder / "truth.g2o").string(), marginals = (folder / "m.csv").string();
  testing::write_text(in, vertices + edges);
  testing::write_text(of_truth, truth);
  const Json json = json_of({"optimize", in, "-o", out, "--gnc", "--marginals", marginals});
  REQUIRE(json.at("planar") == true);
  REQUIRE(json.at("converged") == true);
  REQUIRE(json.at("gnc").at("inliers") == 20);
  REQUIRE(json.at("gnc").at("outliers") == 1);
  REQUIRE(read_g2o(out).graph.planar());
  // x and y are known to some extent; z, roll and pitch exactly.
  const std::string table = testing::read_text(marginals);
  std::istringstream row(table.substr(table.rfind("\n39,") + 1));
  std::vector<std::string> columns;
  for (std::string column; std::getline(row, column, ',');) columns.push_back(column);
  REQUIRE(columns.size() == 22);
  for (const std::size_t axis : {3u, 12u, 13u, 16u, 19u}) REQUIRE(columns[axis] == "0");
  REQUIRE(std::stod(columns[1]) > 0.0);
  const Json errors = json_of({"evaluate", out, of_truth});
  REQUIRE(errors.at("ate_m").at("rmse") < 0.1);
  const Json info = json_of({"info", in});
  REQUIRE(info.at("planar") == true);
  REQUIRE(info.at("odometry_edges") == 39);
  const std::vector<std::vector<std::string>> refused = {{"rank", in},
                                                         {"replay", in, "-o", (folder / "run").string()}};
  for (const std::vector<std::string>& command : refused) {
    const ProgramRun run = run_program(command);
    REQUIRE(run.status == 3);
    REQUIRE_THAT(run.err, Contains("in.g2o: has a 2D graph"));
  }
}

}  // namespace loopwise::odometry_command_test
