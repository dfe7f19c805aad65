// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/g2o.hpp>

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "g2o_text.hpp"
#include "testing.hpp"

namespace loopwise::g2o_test {
namespace {

using testing::TemporaryFolder;

const std::string kUnitInformation = " 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
const std::string kTwoVertices = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n";
const std::string kEdge = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1" + kUnitInformation + "\n";

G2oFile read(const std::string& text) {
  const TemporaryFolder folder;
  testing::write_text(folder / "run.g2o", text);
  return read_g2o(folder / "run.g2o");
}

Matrix6d random_information(Rng& rng) {
  Matrix6d A;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) A(i, j) = rng.normal();
  }
  Vector6d scale;
  scale << 100, 100, 100, 1000, 1000, 1000;
  const Matrix6d information = scale.asDiagonal() * (A * A.transpose()) * scale.asDiagonal();
  return 0.5 * (information + information.transpose());
}

TEST_CASE("g2o: a written graph is read back unchanged", "[io][g2o]") {
  const unsigned seed = GENERATE(range(1u, 11u));
  CAPTURE(seed);
  Rng rng(seed);
  PoseGraph graph;
  const Key largest = ~Key{0};
  std::vector<Key> keys = {
      0, 7, make_key('a', 0), make_key('a', 1), make_key('z', 5), (Key{1} << 63) + 3, largest};
  for (const Key key : keys) {
    Node node;
    node.key = key;
    node.pose = testing::random_pose(rng, 1000.0, M_PI);
    graph.add_node(node);
  }
  for (int i = 0; i < 30; ++i) {
    const Key from = keys[rng.below(keys.size())], to = keys[rng.below(keys.size())];
    if (from != to)
      graph.add_edge({from, to, testing::random_pose(rng, 10.0, M_PI), random_information(rng)});
  }
  for (int i = 0; i < 3; ++i) {
    graph.add_prior({keys[rng.below(keys.size())], testing::random_pose(rng, 10.0), random_information(rng)});
  }
  const TemporaryFolder folder;
  write_g2o(folder / "out.g2o", graph);
  const G2oFile back = read_g2o(folder / "out.g2o");

  CHECK(back.problems.empty());
  REQUIRE(back.graph.keys() == keys);
  REQUIRE(back.graph.edges().size() == graph.edges().size());
  REQUIRE(back.graph.priors().size() == graph.priors().size());
  for (std::size_t i = 0; i < keys.size(); ++i) {
    // Rotations: measured up to 8e-16, from matrix to quaternion and back. Translations are exact.
    CHECK(testing::difference(back.graph.nodes()[i].pose, graph.nodes()[i].pose) < 1e-14);
    CHECK(back.graph.nodes()[i].pose.translation() == graph.nodes()[i].pose.translation());
  }
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge &a = graph.edges()[e], &b = back.graph.edges()[e];
    CHECK((a.from == b.from && a.to == b.to));
    CHECK(testing::difference(a.T_from_to, b.T_from_to) < 1e-14);
    CHECK(a.information == b.information);
  }
  for (std::size_t p = 0; p < graph.priors().size(); ++p) {
    CHECK(back.graph.priors()[p].key == graph.priors()[p].key);
    CHECK(testing::difference(back.graph.priors()[p].pose, graph.priors()[p].pose) < 1e-14);
    CHECK(back.graph.priors()[p].information == graph.priors()[p].information);
  }
}

TEST_CASE("g2o: blanks, comments, CRLF, signs and exponents do no harm", "[io][g2o]") {
  const G2oFile file = read(
      "\xef\xbb\xbf# a comment\r\n\r\n  VERTEX_SE3:QUAT\t18446744073709551615 +1.5e0 -2E+1 1e-400 0 0 0 1.0  "
      "\t\r\n"
      "VERTEX_SE3:QUAT 9223372036854775809 1 2 3 0 0 0 -1 # the same rotation\r\n" +
      std::string("EDGE_SE3:QUAT 18446744073709551615 9223372036854775809 1 0 0 0 0 0 1") + kUnitInformation +
      "\r\n");
  CHECK(file.problems.empty());
  REQUIRE(file.graph.nodes().size() == 2);
  CHECK(file.graph.nodes()[0].key == ~Key{0});
  CHECK(file.graph.nodes()[0].pose.translation() == Eigen::Vector3d(1.5, -20.0, 0.0));
  CHECK(file.graph.nodes()[1].key == (Key{1} << 63) + 1);
  CHECK(file.graph.nodes()[1].pose.linear().isIdentity(0.0));
  CHECK(file.graph.edges().size() == 1);
}

TEST_CASE("g2o: information is the upper triangle by rows, translation first", "[io][g2o]") {
  std::string line = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1";
  Matrix6d expected = 100.0 * Matrix6d::Identity();
  int value = 1;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      expected(i, j) = expected(j, i) = value + (i == j ? 100 : 0);
      line += " " + std::to_string(value++ + (i == j ? 100 : 0));
    }
  }
  CHECK(read(kTwoVertices + line + "\n").graph.edges().at(0).information == expected);
}

TEST_CASE("g2o: edges may come before their vertices", "[io][g2o]") {
  CHECK(read(kEdge + kTwoVertices).graph.edges().size() == 1);
}

TEST_CASE("g2o: edges between neighbours of one character are odometry", "[io][g2o]") {
  std::string text;
  for (const Key key : {make_key('a', 0), make_key('a', 1), make_key('a', 2), make_key('b', 3)}) {
    text += "VERTEX_SE3:QUAT " + std::to_string(key) + " 0 0 0 0 0 0 1\n";
  }
  const auto edge = [](Key from, Key to) {
    return "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " 1 0 0 0 0 0 1" +
           kUnitInformation + "\n";
  };
  text += edge(make_key('a', 0), make_key('a', 1)) + edge(make_key('a', 2), make_key('a', 0)) +
          edge(make_key('a', 2), make_key('b', 3));
  const PoseGraph graph = read(text).graph;
  CHECK(graph.edges()[0].kind == EdgeKind::kOdometry);
  CHECK(graph.edges()[1].kind == EdgeKind::kLoopClosure);
  CHECK(graph.edges()[2].kind == EdgeKind::kLoopClosure);
}

TEST_CASE("g2o: FIX becomes a tight prior at the pose of the vertex", "[io][g2o]") {
  const PoseGraph graph = read("FIX 1 0\n" + kTwoVertices).graph;
  REQUIRE(graph.priors().size() == 2);
  CHECK(graph.priors()[0].key == 1);
  CHECK(graph.priors()[0].pose.translation().x() == 1.0);
  CHECK(graph.priors()[1].key == 0);
  CHECK(graph.priors()[0].information.diagonal().isConstant(1e8, 1e-6));
}

TEST_CASE("g2o: the offset of a prior's sensor is folded in without changing the cost", "[io][g2o]") {
  const unsigned seed = GENERATE(range(1u, 6u));
  CAPTURE(seed);
  Rng rng(seed);
  const Eigen::Isometry3d T = testing::random_pose(rng), O = testing::random_pose(rng),
                          Z = testing::random_pose(rng);
  const Matrix6d information = random_information(rng);
  PoseGraph own;  // only to print the numbers
  Node node;
  node.pose = T;
  own.add_node(node);
  own.add_prior({0, Z, information});
  const TemporaryFolder folder;
  write_g2o(folder / "a.g2o", own);
  std::string text = testing::read_text(folder / "a.g2o");
  const std::string identity = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n";
  REQUIRE(text.find(identity) != std::string::npos);
  const Eigen::Quaterniond q(O.linear());
  std::ostringstream offset;
  offset.precision(17);
  offset << "PARAMS_SE3OFFSET 0 " << O.translation().transpose() << " " << q.x() << " " << q.y() << " "
         << q.z() << " " << q.w() << "\n";
  text.replace(text.find(identity), identity.size(), offset.str());

  const PriorFactor prior = read(text).graph.priors().at(0);
  const Vector6d expected = se3::log(Z.inverse() * T * O), r = se3::log(prior.pose.inverse() * T);
  // Measured: relative difference up to 2e-15; without the adjoint it is of order 1.
  CHECK(r.dot(prior.information * r) == Approx(expected.dot(information * expected)).epsilon(1e-12));
}

TEST_CASE("g2o: a prior of low rank stays usable after the offset of its sensor is applied", "[io][g2o]") {
  const double angle = 0.3 + 0.2 * GENERATE(range(0, 12));
  const bool towards_axis = GENERATE(true, false);
  CAPTURE(angle, towards_axis);
  const double c = std::cos(angle), s = towards_axis ? std::sin(angle) : -std::sin(angle);
  std::ostringstream text;
  text.precision(17);
  text << kTwoVertices << "PARAMS_SE3OFFSET 0 0 0 0 0 0 " << std::sin(angle / 2) << " " << std::cos(angle / 2)
       << "\nEDGE_SE3_PRIOR 0 0 0 0 0 0 0 0 1 " << 100 * c * c << " " << 100 * c * s << " 0 0 0 0 "
       << 100 * s * s;
  for (int i = 0; i < 14; ++i) text << " 0";
  const G2oFile file = read(text.str() + "\n");
  REQUIRE(file.graph.priors().size() == 1);
  CHECK(file.problems.empty());
  CHECK(file.graph.priors()[0].information.trace() == Approx(100.0));
}

TEST_CASE("g2o: small flaws are repaired and counted", "[io][g2o]") {
  const G2oFile file =
      read(kTwoVertices + kEdge + kEdge +
           "VERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\n"
           "VERTEX_TRACKXYZ 5 1 2 3\nVERTEX_TRACKXYZ 6 1 2 3\n"
           "VERTEX_SE3:QUAT 2 0 0 0 0 0 0 2\nEDGE_SE3:QUAT 1 1 0 0 0 0 0 0 1" +
           kUnitInformation +
           "\nEDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 1 1.000001 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1");
  CHECK(file.problems.count("repeated vertex") == 1);
  CHECK(file.problems.count("repeated edge") == 1);
  CHECK(file.problems.count("unknown tag VERTEX_TRACKXYZ") == 2);
  CHECK(file.problems.count("non-unit quaternion") == 1);
  CHECK(file.problems.count("rounded information") == 1);
  CHECK(file.problems.count("no line end after the last line") == 1);
  CHECK(file.problems.count("edge from a vertex to itself left out") == 1);
  CHECK(file.problems.all().size() == 7);
  REQUIRE(file.graph.edges().size() == 3);  // the repeated edge is kept
  CHECK(file.graph.nodes()[2].pose.linear().isIdentity(0.0));
  CHECK(check_information(file.graph.edges()[2].information) == nullptr);
  CHECK((file.graph.edges()[2].information - Matrix6d::Identity()).cwiseAbs().maxCoeff() < 1.00001);
  for (const Problem& problem : file.problems.all()) CHECK_THAT(problem.example, Contains("run.g2o:"));
}

TEST_CASE("g2o: edges without information get that of their kind", "[io][g2o]") {
  const std::string third = "VERTEX_SE3:QUAT 2 2 0 0 0 0 0 1\n";
  const G2oFile file = read(kTwoVertices + third + "EDGE_SE3:QUAT 0 1 4 0 0 0 0 0 1\n" + kEdge +
                            "EDGE_SE3:QUAT 2 0 1 0 0 0 0 0 1 # a closure\n");
  CHECK(file.without_information == std::vector<std::size_t>{0, 2});
  CHECK(file.problems.count("edge without information") == 2);
  CHECK(file.problems.all().size() == 1);
  CHECK(file.problems.all()[0].altered);
  CHECK(file.problems.all()[0].example.find("run.g2o:4") != std::string::npos);
  CHECK(file.graph.edges()[0].information(0, 0) == Approx(1.0 / (0.08 * 0.08)));  // 0.02 m/m over 4 m
  CHECK(file.graph.edges()[0].information(3, 3) == Approx(1.0 / (0.008 * 0.008)));
  CHECK(file.graph.edges()[1].information == Matrix6d::Identity());
  CHECK(file.graph.edges()[2].information(0, 0) == Approx(100.0));
  CHECK(file.graph.edges()[2].information(3, 3) == Approx(2500.0));
}

TEST_CASE("g2o: the longest odometry without information gets information, too", "[io][g2o]") {
  const std::string spatial = kTwoVertices + "EDGE_SE3:QUAT 0 1 1e308 1e308 0 0 0 0 1\n";
  const std::string planar = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1e308 1e308 0\n";
  const PoseGraph graph = read(GENERATE_COPY(as<std::string>(), spatial, planar)).graph;
  REQUIRE(graph.edges().size() == 1);
  CHECK(graph.edges()[0].information.diagonal().minCoeff() > 0.0);
  CHECK(parse_g2o(g2o_text(graph, {}), "again").graph.edges().size() == 1);
}

TEST_CASE("g2o: edges and priors of ignored vertices are left out with them", "[io][g2o]") {
  const std::string text = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nFIX 60 0\n" + kTwoVertices +
                           "VERTEX_PLANE 60 0 0 1 0.5 0.2 0.2 0.2\n" + "VERTEX_TRACKXYZ 61 1 2 3\nFIX 61\n" +
                           "EDGE_SE3_PLANE 0 60 0 0 1 0.6 10 0 0 10 0 10\n" +
                           "EDGE_SE3:QUAT 0 61 1 0 0 0 0 0 1" + kUnitInformation +
                           "\nEDGE_SE3:QUAT 60 0 1 0 0 0 0 0 1\n" + "EDGE_SE3_PRIOR 60 0 0 0 0 0 0 0 1" +
                           kUnitInformation + "\n" + kEdge;
  const G2oFile file = read(text);
  CHECK(file.graph.nodes().size() == 2);
  CHECK(file.graph.edges().size() == 1);
  REQUIRE(file.graph.priors().size() == 1);
  CHECK(file.graph.priors()[0].key == 0);
  CHECK(file.problems.count("unknown tag VERTEX_PLANE") == 1);
  CHECK(file.problems.count("unknown tag VERTEX_TRACKXYZ") == 1);
  CHECK(file.problems.count("unknown tag EDGE_SE3_PLANE") == 1);
  CHECK(file.problems.count("FIX of VERTEX_PLANE left out") == 1);
  CHECK(file.problems.count("FIX of VERTEX_TRACKXYZ left out") == 1);
  CHECK(file.problems.count("EDGE_SE3:QUAT of VERTEX_PLANE left out") == 1);
  CHECK(file.problems.count("EDGE_SE3:QUAT of VERTEX_TRACKXYZ left out") == 1);
  CHECK(file.problems.count("EDGE_SE3_PRIOR of VERTEX_PLANE left out") == 1);
  CHECK(file.problems.all().size() == 8);
  for (const Problem& problem : file.problems.all()) CHECK(problem.altered);
}

std::string upper_triangle(const Matrix6d& information) {
  std::ostringstream out;
  out.precision(17);
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) out << " " << information(i, j);
  }
  return out.str() + "\n";
}

TEST_CASE("g2o: indefinite information becomes the nearest that is semi-definite", "[io][g2o][property]") {
  const unsigned seed = GENERATE(range(1u, 21u));
  CAPTURE(seed);
  Rng rng(seed);
  // A small diagonal beside elements of 1e5, and anything else.
  Matrix6d given;
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j)
      given(i, j) = given(j, i) = seed % 2 == 0       ? 1e5 * rng.normal()
                                  : i == j            ? 10.0
                                  : rng.below(3) == 0 ? 1e5
                                                      : 0.0;
  }
  if (seed == 1) given = -Matrix6d::Identity() + 2.0 * Matrix6d(Vector6d::Unit(0).asDiagonal());
  if (check_information(given) == nullptr) return;
  const G2oFile file = read(kTwoVertices + "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1" + upper_triangle(given) + kEdge);
  CHECK(file.problems.count("indefinite information") == 1);
  CHECK(file.problems.all()[0].altered);
  CHECK_THAT(file.problems.all()[0].example, Contains("run.g2o:3"));
  REQUIRE(file.graph.edges().size() == 2);
  const Matrix6d made = file.graph.edges()[0].information;
  CHECK(check_information(made) == nullptr);
  // The nearest matrix differs by the negative part, which lies across it.
  const Matrix6d negative = made - given;
  CHECK(negative.selfadjointView<Eigen::Upper>().eigenvalues().minCoeff() > -1e-9 * given.norm());
  CHECK((negative * made).norm() < 1e-9 * given.squaredNorm());
  CHECK(parse_g2o(g2o_text(file.graph, {}), "again").graph.edges()[0].information == made);
}

TEST_CASE("g2o: a graph with indefinite and zero information is optimised", "[io][g2o]") {
  constexpr std::size_t kCount = 20;
  Rng rng(4);
  Matrix6d indefinite = 10.0 * Matrix6d::Identity();
  indefinite(0, 1) = indefinite(1, 0) = indefinite(2, 5) = indefinite(5, 2) = 1e5;
  REQUIRE(check_information(indefinite) != nullptr);
  PoseGraph truth;
  for (std::size_t i = 0; i < kCount; ++i) {
    Node node;
    node.key = i;
    node.pose = testing::random_pose(rng, 5.0);
    truth.add_node(node);
  }
  std::string text = g2o_text(truth, {});
  const auto add = [&](std::size_t from, std::size_t to, const Matrix6d& information) {
    const Eigen::Isometry3d T = truth.nodes()[from].pose.inverse() * truth.nodes()[to].pose;
    const Eigen::Quaterniond q(T.linear());
    std::ostringstream line;
    line.precision(17);
    line << "EDGE_SE3:QUAT " << from << " " << to << " " << T.translation().transpose() << " " << q.x() << " "
         << q.y() << " " << q.z() << " " << q.w();
    text += line.str() + upper_triangle(information);
  };
  for (std::size_t i = 1; i < kCount; ++i) add(i - 1, i, 100.0 * Matrix6d::Identity());
  for (std::size_t i = 3; i < kCount; i += 3) add(i, i - 3, indefinite);
  add(0, 10, Matrix6d::Zero());
  PoseGraph graph = read(text + "FIX 0\n").graph;
  CHECK(graph.edges().size() == kCount - 1 + 6);
  for (std::size_t i = 1; i < kCount; ++i)
    graph.set_pose(i, se3::normalized(truth.nodes()[i].pose * testing::random_pose(rng, 0.05, 0.05)));
  for (const bool robust : {false, true}) {
    CAPTURE(robust);
    const OptimizationResult result = robust ? optimize_gnc(graph).optimization : optimize(graph);
    CHECK(result.converged);
    CHECK_FALSE(result.underdetermined);
    double worst = 0.0;
    for (std::size_t i = 0; i < kCount; ++i)
      worst = std::max(worst, testing::difference(result.poses[i], truth.nodes()[i].pose));
    CHECK(worst < 1e-9);  // measured: 2e-14; the poses begin 0.05 off
  }
}

TEST_CASE("g2o: factors of zero information are left out", "[io][g2o]") {
  const Matrix6d zero = Matrix6d::Zero(), negative = -Matrix6d::Identity();
  const G2oFile file =
      read("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + kTwoVertices + "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1" +
           upper_triangle(zero) + "EDGE_SE3:QUAT 1 0 1 0 0 0 0 0 1" + upper_triangle(negative) +
           "EDGE_SE3_PRIOR 0 0 0 0 0 0 0 0 1" + upper_triangle(zero) + kEdge);
  CHECK(file.graph.edges().size() == 1);
  CHECK(file.graph.priors().empty());
  CHECK(file.problems.count("edge of zero information left out") == 2);
  CHECK(file.problems.count("prior of zero information left out") == 1);
  CHECK(file.problems.count("indefinite information") == 1);
}

TEST_CASE("g2o: unreadable lines are refused with their number", "[io][g2o][error]") {
  struct Bad {
    std::string text;
    std::string message;
  };
  const std::string pose = " 0 0 0 0 0 0 1";
  const Bad bad = GENERATE_COPY(values<Bad>({
      {"", "run.g2o: is empty, no VERTEX_SE3:QUAT or VERTEX_SE2 line"},
      {"# nothing\n", "no VERTEX_SE3:QUAT or VERTEX_SE2 line"},
      {"VERTEX_SE3:QUAT 0 0 0 0 0 0 1\n", ":1: VERTEX_SE3:QUAT needs 7 values after the id, found 6"},
      {"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1 1\n", ":1: VERTEX_SE3:QUAT needs 7 values after the id, found 8"},
      {"VERTEX_SE3:QUAT\n", ":1: VERTEX_SE3:QUAT: id missing"},
      {"VERTEX_SE3:QUAT 0 nan 0 0 0 0 0 1\n", ":1: \"nan\" is not finite"},
      {"VERTEX_SE3:QUAT 0 0 -inf 0 0 0 0 1\n", ":1: \"-inf\" is not finite"},
      {"VERTEX_SE3:QUAT 0 0 1e999 0 0 0 0 1\n", ":1: \"1e999\" is not finite"},
      {"VERTEX_SE3:QUAT 0 0 1,5 0 0 0 0 1\n", ":1: \"1,5\" is not a number"},
      {"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", ":1: zero quaternion"},
      {"VERTEX_SE3:QUAT -1" + pose + "\n", ":1: VERTEX_SE3:QUAT: id \"-1\" is negative"},
      {"VERTEX_SE3:QUAT 18446744073709551616" + pose + "\n", "id \"18446744073709551616\" exceeds 64 bits"},
      {"VERTEX_SE3:QUAT 1.5" + pose + "\n", "id \"1.5\" is not a whole number"},
      {kTwoVertices + "VERTEX_SE3:QUAT 1 2 0 0 0 0 0 1\n", ":3: vertex 1 has another pose in line 2"},
      {kTwoVertices + "EDGE_SE3:QUAT 0 2" + pose + kUnitInformation + "\n", ":3: node 2 is not in the graph"},
      {kTwoVertices + "EDGE_SE3:QUAT 0 1" + pose + " 1\n",
       ":3: EDGE_SE3:QUAT needs 28 values after the ids (7 of the pose, 21 of the information) or the 7 "
       "alone, "
       "found 8"},
      {kTwoVertices + "EDGE_SE3:QUAT 0 1" + pose.substr(2) + "\n", "or the 7 alone, found 6"},
      {kTwoVertices + kEdge + "EDGE_SE3:QUAT 0 1" + pose,
       ":4: EDGE_SE3:QUAT needs 28 values after the ids as"},
      {kTwoVertices + kEdge + kEdge.substr(0, kEdge.size() - 3), ":4: EDGE_SE3:QUAT needs 28 values"},
      {kTwoVertices + "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 0" + kUnitInformation + "\n", ":3: zero quaternion"},
      {kTwoVertices + "EDGE_SE3_PRIOR 0 3" + pose + kUnitInformation + "\n",
       ":3: parameter 3 is not defined by a PARAMS_SE3OFFSET line"},
      {kTwoVertices + "FIX 9\n", ":3: node 9 is not in the graph"},
      {kTwoVertices + "FIX\n", ":3: FIX: id missing"},
      {kTwoVertices + "VERTEX_PLANE x 0 0 1 0\nFIX 9\n", ":4: node 9 is not in the graph"},
      {kTwoVertices + "{\"json\": 1}\n", ":3: unknown g2o tag \"{\"json\":\""},
      {std::string("\x7f"
                   "ELF\0\1\n",
                   7),
       "run.g2o: is a program, expected a g2o graph"},
      {std::string("\x01\x02\0\1\n", 5), ":1: unknown g2o tag \"????\""},
  }));
  CAPTURE(bad.text);
  CHECK_THROWS_AS(read(bad.text), InputError);
  CHECK_THROWS_WITH(read(bad.text), Contains(bad.message) && Contains("run.g2o"));
}

TEST_CASE("g2o: files that cannot be opened or written give the reason", "[io][g2o][error]") {
  const TemporaryFolder folder;
  CHECK_THROWS_AS(read_g2o(folder / "none.g2o"), IoError);
  CHECK_THROWS_WITH(read_g2o(folder / "none.g2o"), Contains("none.g2o: No such file"));
  CHECK_THROWS_WITH(read_g2o(folder.path()), Contains("is a folder"));
  CHECK_THROWS_WITH(write_g2o(folder / "none" / "a.g2o", {}), Contains("No such file"));
}

TEST_CASE("g2o: cutting a file anywhere is an error or counted, never a crash", "[io][g2o][property]") {
  const std::string text = "FIX 0\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n" + kTwoVertices +
                           "EDGE_SE3_PRIOR 0 0 0 0 0 0 0 0 1" + kUnitInformation + "\n" + kEdge;
  std::size_t refused = 0, warned = 0;
  for (std::size_t length = 0; length < text.size(); ++length) {
    try {
      const G2oFile file = read(text.substr(0, length));
      warned += file.problems.empty() ? 0 : 1;
      CHECK((!file.problems.empty() || text[length - 1] == '\n'));
    } catch (const InputError&) {
      ++refused;
    }
  }
  CHECK(refused > 200);
  CHECK(warned > 0);
}

TEST_CASE("g2o: the published graphs read and round-trip", "[io][g2o][data]") {
  const auto folder = testing::test_data("g2o");
  if (!folder) return;
  const TemporaryFolder out;
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(*folder)) {
    if (entry.path().extension() != ".g2o") continue;
    CAPTURE(entry.path().string());
    ++files;
    const G2oFile a = read_g2o(entry.path());
    CHECK(a.problems.count("rounded information") == 0);
    write_g2o(out / "b.g2o", a.graph);
    const G2oFile b = read_g2o(out / "b.g2o");
    REQUIRE(b.graph.keys() == a.graph.keys());
    REQUIRE(b.graph.edges().size() == a.graph.edges().size());
    double worst = 0.0;
    for (std::size_t i = 0; i < a.graph.nodes().size(); ++i) {
      worst = std::max(worst, testing::difference(a.graph.nodes()[i].pose, b.graph.nodes()[i].pose));
    }
    for (std::size_t e = 0; e < a.graph.edges().size(); ++e) {
      worst =
          std::max(worst, testing::difference(a.graph.edges()[e].T_from_to, b.graph.edges()[e].T_from_to));
      CHECK(a.graph.edges()[e].information == b.graph.edges()[e].information);
    }
    CHECK(worst < 1e-12);  // measured: at most 1e-15
  }
  CHECK(files > 0);
}

}  // namespace
}  // namespace loopwise::g2o_test
