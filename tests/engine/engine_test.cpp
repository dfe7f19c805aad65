// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/engine.hpp>

#include <filesystem>
#include <fstream>
#include <iterator>

#include <loopwise/core/recognition.hpp>
#include <loopwise/optimization/odometry_covariances.hpp>
#include <loopwise/prioritization/baselines.hpp>

#include "testing.hpp"

namespace loopwise::engine_test {
namespace {

constexpr std::size_t kNodes = 10;

BetweenFactor odometry(Key from, Key to) {
  BetweenFactor edge;
  edge.from = from;
  edge.to = to;
  edge.T_from_to.translation().x() = 1.0;
  edge.T_from_to.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.1));
  edge.information = 100.0 * Matrix6d::Identity();
  return edge;
}

KeyFrame frame_of(std::uint64_t i) {
  KeyFrame frame;
  frame.node.key = make_key('a', i);
  frame.node.stamp_ns = static_cast<std::int64_t>(i) * 1000000000;
  if (i > 0) frame.odometry.push_back(odometry(make_key('a', i - 1), make_key('a', i)));
  return frame;
}

/// A position fix, as of GNSS, whose rotation is made up.
PriorFactor position_fix(Key key, const Eigen::Vector3d& at, double rotation_information) {
  PriorFactor prior;
  prior.key = key;
  prior.pose.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 1.5));
  prior.pose.translation() = at;
  prior.information.setZero();
  prior.information.diagonal() << Eigen::Vector3d::Constant(4.0),
      Eigen::Vector3d::Constant(rotation_information);
  return prior;
}

Factors prior_alone(const PriorFactor& prior) {
  Factors factors;
  factors.priors = {prior};
  return factors;
}

Factors odometry_alone(const BetweenFactor& odometry) {
  Factors factors;
  factors.odometry = {odometry};
  return factors;
}

Engine engine_with(const EngineOptions& options = {}) {
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
  return Engine(parse_robots("a,b"), options, RoundRobinQueue(std::move(prioritizers)));
}

template <class Wanted>
std::size_t count(const std::vector<Effect>& effects) {
  return static_cast<std::size_t>(std::count_if(
      effects.begin(), effects.end(), [](const Effect& e) { return std::holds_alternative<Wanted>(e); }));
}

}  // namespace

TEST_CASE("engine: a position fix along the path neither turns nor moves it, and requests an estimate",
          "[engine]") {
  for (const double rotation_information : {0.0, 1e-6}) {
    CAPTURE(rotation_information);
    Engine plain = engine_with(), fixed = engine_with();
    for (std::uint64_t i = 0; i < kNodes; ++i) {
      KeyFrame frame = frame_of(i);
      static_cast<void>(plain.handle(frame, 0.0));
      if (i == 5) {
        frame.priors.push_back(position_fix(frame.node.key, {50.0, 0.0, 0.0}, rotation_information));
      }
      static_cast<void>(fixed.handle(frame, 0.0));
    }
    REQUIRE_FALSE(plain.wants_estimate());
    REQUIRE(fixed.wants_estimate());
    for (std::size_t i = 0; i < kNodes; ++i) {
      REQUIRE(fixed.graph().nodes()[i].pose.matrix() == plain.graph().nodes()[i].pose.matrix());
      REQUIRE(fixed.odometry()[i].matrix() == plain.odometry()[i].matrix());
    }
    REQUIRE(count<effect::Optimize>(fixed.handle(event::Settle{}, 0.0)) == 1);
    REQUIRE(fixed.optimizing());
    REQUIRE(count<effect::Optimize>(fixed.handle(event::Settle{}, 0.0)) == 0);
  }
}

TEST_CASE("engine: a position fix of the first node places it and keeps its rotation", "[engine]") {
  Engine engine = engine_with();
  KeyFrame frame = frame_of(0);
  frame.node.pose.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.7));
  frame.priors.push_back(position_fix(frame.node.key, {50.0, 2.0, 0.0}, 0.0));
  static_cast<void>(engine.handle(frame, 0.0));
  REQUIRE(engine.graph().nodes()[0].pose.linear() == frame.node.pose.linear());
  REQUIRE(engine.graph().nodes()[0].pose.translation() == Eigen::Vector3d(50.0, 2.0, 0.0));
  REQUIRE_FALSE(engine.wants_estimate());
}

TEST_CASE("engine: a full prior that comes late moves the path and its odometry as one", "[engine]") {
  Engine engine = engine_with();
  for (std::uint64_t i = 0; i < kNodes; ++i) static_cast<void>(engine.handle(frame_of(i), 0.0));
  PriorFactor prior = position_fix(make_key('a', 4), {50.0, 2.0, 1.0}, 4.0);
  static_cast<void>(engine.handle(prior_alone(prior), 0.0));
  REQUIRE(engine.graph().node(prior.key).pose.matrix() == prior.pose.matrix());
  for (std::size_t i = 1; i < kNodes; ++i) {
    const Eigen::Isometry3d step = odometry(0, 1).T_from_to;
    REQUIRE(testing::difference(engine.graph().nodes()[i - 1].pose * step, engine.graph().nodes()[i].pose) <
            1e-9);
    REQUIRE(testing::difference(engine.odometry()[i], engine.graph().nodes()[i].pose) < 1e-9);
  }
  REQUIRE_FALSE(engine.wants_estimate());  // the path agrees with the prior
  prior.pose.translation().x() += 1.0;     // another that contradicts it
  static_cast<void>(engine.handle(prior_alone(prior), 0.0));
  REQUIRE(engine.wants_estimate());
}

TEST_CASE("engine: an event that is invalid changes nothing", "[engine][error]") {
  Engine engine = engine_with();
  for (std::uint64_t i = 0; i < 3; ++i) static_cast<void>(engine.handle(frame_of(i), 0.0));
  REQUIRE_THROWS_AS(engine.handle(frame_of(1), 0.0), InputError);
  KeyFrame frame = frame_of(3);
  frame.node.key = make_key('z', 0);
  REQUIRE_THROWS_AS(engine.handle(frame, 0.0), UnknownKeyError);
  frame = frame_of(3);
  frame.odometry[0].information(2, 2) = -5.0;
  REQUIRE_THROWS_AS(engine.handle(frame, 0.0), InputError);
  frame = frame_of(3);
  frame.odometry[0].T_from_to.translation().x() = 1.7e308;
  static_cast<void>(engine.handle(frame, 0.0));
  frame = frame_of(4);
  frame.odometry[0].T_from_to.translation().x() = 1.7e308;
  REQUIRE_THROWS_AS(engine.handle(frame, 0.0), InputError);  // the pose would not be finite
  REQUIRE(engine.odometry().size() == 4);
  REQUIRE_THROWS_AS(engine.handle(event::Scan{}, 0.0), UnknownKeyError);
  REQUIRE_THROWS_AS(engine.handle(RegistrationResult{}, 0.0), InputError);
  REQUIRE_THROWS_AS(engine.handle(event::Optimized{}, 0.0), InputError);
  REQUIRE_THROWS_AS(engine.handle(ExternalEstimate{}, 0.0), InputError);
  REQUIRE(engine.graph().nodes().size() == 4);
  REQUIRE(engine.graph().edges().size() == 3);
  REQUIRE(engine.odometry().size() == 4);
  REQUIRE(engine.factors_waiting() == 0);
  static_cast<void>(engine.handle(frame_of(4), 0.0));
  REQUIRE(engine.graph().nodes().size() == 5);
  REQUIRE(engine.odometry().size() == 5);
}

TEST_CASE("engine: time never goes back, and waiting is measured by it alone", "[engine]") {
  EngineOptions options;
  options.max_factor_wait_s = 10.0;
  options.pool.max_wait_s = 20.0;
  options.generation.skip_recent = 2;
  Engine engine = engine_with(options);
  static_cast<void>(engine.handle(odometry_alone(odometry(make_key('b', 0), make_key('b', 1))), 5.0));
  KeyFrame ahead = frame_of(0);
  ahead.node.stamp_ns = std::numeric_limits<std::int64_t>::max();
  static_cast<void>(engine.handle(ahead, 6.0));
  KeyFrame behind = frame_of(1);
  behind.node.stamp_ns = std::numeric_limits<std::int64_t>::min();
  static_cast<void>(engine.handle(behind, 6.0));
  for (std::uint64_t i = 2; i < 5; ++i) static_cast<void>(engine.handle(frame_of(i), 6.0));
  static_cast<void>(engine.handle(event::Tick{}, 15.0));
  REQUIRE(engine.factors_dropped() == 0);
  REQUIRE(engine.pool().accounting().waiting > 0);
  static_cast<void>(engine.handle(event::Tick{}, 1.0));
  REQUIRE(engine.now_s() == 15.0);
  REQUIRE(count<effect::Problem>(engine.handle(event::Tick{}, 15.5)) == 1);
  REQUIRE(engine.factors_dropped() == 1);
  REQUIRE(engine.pool().accounting().expired == 0);
  static_cast<void>(engine.handle(event::Tick{}, 26.5));
  REQUIRE(engine.pool().accounting().waiting == 0);
  REQUIRE(engine.pool().accounting().expired > 0);
}

TEST_CASE("engine: its sources use no threads, clocks or files", "[engine]") {
  std::size_t files = 0;
  for (const char* folder : {"/src/engine", "/include/loopwise/engine"}) {
    for (const auto& entry : std::filesystem::directory_iterator(LOOPWISE_SOURCE_DIR + std::string(folder))) {
      std::ifstream file(entry.path());
      const std::string text((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
      CAPTURE(entry.path());
      REQUIRE_FALSE(text.empty());
      ++files;
      for (const char* word :
           {"<thread>", "<mutex>", "<condition_variable>", "<chrono>", "<fstream>", "<future>", "<atomic>",
            "loopwise/io/", "core/clock.hpp", "core/thread_pool.hpp"}) {
        CAPTURE(word);
        REQUIRE(text.find(word) == std::string::npos);
      }
    }
  }
  REQUIRE(files > 7);
}

TEST_CASE("engine: tasks have the covariance of a guess by odometry, and none of a recognised pose",
          "[engine]") {
  Engine engine = engine_with();
  auto cloud = std::make_shared<PointCloud>();
  cloud->points.push_back({1.0F, 2.0F, 3.0F});
  for (std::uint64_t i = 0; i < kNodes; ++i) {
    KeyFrame frame = frame_of(i);
    frame.cloud = cloud;
    static_cast<void>(engine.handle(frame, 0.0));
  }
  LoopCandidate plain, recognised;
  plain.from = make_key('a', 8);
  plain.to = make_key('a', 1);
  recognised.from = make_key('a', 9);
  recognised.to = make_key('a', 2);
  auto recognition = std::make_shared<Recognition>();
  recognition->T_from_to = Eigen::Isometry3d::Identity();
  recognised.recognition = recognition;
  static_cast<void>(engine.handle(event::Candidates{{plain, recognised}}, 1.0));
  std::size_t by_odometry = 0, by_recognition = 0;
  for (const Effect& effect : engine.handle(event::Choose{100}, 1.0)) {
    if (!std::holds_alternative<effect::Compute>(effect)) continue;
    for (const RegistrationTask& task : std::get<effect::Compute>(effect).tasks) {
      REQUIRE(task.guess_from_to);
      if (task.candidate.recognition) {
        REQUIRE_FALSE(task.guess_covariance);
        ++by_recognition;
      } else {
        OdometryCovariances covariances;
        covariances.update(engine.graph());
        REQUIRE(task.guess_covariance);
        REQUIRE(task.guess_covariance == covariances.between(engine.graph().index_of(task.candidate.from),
                                                             engine.graph().index_of(task.candidate.to)));
        ++by_odometry;
      }
    }
  }
  REQUIRE(by_recognition == 1);
  REQUIRE(by_odometry >= 1);
}

}  // namespace loopwise::engine_test
