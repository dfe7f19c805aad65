// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Candidates of a place recognition in replays: those of a file, and those by appearance.
#include <algorithm>
#include <mutex>

#include <loopwise/core/recognition.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/rank.hpp>
#include <loopwise/replay/replay.hpp>

#include "features/place_site.hpp"
#include "testing_mission.hpp"

namespace loopwise::recognition_test {
namespace {

using testing::OracleRegistrar;
using testing::two_circles;
using testing::write_text;

/// Keeps the tasks, and verifies those whose guess is near the truth.
class GuessRegistrar final : public Registrar {
 public:
  explicit GuessRegistrar(std::map<Key, Eigen::Isometry3d> truth) : truth_(std::move(truth)) {}
  [[nodiscard]] std::string_view name() const override { return "guess"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    tasks.push_back(task);
    RegistrationResult result;
    result.candidate = task.candidate;
    const Eigen::Isometry3d T = truth_.at(task.candidate.from).inverse() * truth_.at(task.candidate.to);
    const Vector6d error = se3::log(task.guess_from_to->inverse() * T);
    result.reason = RejectionReason::kFewMatches;
    if (error.head<3>().norm() > 3.0 || error.tail<3>().norm() > 0.3) return result;
    result.reason = RejectionReason::kNone;
    LoopClosure closure;
    closure.from = task.candidate.from;
    closure.to = task.candidate.to;
    closure.T_from_to = T;
    closure.covariance = 1e-4 * Matrix6d::Identity();
    result.closure = closure;
    return result;
  }
  mutable std::vector<RegistrationTask> tasks;

 private:
  std::map<Key, Eigen::Isometry3d> truth_;
  mutable std::mutex mutex_;
};

struct Run {
  ReplayResult result;
  std::vector<RegistrationTask> tasks;
};

Run run(const Mission& mission, const ReplayOptions& options, int threads = 1) {
  const auto registrar = std::make_shared<GuessRegistrar>(mission.ground_truth);
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader());
  ThreadPool pool(threads);
  Run out;
  out.result = MissionReplay(mission, options, {features, registrar}).run(pool);
  out.tasks = registrar->tasks;
  return out;
}

/// Robot a drives 240 m around a block and comes back to where it began; its odometry does not. All
/// it sees are the sites.
Mission round_trip(double drift_rad_per_m) {
  Mission mission;
  mission.name = "round trip";
  mission.robots = parse_robots("a");
  const double side_m = 60.0, step_m = 2.0;
  std::vector<Key> keys;
  Eigen::Isometry3d drifted = Eigen::Isometry3d::Identity();
  const auto along = [&](double s) {
    const int corner = static_cast<int>(s / side_m);
    const double rest = s - corner * side_m;
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    for (int c = 0; c <= corner; ++c) {
      T.translate(Eigen::Vector3d(c < corner ? side_m : rest, 0.0, 0.0));
      if (c < corner)
        T.rotate(Eigen::AngleAxisd(0.5 * static_cast<double>(EIGEN_PI), Eigen::Vector3d::UnitZ()));
    }
    T.pretranslate(Eigen::Vector3d(0.0, 0.0, 1.2));
    return T;
  };
  for (std::uint64_t i = 0; static_cast<double>(i) * step_m < 4.3 * side_m; ++i) {
    const Key key = make_key('a', i);
    const Eigen::Isometry3d truth = along(static_cast<double>(i) * step_m);
    Node node;
    node.key = key;
    node.stamp_ns = static_cast<std::int64_t>(i) * 2000000000;
    Edge edge;
    if (i > 0) {
      edge.from = key - 1;
      edge.to = key;
      edge.kind = EdgeKind::kOdometry;
      Vector6d drift = Vector6d::Zero();
      drift[5] = drift_rad_per_m * step_m;
      edge.T_from_to = mission.ground_truth.at(key - 1).inverse() * truth * se3::exp(drift);
      edge.information.diagonal() << Eigen::Vector3d::Constant(400.0), Eigen::Vector3d::Constant(400.0);
      drifted = se3::normalized(drifted * edge.T_from_to);
    } else {
      drifted = truth;
    }
    node.pose = drifted;
    mission.graph.add_node(node);
    if (i > 0) mission.graph.add_edge(edge);
    mission.ground_truth[key] = truth;
    keys.push_back(key);
  }
  PriorFactor prior;
  prior.key = keys.front();
  prior.pose = mission.graph.node(prior.key).pose;
  prior.information = 1e6 * Matrix6d::Identity();
  mission.graph.add_prior(prior);
  // A site in the middle of each side, 60 m wide.
  mission.scans = std::make_shared<ScanStore>(keys, [truth = mission.ground_truth, along](Key key) {
    auto cloud = std::make_shared<PointCloud>();
    for (int s = 0; s < 4; ++s) {
      const Eigen::Isometry3d T_world_site = along(60.0 * s + 30.0);
      PointCloud part = testing::site(static_cast<std::uint64_t>(40 + s),
                                      T_world_site.inverse() * truth.at(key), key, 30.0);
      cloud->points.insert(cloud->points.end(), part.points.begin(), part.points.end());
    }
    return cloud;
  });
  return mission;
}

double end_error_m(const Mission& mission, const PoseGraph& graph) {
  const Key last = mission.graph.nodes().back().key;
  return (graph.node(last).pose.translation() - mission.ground_truth.at(last).translation()).norm();
}

ReplayOptions options_for(const std::string& method) {
  ReplayOptions options;
  options.prioritization.method = parse_method(method);
  options.prioritization.observability.min_sum = 0.0;
  options.after_mission = true;
  return options;
}

}  // namespace

TEST_CASE("recognition: pairs of a file are candidates, and registrations start from their poses",
          "[replay][recognition]") {
  const Mission mission = two_circles();
  const testing::TemporaryFolder folder;
  // The first is given with the older node first, the second has no pose.
  write_text(folder / "pairs.csv",
             "from,to,score,x,y,z,qx,qy,qz,qw\na2,b30,0.7,1,2,3,0,0,0.6,0.8\nb31,a3,0.4,,,,,,,\n");
  ReplayOptions options = options_for("baseline");
  options.candidates = (folder / "pairs.csv").string();
  options.engine.use_proximity = false;
  const Run alone = run(mission, options);
  REQUIRE(alone.tasks.size() == 2);
  for (const RegistrationTask& task : alone.tasks) REQUIRE(task.candidate.source == CandidateSource::kUser);
  const auto first = std::find_if(alone.tasks.begin(), alone.tasks.end(), [](const RegistrationTask& task) {
    return task.candidate.from == make_key('b', 30);
  });
  REQUIRE(first != alone.tasks.end());
  REQUIRE(first->candidate.recognition->similarity == 0.7);
  Eigen::Isometry3d given = Eigen::Isometry3d::Identity();
  given.linear() = Eigen::Quaterniond(0.8, 0.0, 0.0, 0.6).toRotationMatrix();
  given.translation() << 1.0, 2.0, 3.0;
  REQUIRE(testing::difference(*first->guess_from_to, given.inverse()) < 1e-12);

  // If proximity proposes the same pairs, the recognised guess is still used.
  options.engine.use_proximity = true;
  const Run both = run(mission, options);
  REQUIRE(both.tasks.size() > 100);
  const auto same = std::find_if(both.tasks.begin(), both.tasks.end(), [](const RegistrationTask& task) {
    return task.candidate.from == make_key('b', 30) && task.candidate.to == make_key('a', 2);
  });
  REQUIRE(same != both.tasks.end());
  REQUIRE(testing::difference(*same->guess_from_to, given.inverse()) < 1e-12);

  ReplayOptions without;
  without.engine.use_proximity = false;
  without.candidates = options.candidates;
  REQUIRE(all_candidates(mission, without).size() == 2);
}

TEST_CASE("recognition: a file that does not fit the mission is named", "[replay][recognition][error]") {
  const Mission mission = two_circles();
  const testing::TemporaryFolder folder;
  write_text(folder / "pairs.csv", "from,to\na2,c30\n");
  ReplayOptions options = options_for("baseline");
  options.candidates = (folder / "pairs.csv").string();
  REQUIRE_THROWS_WITH(run(mission, options), Contains("pairs.csv") && Contains("c30"));
  const std::string key = options_key(options);
  write_text(folder / "pairs.csv", "from,to\na2,b30\n");
  REQUIRE(options_key(options) != key);  // other content is another run
}

TEST_CASE("recognition: appearance closes a loop that drift has carried out of the radius",
          "[replay][recognition]") {
  const Mission mission = round_trip(0.008);
  REQUIRE(end_error_m(mission, mission.graph) > 35.0);
  ReplayOptions options = options_for("baseline");
  options.engine.generation.skip_recent = 40;  // no closures along the path, which would hold the drift down
  const Run without = run(mission, options);
  options.appearance.enabled = true;
  const Run with = run(mission, options);
  const double before = end_error_m(mission, without.result.graph),
               after = end_error_m(mission, with.result.graph);
  CAPTURE(before, after);
  REQUIRE(before > 35.0);
  REQUIRE(after < 1.0);
  std::size_t recognised = 0;
  for (const ComputedCandidate& c : with.result.computed)
    recognised += c.result.candidate.source == CandidateSource::kAppearance ? 1 : 0;
  REQUIRE(recognised > 5);
  // The same bits for any number of threads.
  const Run again = run(mission, options, 3);
  REQUIRE(again.result.graph.nodes().back().pose.matrix() == with.result.graph.nodes().back().pose.matrix());
}

}  // namespace loopwise::recognition_test
