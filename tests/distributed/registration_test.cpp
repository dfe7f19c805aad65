// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/registration.hpp>

#include <cmath>
#include <thread>

#include <loopwise/core/error.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::registration_test {
namespace {

RegistrationTask random_task(Rng& rng) {
  const Key from = rng(), to = rng();
  RegistrationTask task = pair_task(from, to, rng());
  task.candidate.id = rng.below(1000000);
  const auto sources = enum_names(CandidateSource{});
  task.candidate.source = sources[rng.below(sources.size())].first;
  task.candidate.time_s = rng.uniform(0.0, 5000.0);
  task.candidate.distance_m = rng.uniform(0.0, 30.0);
  task.enough_points = rng.below(5000);
  if (rng.uniform() < 0.7) task.guess_from_to = testing::random_pose(rng, 10.0);
  if (rng.uniform() < 0.5) task.guess_covariance = Matrix6d::Random();
  for (std::uint64_t k = rng.below(5); k > 0; --k) {
    const Key key = rng();
    const bool still = rng.uniform() < 0.2;  // no motion by odometry, but an uncertain one
    task.target.push_back(
        {key, still ? Eigen::Isometry3d::Identity() : testing::random_pose(rng, 2.0), Matrix6d::Random()});
  }
  return task;
}

bool same_number(double a, double b) {
  return a == b || (std::isnan(a) && std::isnan(b));
}

void require_same(const RegistrationResult& a, const RegistrationResult& b) {
  REQUIRE(a.candidate.id == b.candidate.id);
  REQUIRE(a.reason == b.reason);
  REQUIRE(a.message == b.message);
  REQUIRE(a.T_from_to.has_value() == b.T_from_to.has_value());
  if (a.T_from_to) REQUIRE(a.T_from_to->matrix() == b.T_from_to->matrix());
  REQUIRE(a.closure.has_value() == b.closure.has_value());
  if (a.closure) {
    REQUIRE(a.closure->from == b.closure->from);
    REQUIRE(a.closure->T_from_to.matrix() == b.closure->T_from_to.matrix());
    REQUIRE(a.closure->covariance == b.closure->covariance);
  }
  for (const auto figure : {&RegistrationResult::sac_fitness_m2, &RegistrationResult::gicp_fitness_m2,
                            &RegistrationResult::overlap, &RegistrationResult::features_s}) {
    REQUIRE(same_number(a.*figure, b.*figure));
  }
}

}  // namespace

TEST_CASE("messages: tasks and results come through to the bit; cut ones are refused",
          "[distributed][property]") {
  Rng rng(1);
  for (int trial = 0; trial < 200; ++trial) {
    const RegistrationTask task = random_task(rng);
    const std::string bytes = pack_task(task);
    const RegistrationTask back = unpack_task(bytes);
    REQUIRE(pack_task(back) == bytes);
    REQUIRE(back.candidate.from == task.candidate.from);
    REQUIRE(back.candidate.source == task.candidate.source);
    REQUIRE(back.seed == task.seed);
    REQUIRE(back.guess_from_to.has_value() == task.guess_from_to.has_value());
    if (task.guess_from_to) REQUIRE(back.guess_from_to->matrix() == task.guess_from_to->matrix());
    REQUIRE(back.guess_covariance == task.guess_covariance);
    REQUIRE(back.target.size() == task.target.size());
    for (std::size_t k = 0; k < task.target.size(); ++k) {
      REQUIRE(back.target[k].T_center_member.matrix() == task.target[k].T_center_member.matrix());
      REQUIRE(back.target[k].covariance == task.target[k].covariance);
    }
    REQUIRE_THROWS_AS(unpack_task(bytes.substr(0, rng.below(bytes.size()))), InputError);
    REQUIRE_THROWS_AS(unpack_task(bytes + "x"), InputError);

    const RegistrationResult result =
        testing::OracleRegistrar({{task.candidate.from, testing::random_pose(rng)},
                                  {task.candidate.to, testing::random_pose(rng)}})
            .compute(task);
    const std::string answer = pack_result(result);
    require_same(unpack_result(answer, task.candidate), result);
    REQUIRE_THROWS_AS(unpack_result(answer.substr(0, rng.below(answer.size())), task.candidate), InputError);
    constexpr std::size_t kCovariance = 36 * sizeof(double);
    REQUIRE(bytes.size() + answer.size() <= 1440 + (task.target.size() - 1) * kCovariance);
  }
}

TEST_CASE("messages: a result of every reason comes through, one that does not exist is refused",
          "[distributed]") {
  RegistrationResult result;
  for (const auto& [reason, name] : enum_names(RejectionReason{})) {
    CAPTURE(name);
    result.reason = reason;
    result.closure.reset();
    if (reason == RejectionReason::kNone) result.closure = LoopClosure{};
    REQUIRE(unpack_result(pack_result(result), result.candidate).reason == reason);
  }
  REQUIRE_FALSE(unpack_result(pack_result(result), result.candidate).incomplete);
  result.incomplete = true;
  REQUIRE(unpack_result(pack_result(result), result.candidate).incomplete);
  std::string unknown = pack_result(result);
  unknown[0] = static_cast<char>(enum_names(RejectionReason{}).size());
  REQUIRE_THROWS_AS(unpack_result(unknown, result.candidate), InputError);
}

TEST_CASE("replay: any number of ranks gives the same journal", "[distributed]") {
  const Mission mission = testing::two_circles();
  ReplayOptions config;
  config.prioritization.method = parse_method("full");
  config.batch = 20;
  config.prioritization.observability.min_sum = 0.0;
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
  const auto registrar = std::make_shared<testing::OracleRegistrar>(mission.ground_truth);
  const auto journal_of = [&](const BatchComputer& compute) {
    std::string journal;
    std::size_t outcomes = 0;
    ReplayHooks hooks;
    hooks.journal = [&](const std::string& line) { journal += line + "\n"; };
    hooks.outcome = [&](const RegistrationResult&) { ++outcomes; };
    hooks.compute = compute;
    ThreadPool pool(1);
    const ReplayResult result = MissionReplay(mission, config, {features, registrar}).run(pool, hooks);
    REQUIRE(outcomes == result.computed.size());
    REQUIRE(outcomes > 50);
    return journal;
  };
  const std::string alone = journal_of({});
  for (const int size : {1, 2, 4, 8}) {
    CAPTURE(size);
    const auto transports = local_transports(size);
    const std::string greeting = replay_greeting(mission, config);
    std::vector<std::thread> ranks;
    for (int rank = 1; rank < size; ++rank) {
      ranks.emplace_back([&, rank] {
        serve_registrations(*transports[static_cast<std::size_t>(rank)], greeting, *registrar);
      });
    }
    {
      const auto server = std::make_shared<WorkServer>(*transports[0], greeting);
      REQUIRE(journal_of(distributed_batches(server, registrar, 1)) == alone);
    }
    for (std::thread& rank : ranks) rank.join();
  }
  ReplayOptions other = config;
  other.engine.task.target_neighbours = 0;
  REQUIRE(replay_greeting(mission, other) != replay_greeting(mission, config));
}

}  // namespace loopwise::registration_test
