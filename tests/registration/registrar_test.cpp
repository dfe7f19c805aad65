// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What holds for every registrar of the library.
#include <algorithm>
#include <chrono>
#include <iomanip>
#include <map>
#include <numeric>
#include <string>
#include <thread>
#include <tuple>

#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/trajectory.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/closure_tests.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/registrar.hpp>
#ifdef LOOPWISE_WITH_PCL
#include <loopwise/registration/pcl_registrar.hpp>
#endif
#include "scene.hpp"
#include "testing.hpp"

namespace loopwise::registrar_test {
namespace {

std::vector<std::string> registrar_names() {
  std::vector<std::string> names{"fast"};
#ifdef LOOPWISE_WITH_PCL
  names.emplace_back("pcl");
#endif
  return names;
}

std::unique_ptr<Registrar> make_registrar(const std::string& name, ScanLoader scans) {
  auto features = std::make_shared<FeatureCache>(std::move(scans));
  if (name == "fast") return std::make_unique<FastRegistrar>(std::move(features));
#ifdef LOOPWISE_WITH_PCL
  if (name == "pcl") return std::make_unique<PclRegistrar>(std::move(features));
#endif
  throw OptionError("no registrar " + name);
}

struct Errors {
  double m = 0.0;
  double deg = 0.0;
};
Errors errors(const Eigen::Isometry3d& found, const Eigen::Isometry3d& truth) {
  const Eigen::Isometry3d d = truth.inverse() * found;
  return {d.translation().norm(), se3::rotation_angle(d) * 180.0 / 3.14159265358979323846};
}

void require_sound(const RegistrationResult& result) {
  CAPTURE(result.message, enum_name(result.reason));
  REQUIRE(result.verified() == (result.reason == RejectionReason::kNone));
  REQUIRE(result.message.empty() == result.verified());
  if (result.T_from_to) REQUIRE(result.T_from_to->matrix().allFinite());
  if (!result.closure) return;
  REQUIRE(result.closure->T_from_to.matrix().allFinite());
  REQUIRE(result.closure->covariance.allFinite());
  REQUIRE(result.closure->covariance == result.closure->covariance.transpose());
  REQUIRE(Eigen::SelfAdjointEigenSolver<Matrix6d>(result.closure->covariance).eigenvalues()[0] > 0.0);
}

void require_identical(const RegistrationResult& a, const RegistrationResult& b) {
  REQUIRE(a.candidate.from == b.candidate.from);
  REQUIRE(a.reason == b.reason);
  REQUIRE(a.message == b.message);
  REQUIRE(a.T_from_to.has_value() == b.T_from_to.has_value());
  if (a.T_from_to) REQUIRE(a.T_from_to->matrix() == b.T_from_to->matrix());
  if (a.closure) REQUIRE(a.closure->covariance == b.closure->covariance);
}

/// Nodes of a drive through the scene, 2 m apart, each with a scan.
struct Drive {
  testing::Scans scans;
  std::vector<Eigen::Isometry3d> poses;

  explicit Drive(std::uint64_t seed, int count, std::size_t points = 15000, double range_m = 20.0) {
    const testing::Scene scene(seed);
    Rng rng(seed + 1);
    for (int i = 0; i < count; ++i) {
      poses.push_back(testing::ground_pose(2.0 * i - 5.0, 0.5 * i, 0.7 * i));
      scans[static_cast<Key>(i)] = scene.scan(poses.back(), points, rng, 0.02, range_m);
    }
  }
  [[nodiscard]] Eigen::Isometry3d truth(Key from, Key to) const { return poses[from].inverse() * poses[to]; }
};

TEST_CASE("registrar: finds the pose of a pair without a guess", "[registrar]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(11, 4);
  const auto registrar = make_registrar(name, testing::loader(drive.scans));
  REQUIRE(registrar->name() == name);
  for (Key from = 1; from < 4; ++from) {
    const RegistrationResult result = registrar->compute(pair_task(from, 0, pair_seed(1, from, 0)));
    require_sound(result);
    REQUIRE(result.verified());
    const Errors e = errors(result.closure->T_from_to, drive.truth(from, 0));
    CAPTURE(from, e.m, e.deg);
    REQUIRE(e.m < 0.06);    // measured at most 0.022 m
    REQUIRE(e.deg < 0.25);  // measured at most 0.08 deg
    REQUIRE(result.overlap > 0.6);
  }
}

TEST_CASE("registrar: neighbours join a submap only while it lacks points", "[registrar]") {
  const Drive drive(11, 4);
  RegistrationTask task = pair_task(3, 0, 1);
  for (const Key key : {1, 2}) task.target.push_back({key, drive.truth(0, key)});
  for (const auto& [enough, scans] : {std::pair<std::size_t, std::size_t>{10, 2}, {0, 4}}) {
    const auto features = std::make_shared<FeatureCache>(testing::loader(drive.scans));
    task.enough_points = enough;
    require_sound(FastRegistrar(features).compute(task));
    REQUIRE(features->computed() == scans);
  }
}

TEST_CASE("registrar: a submap reaches further, a guess is used, and strays are refused", "[registrar]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(13, 5, 600, 10.0);  // sparse scans, as LAMP keeps them
  const auto registrar = make_registrar(name, testing::loader(drive.scans));
  RegistrationTask task = pair_task(4, 1, 7);
  for (const Key key : {Key{0}, Key{2}, Key{3}}) task.target.push_back({key, drive.truth(1, key)});
  const Eigen::Isometry3d truth = drive.truth(4, 1);
  task.guess_from_to = truth * se3::exp((Vector6d() << 0.3, -0.3, 0.1, 0.0, 0.0, 0.05).finished());
  const RegistrationResult result = registrar->compute(task);
  require_sound(result);
  REQUIRE(result.verified());
  const Errors e = errors(result.closure->T_from_to, truth);
  CAPTURE(e.m, e.deg);
  REQUIRE(e.m < 0.15);
  REQUIRE(e.deg < 0.6);

  task.guess_from_to = truth * Eigen::Translation3d(25.0, 0.0, 0.0);
  const RegistrationResult stray = registrar->compute(task);
  require_sound(stray);
  REQUIRE_FALSE(stray.verified());
}

TEST_CASE("registrar: places that share nothing are refused", "[registrar]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  Rng rng(17);
  testing::Scans scans;
  for (Key key = 0; key < 6; ++key) {
    scans[key] = testing::Scene(100 + key).scan(testing::ground_pose(0, 0, 0), 5000, rng);
  }
  const auto registrar = make_registrar(name, testing::loader(scans));
  for (Key key = 1; key < 6; ++key) {
    const RegistrationResult result = registrar->compute(pair_task(key, 0, key));
    require_sound(result);
    CAPTURE(key, result.overlap, result.gicp_fitness_m2);
    // Two yards share the ground; nothing else of them may pass for one place.
    REQUIRE_FALSE(result.verified());
  }
}

TEST_CASE("registrar: the same bits on 1 and 2 threads, in any order, with a cold or a warm cache",
          "[registrar][property][thread]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(19, 4, 4000);
  std::vector<RegistrationTask> tasks;
  for (Key from = 1; from < 4; ++from) {
    for (Key to = 0; to < from; ++to) tasks.push_back(pair_task(from, to, pair_seed(3, from, to)));
  }
  ThreadPool one(1), two(2);
  const auto registrar = make_registrar(name, testing::loader(drive.scans));
  const auto expected = compute_batch(*registrar, tasks, one);
  const auto warm = compute_batch(*registrar, tasks, two);
  std::vector<std::size_t> order(tasks.size());
  std::iota(order.begin(), order.end(), 0);
  Rng(23).shuffle(order);
  std::vector<RegistrationTask> shuffled;
  for (const std::size_t i : order) shuffled.push_back(tasks[i]);
  const auto cold = compute_batch(*make_registrar(name, testing::loader(drive.scans)), shuffled, two);
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    require_identical(*warm[i], *expected[i]);
    require_identical(*cold[i], *expected[order[i]]);
  }
}

TEST_CASE("registrar: a scan that is missing or cannot be read is a reason", "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(29, 1, 500);
  const auto registrar = make_registrar(name, [&](Key key) -> std::shared_ptr<const PointCloud> {
    if (key == 2) throw IoError("2.pcd", "truncated");
    return key == 0 ? drive.scans.at(0) : nullptr;
  });
  for (const auto& [from, to, text] : std::vector<std::tuple<Key, Key, std::string>>{
           {1, 0, "scan 1: is missing"}, {0, 1, "scan 1: is missing"}, {2, 0, "scan 2: 2.pcd: truncated"}}) {
    const RegistrationResult result = registrar->compute(pair_task(from, to, 0));
    require_sound(result);
    REQUIRE(result.reason == RejectionReason::kMissingScan);
    REQUIRE(result.message == text);
  }
}

TEST_CASE("registrar: a neighbour's scan that cannot be read is left out and reported",
          "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(11, 4);
  const auto registrar = make_registrar(name, [&](Key key) -> std::shared_ptr<const PointCloud> {
    if (key == 2) throw IoError("2.pcd", "truncated");
    return drive.scans.at(key);
  });
  RegistrationTask task = pair_task(3, 0, pair_seed(1, 3, 0));
  const RegistrationResult alone = registrar->compute(task);
  REQUIRE(alone.verified());
  REQUIRE_FALSE(alone.incomplete);
  task.target.push_back({2, drive.truth(0, 2)});
  const RegistrationResult without = registrar->compute(task);
  require_sound(without);
  REQUIRE(without.verified());
  REQUIRE(without.incomplete);
  REQUIRE(depends_on_circumstances(without));
  REQUIRE(errors(without.closure->T_from_to, drive.truth(3, 0)).m < 0.06);
}

TEST_CASE("registrar: degenerate scans are refused with a reason", "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  Rng rng(31);
  const auto points = [&](std::size_t count, auto&& point) {
    auto cloud = std::make_shared<PointCloud>();
    for (std::size_t i = 0; i < count; ++i) cloud->points.push_back(point(static_cast<float>(i)));
    return cloud;
  };
  const auto uniform = [&] { return static_cast<float>(rng.uniform(-8.0, 8.0)); };
  const auto anywhere = [&](float) { return Eigen::Vector3f(uniform(), uniform(), uniform()); };
  const auto in_one_point = [](float) { return Eigen::Vector3f(3.0F, 2.0F, 1.0F); };
  const auto on_a_line = [](float i) { return Eigen::Vector3f(0.02F * i, 1.0F, -1.0F); };
  const auto on_a_plane = [&](float) { return Eigen::Vector3f(uniform(), uniform(), -1.0F); };
  testing::Scans scans{{0, testing::Scene(1).scan(testing::ground_pose(0, 0, 0), 3000, rng)}};
  scans[1] = points(0, anywhere);
  scans[2] = points(1, anywhere);
  scans[3] = points(5, anywhere);
  scans[4] = points(2000, in_one_point);
  scans[5] = points(2000, on_a_line);
  scans[6] = points(2000, on_a_plane);
  scans[7] = points(30, anywhere);
  const auto registrar = make_registrar(name, testing::loader(scans));
  for (Key key = 1; key < 8; ++key) {
    for (const auto& [from, to] : std::vector<std::pair<Key, Key>>{{key, 0}, {0, key}, {key, key}}) {
      CAPTURE(from, to);
      const RegistrationResult result = registrar->compute(pair_task(from, to, 5));
      require_sound(result);
      if (key <= 5) REQUIRE(result.reason == RejectionReason::kTooFewPoints);
      if (key == 6) REQUIRE_FALSE(result.verified());
    }
  }
}

TEST_CASE("registrar: any number of points up to 50, not all finite, gives a reason", "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  Rng rng(37);
  testing::Scans scans{{1000, testing::Scene(1).scan(testing::ground_pose(0, 0, 0), 1500, rng)}};
  for (Key count = 0; count <= 50; ++count) {
    auto cloud = std::make_shared<PointCloud>(*scans.at(1000));
    cloud->points.resize(count);
    cloud->normals.clear();
    if (count % 7 == 3) cloud->points.back() = Eigen::Vector3f::Constant(std::nanf(""));
    if (count % 7 == 5) cloud->points.back().x() = std::numeric_limits<float>::infinity();
    scans[count] = cloud;
  }
  const auto registrar = make_registrar(name, testing::loader(scans));
  for (Key count = 0; count <= 50; ++count) {
    CAPTURE(count);
    require_sound(registrar->compute(pair_task(count, 1000, 1)));
    require_sound(registrar->compute(pair_task(1000, count, 1)));
    const RegistrationResult own = registrar->compute(pair_task(count, count, 1));
    require_sound(own);
    if (count < 20) REQUIRE(own.reason == RejectionReason::kTooFewPoints);
  }
}

TEST_CASE("registrar: 200 000 points with duplicates and holes", "[registrar][error]") {
  Rng rng(53);
  const testing::Scene scene(11);
  testing::Scans scans;
  for (Key key = 0; key < 2; ++key) {
    const auto part = scene.scan(testing::ground_pose(1.0 * static_cast<double>(key), 0, 0.2), 50000, rng);
    auto cloud = std::make_shared<PointCloud>(*part);
    for (int copy = 0; copy < 3; ++copy) {
      cloud->points.insert(cloud->points.end(), part->points.begin(), part->points.end());
    }
    cloud->normals.clear();
    for (std::size_t i = 0; i < cloud->points.size(); i += 1000) cloud->points[i].setConstant(std::nanf(""));
    scans[key] = cloud;
  }
  const RegistrationResult result =
      make_registrar("fast", testing::loader(scans))->compute(pair_task(1, 0, 1));
  require_sound(result);
  REQUIRE(result.verified());
}

TEST_CASE("FastRegistrar: prepared scans change nothing", "[registrar]") {
  const Drive drive(19, 2, 4000);
  const auto features = std::make_shared<FeatureCache>(testing::loader(drive.scans));
  const FastRegistrar cold(features), warm(features);
  warm.prepare(0);
  warm.prepare(1);
  warm.prepare(99);  // a key without a scan
  require_identical(warm.compute(pair_task(1, 0, 1)), cold.compute(pair_task(1, 0, 1)));
}

TEST_CASE("registrar: clouds that lie 100 km from the sensor align as well", "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(11, 2);
  const Eigen::Isometry3d away(Eigen::Translation3d(1e5, -1e5, 1e5));
  testing::Scans scans;
  for (const auto& [key, scan] : drive.scans) {
    auto moved = std::make_shared<PointCloud>(*scan);
    for (auto& p : moved->points) p = (away * p.cast<double>()).cast<float>();
    scans[key] = moved;
  }
  const RegistrationResult result = make_registrar(name, testing::loader(scans))->compute(pair_task(1, 0, 3));
  require_sound(result);
  REQUIRE(result.verified());
  const Eigen::Isometry3d near = away.inverse() * result.closure->T_from_to * away;
  const Errors e = errors(near, drive.truth(1, 0));
  CAPTURE(e.m, e.deg);
  REQUIRE(e.m < 0.08);  // points are rounded to 8 mm out there
  REQUIRE(e.deg < 0.3);
}

TEST_CASE("registrar: strays change nothing", "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  const auto strays = GENERATE(as<std::pair<int, float>>(), std::pair(1, 9e6F), std::pair(60, 1e6F));
  CAPTURE(name, strays.first);
  const Drive drive(11, 2);
  testing::Scans scans;
  Rng rng(4);
  for (const auto& [key, scan] : drive.scans) {
    auto with_strays = std::make_shared<PointCloud>(*scan);
    for (int i = 0; i < strays.first; ++i) {
      const auto u = [&rng] { return static_cast<float>(rng.uniform(-1.0, 1.0)); };
      with_strays->points.push_back(strays.second * Eigen::Vector3f(u(), u(), u()).normalized());
    }
    scans[key] = with_strays;
  }
  const auto clean = make_registrar(name, testing::loader(drive.scans));
  const auto registrar = make_registrar(name, testing::loader(scans));
  require_identical(registrar->compute(pair_task(1, 0, 3)), clean->compute(pair_task(1, 0, 3)));
  REQUIRE(registrar->compute(pair_task(0, 0, 3)).verified());
}

TEST_CASE("registrar: options are checked", "[registrar][error]") {
  const auto features = std::make_shared<FeatureCache>(testing::loader({}));
  FastRegistrarOptions fast;
  fast.tests.min_overlap = 1.5;
  REQUIRE_THROWS_WITH(FastRegistrar(features, fast), "min_overlap = 1.5, must be in [0, 1]");
  REQUIRE_THROWS_AS(FastRegistrar(nullptr), InputError);
#ifdef LOOPWISE_WITH_PCL
  PclRegistrarOptions pcl;
  pcl.sac_hypotheses = 0;
  REQUIRE_THROWS_WITH(PclRegistrar(features, pcl), "sac_hypotheses = 0, must be >= 1");
  REQUIRE_THROWS_AS(PclRegistrar(nullptr), InputError);
#endif
}

TEST_CASE("registrar: options of the tests are described like its own", "[registrar]") {
  const auto texts = [](const auto& options) {
    std::map<std::string, std::string> by_name;
    for (const OptionDescription& option : describe(options)) by_name[option.name] = option.doc;
    return by_name;
  };
  const std::map<std::string, std::string> tests = texts(ClosureTestOptions());
  REQUIRE(tests.at("min_points") == "Scans with fewer points are not aligned.");
  for (const auto& all : {texts(FastRegistrarOptions()), texts(PclRegistrarOptions())}) {
    CHECK(all.at("fpfh_radius_m") == "Radius of the FPFH descriptors, m.");
    for (const auto& [name, text] : tests) {
      CAPTURE(name);
      CHECK(all.at(name) == text);
    }
  }
}

TEST_CASE("registrar: kitti_pair from scratch", "[registrar][data]") {
  const auto folder = testing::test_data("kitti_pair");
  if (!folder) return;
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  testing::Scans scans;
  scans[1] = std::make_shared<PointCloud>(read_cloud(*folder / "source.ply").cloud);
  scans[0] = std::make_shared<PointCloud>(read_cloud(*folder / "target.ply").cloud);
  Eigen::Isometry3d T_target_source;
  std::istringstream text(testing::read_text(*folder / "T_target_source.txt"));
  for (int i = 0; i < 16; ++i) text >> T_target_source.matrix()(i / 4, i % 4);
  int found = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    // The source as another sensor pose would have it: turned anyhow about the vertical, up to 5 m away.
    Rng rng(seed);
    Eigen::Isometry3d T_moved_source = Eigen::Isometry3d::Identity();
    T_moved_source.rotate(Eigen::AngleAxisd(rng.uniform(-3.14, 3.14), Eigen::Vector3d::UnitZ()));
    T_moved_source.translation() << rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-1, 1);
    auto moved = std::make_shared<PointCloud>();
    for (const Eigen::Vector3f& p : scans[1]->points) {
      moved->points.push_back((T_moved_source * p.cast<double>()).cast<float>());
    }
    const auto registrar = make_registrar(name, testing::loader({{0, scans[0]}, {1, moved}}));
    const RegistrationResult result = registrar->compute(pair_task(1, 0, pair_seed(seed, 1, 0)));
    require_sound(result);
    if (!result.verified()) continue;
    const Errors e = errors(result.closure->T_from_to.inverse() * T_moved_source, T_target_source);
    if (e.m < 0.3 && e.deg < 1.0) ++found;
  }
  REQUIRE(found >= 18);  // measured 20, at most 0.03 m and 0.6 deg
}

TEST_CASE("registrar: kaist03 against the session's poses", "[registrar][data]") {
  const auto folder = testing::test_data("kaist03");
  if (!folder) return;
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const std::vector<Eigen::Isometry3d> poses = read_kitti(*folder / "optimized_poses.txt");
  const auto registrar = make_registrar(name, [&](Key key) {
    std::ostringstream file;
    file << std::setw(6) << std::setfill('0') << key << ".pcd";
    return std::make_shared<const PointCloud>(read_cloud(*folder / "Scans" / file.str()).cloud);
  });
  // A third of the pairs of the first nodes: neighbours and pairs up to the length of the drive.
  std::vector<double> near_m, near_deg, all_m, all_deg;
  const Key count = std::min<Key>(poses.size(), 16);
  std::size_t pairs = 0;
  for (Key from = 1; from < count; ++from) {
    for (Key to = (2 * from) % 3; to < from; to += 3) {
      const RegistrationResult result = registrar->compute(pair_task(from, to, pair_seed(0, from, to)));
      require_sound(result);
      ++pairs;
      if (!result.verified()) continue;
      const Errors e = errors(result.closure->T_from_to, poses[from].inverse() * poses[to]);
      CAPTURE(from, to, e.m, e.deg);
      REQUIRE(e.m < 0.4);
      all_m.push_back(e.m);
      all_deg.push_back(e.deg);
      if (from - to > 4) continue;
      REQUIRE(e.m < 0.15);
      near_m.push_back(e.m);
      near_deg.push_back(e.deg);
    }
  }
  const auto median = [](std::vector<double> values) {
    std::sort(values.begin(), values.end());
    return values.at(values.size() / 2);
  };
  CAPTURE(pairs, all_m.size(), median(all_m), median(all_deg), median(near_m), median(near_deg));
  REQUIRE(2 * all_m.size() > pairs);
  REQUIRE(median(near_m) < 0.04);
  REQUIRE(median(near_deg) < 0.3);
  REQUIRE(median(all_m) < 0.1);
  REQUIRE(median(all_deg) < 0.5);
}

TEST_CASE("registrar: a time limit ends it with a reason, one that is not reached changes nothing",
          "[registrar][error]") {
  const std::string name = GENERATE(from_range(registrar_names()));
  CAPTURE(name);
  const Drive drive(11, 2);
  RegistrationTask task = pair_task(1, 0, 1);
  const RegistrationResult without = make_registrar(name, testing::loader(drive.scans))->compute(task);
  task.time_limit_s = 3600.0;
  require_identical(make_registrar(name, testing::loader(drive.scans))->compute(task), without);

  // A scan that takes longer to read than there is time for all.
  const auto slow = make_registrar(name, [&](Key key) {
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
    return drive.scans.at(key);
  });
  task.time_limit_s = 0.02;
  const RegistrationResult late = slow->compute(task);
  require_sound(late);
  REQUIRE(late.reason == RejectionReason::kTimeLimit);
  REQUIRE_THAT(late.message, Contains("0.02"));
  // What it has read by then is kept, so that there is time for more the next time.
  task.time_limit_s = 3600.0;
  require_identical(slow->compute(task), without);
}

}  // namespace
}  // namespace loopwise::registrar_test
