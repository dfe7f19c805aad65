// SPDX-License-Identifier: BSD-3-Clause
// Clouds on the command line: world coordinates, files without a header, strays, and names that are no files.
#include <cstring>

#include <nlohmann/json.hpp>

#include <Eigen/Cholesky>

#include <loopwise/core/se3.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "registration/scene.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::cloud_commands_test {
namespace {

using testing::json_of;
using testing::ProgramRun;
using testing::run_program;
using testing::TemporaryFolder;

/// χ² of six degrees of freedom at 0.999.
constexpr double kChiSquare = 22.5;

Eigen::Isometry3d pose_of(const Json& json) {
  Eigen::Isometry3d T;
  for (Eigen::Index i = 0; i < 16; ++i) T.matrix()(i / 4, i % 4) = json.at(static_cast<std::size_t>(i));
  return T;
}

Eigen::Vector3d point_of(const Json& json) {
  return {json.at(0).get<double>(), json.at(1).get<double>(), json.at(2).get<double>()};
}

/// Squared Mahalanobis distance of the computed pose from the truth, in the files' coordinates, by its
/// reported covariance.
double mahalanobis(const Json& json, const Eigen::Isometry3d& truth_files) {
  Matrix6d covariance;
  for (Eigen::Index i = 0; i < 36; ++i) {
    covariance(i / 6, i % 6) = json.at("covariance").at(static_cast<std::size_t>(i));
  }
  const Eigen::Vector3d target = point_of(json.at("origin_m").at("target")),
                        source = point_of(json.at("origin_m").at("source"));
  const Eigen::Isometry3d truth = Eigen::Translation3d(-target) * truth_files * Eigen::Translation3d(source);
  const Vector6d error = se3::log(truth.inverse() * pose_of(json.at("T_target_source_about_origin")));
  return error.dot(covariance.llt().solve(error));
}

void write_doubles(const std::string& path, const PointCloud& cloud, const Eigen::Vector3d& offset) {
  const std::string count = std::to_string(cloud.size());
  std::string out = "FIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nWIDTH " + count + "\nHEIGHT 1\nPOINTS " + count +
                    "\nDATA binary\n";
  for (const Eigen::Vector3f& p : cloud.points) {
    const Eigen::Vector3d there = p.cast<double>() + offset;
    char bytes[24];
    std::memcpy(bytes, there.data(), 24);
    out.append(bytes, 24);
  }
  testing::write_text(path, out);
}

/// Two scans of a yard, and their files with coordinates about an offset.
struct Pair {
  TemporaryFolder folder;
  Eigen::Isometry3d T_target_source = testing::ground_pose(1.0, 0.5, 0.3);
  std::shared_ptr<PointCloud> source, target;

  Pair() {
    const testing::Scene scene(4);
    Rng rng(1);
    const Eigen::Isometry3d T_w_target = testing::ground_pose(0, 0, 0);
    source = scene.scan(T_target_source, 4000, rng);
    target = scene.scan(T_w_target, 4000, rng);
    T_target_source = T_w_target.inverse() * T_target_source;
  }
  [[nodiscard]] std::string write(const std::string& name, const PointCloud& cloud,
                                  const Eigen::Vector3d& offset) const {
    const std::string path = (folder / name).string();
    write_doubles(path, cloud, offset);
    return path;
  }
};

}  // namespace

TEST_CASE("register: clouds in world coordinates keep pose and covariance", "[apps][cloud]") {
  const Pair pair;
  const Eigen::Vector3d offset(432100.25, 5432109.75, 87.5);
  const std::string source = pair.write("source.pcd", *pair.source, offset),
                    target = pair.write("target.pcd", *pair.target, offset),
                    moved = (pair.folder / "moved.pcd").string();
  const Eigen::Isometry3d truth =
      Eigen::Translation3d(offset) * pair.T_target_source * Eigen::Translation3d(-offset);
  const Json json = json_of({"register", source, target, "--out", moved});
  REQUIRE(json.at("status") == "verified");
  REQUIRE(mahalanobis(json, truth) < kChiSquare);  // measured 4
  // Both clouds share their coordinates: one point for both.
  REQUIRE(json.at("origin_m").at("target") == json.at("origin_m").at("source"));
  const Eigen::Vector3d origin = point_of(json.at("origin_m").at("target"));
  REQUIRE((origin - offset).norm() < 30.0);
  const Eigen::Isometry3d about = pose_of(json.at("T_target_source_about_origin")),
                          whole = pose_of(json.at("T_target_source"));
  const Eigen::Isometry3d again = Eigen::Translation3d(origin) * about * Eigen::Translation3d(-origin);
  REQUIRE(((whole * offset) - (again * offset)).norm() < 1e-6);
  REQUIRE(((whole * offset) - (truth * offset)).norm() < 0.1);
  // The aligned cloud is in the target's coordinates, and a comment in it says so.
  const PointCloud out = read_cloud(moved).cloud;
  REQUIRE(out.size() == 4000);
  const Eigen::Vector3d first = whole * (pair.source->points[0].cast<double>() + offset);
  REQUIRE((out.origin + out.points[0].cast<double>() - first).norm() < 1e-4);

  // A guess in the files' coordinates is interpreted correctly.
  std::ostringstream guess;
  guess.precision(17);
  guess << truth.matrix() << "\n";
  testing::write_text(pair.folder / "guess.txt", guess.str());
  REQUIRE(
      json_of({"register", source, target, "--guess", (pair.folder / "guess.txt").string()}).at("status") ==
      "verified");

  // A scan of the sensor's own coordinates against a cloud in the world's.
  const std::string own = pair.write("own.pcd", *pair.source, Eigen::Vector3d::Zero());
  const Json mixed = json_of({"register", own, target});
  REQUIRE(mixed.at("status") == "verified");
  REQUIRE(point_of(mixed.at("origin_m").at("source")).isZero(0.0));
  REQUIRE(mahalanobis(mixed, Eigen::Translation3d(offset) * pair.T_target_source) < kChiSquare);

  const ProgramRun text = run_program({"register", source, target});
  REQUIRE_THAT(text.out, Contains("origin       4321") && Contains("about the origin"));
}

TEST_CASE("register: clouds near the origin keep a zero origin", "[apps][cloud]") {
  const Pair pair;
  const Json json = json_of({"register", pair.write("source.pcd", *pair.source, Eigen::Vector3d::Zero()),
                             pair.write("target.pcd", *pair.target, Eigen::Vector3d::Zero())});
  REQUIRE(json.at("status") == "verified");
  REQUIRE(point_of(json.at("origin_m").at("target")).isZero(0.0));
  REQUIRE(json.at("T_target_source") == json.at("T_target_source_about_origin"));
  REQUIRE(mahalanobis(json, pair.T_target_source) < kChiSquare);
  REQUIRE(json.at("problems").empty());
}

TEST_CASE("register: strays are left out and counted", "[apps][cloud]") {
  Pair pair;
  pair.source->points.emplace_back(9e6F, 0.0F, 0.0F);
  for (int i = 0; i < 60; ++i) pair.target->points.emplace_back(0.0F, 1e6F, 0.0F);
  const std::string source = pair.write("source.pcd", *pair.source, Eigen::Vector3d::Zero()),
                    target = pair.write("target.pcd", *pair.target, Eigen::Vector3d::Zero());
  const Json json = json_of({"register", source, target});
  REQUIRE(json.at("status") == "verified");
  REQUIRE(json.at("problems").size() == 1);
  REQUIRE_THAT(json.at("problems").at(0).get<std::string>(),
               Contains("too far from the sensor left out (61 times") && Contains("features.max_range_m"));
  REQUIRE(json_of({"register", source, source}).at("status") == "verified");
  REQUIRE_THAT(run_program({"register", source, target}).err, Contains("61 times"));
}

TEST_CASE("register and info: surveyed clouds", "[apps][cloud][data]") {
  const auto folder = testing::test_data("../cases/clouds");
  if (!folder) return;
  const auto file = [&](const char* name) { return (*folder / name).string(); };
  // The consistency test is off: only the local clouds show which space the sensor saw as free, and they are
  // sparse.
  const std::string lenient = "fast_registrar.min_consistency=0";
  const Json near = json_of({"register", file("bw_loc.pcd"), file("aw_loc.pcd"), "--set", lenient}),
             far = json_of({"register", file("bw_utm.pcd"), file("aw_utm.pcd"), "--set", lenient});
  REQUIRE(near.at("status") == "verified");
  REQUIRE(far.at("status") == "verified");
  const Eigen::Vector3d offset(386341.853, 5819822.652, 34.5);
  const Eigen::Isometry3d truth =
      Eigen::Translation3d(offset) * pose_of(near.at("T_target_source")) * Eigen::Translation3d(-offset);
  REQUIRE(mahalanobis(far, truth) < kChiSquare);
  const Eigen::Vector3d origin = point_of(far.at("origin_m").at("target"));
  REQUIRE((pose_of(far.at("T_target_source")) * origin - truth * origin).norm() < 0.01);  // measured 1 mm
  REQUIRE(point_of(json_of({"info", file("aw_utm.pcd")}).at("origin_m")).norm() > 5e6);
  REQUIRE(json_of({"info", file("a_helipr.bin"), "--bin-layout", "helipr_ouster"}).at("points").at("total") ==
          4000);
  const ProgramRun refused = run_program({"info", file("a_nuscenes.pcd.bin")});
  REQUIRE(refused.status == 3);
  REQUIRE_THAT(refused.err, Contains("--bin-layout xyzir"));
}

TEST_CASE("command line: no output goes to a file called -", "[apps]") {
  const std::vector<std::vector<std::string>> commands{
      {"convert", "m", "-o", "-"},
      {"replay", "m", "-o", "-"},
      {"replay", "m", "-o", "x", "--record-trace", "-"},
      {"replay", "m", "-o", "x", "--outcomes", "-"},
      {"optimize", "g.g2o", "-o", "-"},
      {"optimize", "g.g2o", "--weights", "-"},
      {"optimize", "g.g2o", "--marginals", "-"},
      {"rank", "m", "-o", "-"},
      {"register", "a.pcd", "b.pcd", "--out", "-"},
      {"info", "m", "--picture", "-"},
      {"report", "out", "-o", "-"},
      {"study", "budget", "m", "-o", "-"},
      {"study", "ablation", "m", "-o", "-"},
      {"study", "registration", "m", "--csv", "-"},
      {"study", "registration", "m", "--markdown", "-"},
  };
  for (const auto& command : commands) {
    CAPTURE(command);
    const ProgramRun run = run_program(command);
    REQUIRE(run.status == 2);
    REQUIRE(run.out.empty());
    REQUIRE_THAT(run.err, Contains("standard output"));
  }
}

TEST_CASE("command line: numbers below zero and beyond 64 bits do not wrap round", "[apps]") {
  const std::vector<std::vector<std::string>> commands{
      {"replay", "m", "-o", "x", "--seed"},
      {"rank", "m", "--seed"},
      {"rank", "m", "--count"},
      {"rank", "m", "--evaluations"},
      {"register", "a.pcd", "b.pcd", "--seed"},
      {"report", "out", "--seed"},
      {"study", "registration", "m", "--seed"},
      {"study", "registration", "m", "--count"},
      {"study", "registration", "m", "--pcl-count"},
      {"study", "budget", "m", "-o", "x", "--seed"},
  };
  for (std::vector<std::string> command : commands) {
    CAPTURE(command);
    command.emplace_back("-1");
    ProgramRun run = run_program(command);
    REQUIRE(run.status == 2);
    REQUIRE_THAT(run.err, Contains("-1 is negative"));
    command.back() = "18446744073709551616";
    run = run_program(command);
    REQUIRE(run.status == 2);
    REQUIRE_THAT(run.err, Contains("exceeds 64 bits"));
  }
}

TEST_CASE("info: joined sessions without frames report the assumed frames", "[apps]") {
  const TemporaryFolder folder;
  std::vector<std::string> arguments{"info"};
  std::string frames = "source,x,y,z,qx,qy,qz,qw\n";
  for (const std::string name : {"first", "second"}) {
    std::filesystem::create_directories(folder / name);
    testing::write_text(folder / name / "odom_poses.txt",
                        "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
    arguments.push_back((folder / name).string());
    frames += name + ",0,0,0,0,0,0,1\n";
  }
  ProgramRun run = run_program(arguments);
  REQUIRE(run.status == 0);
  REQUIRE_THAT(run.out, Contains("joined without a frame (2 times") && Contains("--frames"));
  testing::write_text(folder / "frames.csv", frames);
  arguments.insert(arguments.end(), {"--frames", (folder / "frames.csv").string()});
  run = run_program(arguments);
  REQUIRE(run.status == 0);
  REQUIRE(run.out.find("joined without a frame") == std::string::npos);

  // Poses that are far apart already share a frame.
  testing::write_text(folder / "second" / "odom_poses.txt",
                      "1 0 0 7 0 1 0 0 0 0 1 0\n1 0 0 8 0 1 0 0 0 0 1 0\n");
  run = run_program({arguments[0], arguments[1], arguments[2]});
  REQUIRE(run.status == 0);
  REQUIRE(run.out.find("joined without a frame") == std::string::npos);
}

}  // namespace loopwise::cloud_commands_test
