// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <atomic>
#include <memory>
#include <utility>
#include <variant>
#include <vector>

#include <catch2/catch.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/online/loop_closure_module.hpp>

#include "module_testing.hpp"

namespace loopwise::batch_size_test {
namespace {

using namespace testing;

/// Time passes only when a registration is computed.
class CountedClock final : public Clock {
 public:
  [[nodiscard]] double now() const override { return now_s_.load(); }
  void wait_until(double, const StopToken&) override {}
  void pass(double seconds) { now_s_ = now_s_ + seconds; }

 private:
  std::atomic<double> now_s_{0.0};
};

class SlowRegistrar final : public Registrar {
 public:
  SlowRegistrar(const Mission& mission, std::shared_ptr<CountedClock> clock, double seconds)
      : oracle_(mission.ground_truth), clock_(std::move(clock)), seconds_(seconds) {}
  [[nodiscard]] std::string_view name() const override { return "slow"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    clock_->pass(seconds_);
    return oracle_.compute(task);
  }

 private:
  OracleRegistrar oracle_;
  std::shared_ptr<CountedClock> clock_;
  double seconds_;
};

/// Sizes of the batches of a module with one thread whose registrations take this long.
std::vector<std::size_t> batches(double registration_s) {
  const Mission mission = two_circles(1, 40);
  const auto clock = std::make_shared<CountedClock>();
  ModuleParts parts;
  parts.clock = clock;
  parts.registrar = given(std::make_shared<SlowRegistrar>(mission, clock, registration_s));
  std::vector<std::size_t> sizes;
  parts.on_event = [&](const HandledEvent& handled) {
    if (const auto* choose = std::get_if<event::Choose>(&handled.event)) sizes.push_back(choose->count);
  };
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  options.threads = 1;
  options.batch = 10;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  std::vector<LoopCandidate> candidates;
  for (std::uint64_t i = 0; i < 40; ++i) {
    candidates.emplace_back();
    candidates.back().from = make_key('a', i);
    candidates.back().to = make_key('b', i);
    candidates.back().source = CandidateSource::kRadio;
  }
  REQUIRE(module.add_candidates(candidates));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().candidates.computed == 40);
  module.stop();
  return sizes;
}

TEST_CASE("module: batches of a slow registrar are small, so that results soon change the order",
          "[online][module]") {
  std::vector<std::size_t> slow = batches(0.5);
  REQUIRE(slow.size() >= 10);
  REQUIRE(slow.front() == 1);  // the time is not known yet
  REQUIRE(*std::max_element(slow.begin(), slow.end()) == 4);
  REQUIRE(std::count(slow.begin(), slow.end(), std::size_t{4}) >= 9);

  const std::vector<std::size_t> slowest = batches(60.0);
  REQUIRE(*std::max_element(slowest.begin(), slowest.end()) == 1);

  const std::vector<std::size_t> fast = batches(0.001);
  REQUIRE(fast.front() == 1);
  REQUIRE(*std::max_element(fast.begin(), fast.end()) == 10);
}

}  // namespace
}  // namespace loopwise::batch_size_test
