// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// User code that runs inside the module: callbacks, prioritisers, registrars, place databases.
#include <atomic>
#include <map>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <thread>

#include <loopwise/core/error.hpp>
#include <loopwise/features/place.hpp>

#include "module_testing.hpp"

namespace loopwise::inside_calls_test {

using testing::CallbackPrioritizer;
using testing::given;
using testing::key_frames;
using testing::module_options;
using testing::OracleRegistrar;
using testing::two_circles;
using testing::with_oracle;

TEST_CASE("module: candidates that a failing prioritiser was given count as pruned",
          "[online][module][error]") {
  class Mine final : public Prioritizer {
   public:
    [[nodiscard]] std::string_view name() const override { return "mine"; }
    std::vector<Refusal> add(const std::vector<LoopCandidate>&) override {
      throw std::runtime_error("not today");
    }
    void remove(const std::vector<CandidateId>&) override {}
    [[nodiscard]] std::vector<LoopCandidate> take(std::size_t) override { return {}; }
    [[nodiscard]] std::size_t size() const override { return 0; }
  };
  const Mission mission = two_circles(1, 12);
  ModuleParts parts = with_oracle(mission);
  parts.prioritizers.push_back(std::make_unique<Mine>());
  LoopClosureModule module(mission.robots, module_options(), {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  const ModuleStatistics statistics = module.statistics();
  REQUIRE(statistics.candidates.generated > 0);
  REQUIRE(statistics.candidates.pruned == statistics.candidates.generated);
  REQUIRE(statistics.last_problems.back() == "prioritisation: mine: add(): not today");
}

TEST_CASE("module: calls that would wait for themselves throw, the others are allowed inside",
          "[online][module][error]") {
  const Mission mission = two_circles(1, 12);
  LoopClosureModule* self = nullptr;
  std::mutex mutex;
  std::vector<std::string> thrown;
  const auto must_throw = [&](const std::function<void()>& call) {
    try {
      call();
    } catch (const Error& error) {
      const std::lock_guard<std::mutex> lock(mutex);
      thrown.emplace_back(error.what());
    }
  };
  const auto wait = [&] { static_cast<void>(self->wait()); };
  std::atomic<int> read{0};
  const auto read_all = [&] {
    static_cast<void>(self->graph());
    static_cast<void>(self->estimate());
    static_cast<void>(self->statistics());
    ++read;
  };
  ModuleCallbacks callbacks;
  callbacks.on_result = [&, once = false](const RegistrationResult&) mutable {
    if (std::exchange(once, true)) return;
    must_throw(wait);
    must_throw([&] { self->stop(); });
    must_throw([&] { self->finish(); });
    read_all();
  };
  /// Of a registration thread.
  class Waiting final : public Registrar {
   public:
    Waiting(std::map<Key, Eigen::Isometry3d> truth, std::function<void()> first)
        : oracle_(std::move(truth), 0.0, 0.0), first_(std::move(first)) {}
    [[nodiscard]] std::string_view name() const override { return "waiting"; }
    [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
      std::call_once(once_, first_);
      return oracle_.compute(task);
    }

   private:
    OracleRegistrar oracle_;
    std::function<void()> first_;
    mutable std::once_flag once_;
  };
  ModuleParts parts;
  parts.registrar = given(std::make_shared<Waiting>(mission.ground_truth, [&] {
    must_throw(wait);
    read_all();
  }));
  CallbackPrioritizer::Callbacks calls;
  calls.take = [&, once = false]() mutable {
    if (std::exchange(once, true)) return;
    must_throw(wait);
    read_all();
  };
  calls.scan = [&, once = false](Key) mutable {  // while the module's graph is locked for the others
    if (!std::exchange(once, true)) read_all();
  };
  parts.prioritizers.push_back(std::make_unique<CallbackPrioritizer>(calls));
  LoopClosureModule module(mission.robots, module_options(), callbacks, std::move(parts));
  self = &module;
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(read == 4);
  REQUIRE(thrown.size() == 5);
  for (const std::string& text : thrown) REQUIRE_THAT(text, Contains("call it from another thread"));
  REQUIRE(module.statistics().candidates.computed == module.statistics().candidates.generated);
  REQUIRE(module.statistics().problems == 0);
}

namespace {

/// Reports each place as the same as the first, or as one that it was not given.
class FirstPlace final : public PlaceDatabase {
 public:
  explicit FirstPlace(std::atomic<int>& described, std::optional<Key> unknown = {})
      : described_(described), unknown_(unknown) {}
  [[nodiscard]] std::string_view name() const override { return "first_place"; }
  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> describe(const PointCloud&) const override {
    struct Nothing final : PlaceDescriptor {
      [[nodiscard]] std::size_t bytes() const override { return 1; }
    };
    ++described_;
    return std::make_shared<Nothing>();
  }
  void insert(Key key, std::shared_ptr<const PlaceDescriptor> place) override {
    places_.emplace(key, std::move(place));
  }
  [[nodiscard]] std::vector<PlaceMatch> search(const PlaceDescriptor&, std::size_t,
                                               const PlaceFilter& filter) const override {
    std::vector<PlaceMatch> matches;
    for (const auto& [key, place] : places_) {
      if (filter && !filter(key)) continue;
      matches.emplace_back();
      matches.back().key = unknown_.value_or(key);
      matches.back().similarity = 1.0;
      break;
    }
    return matches;
  }
  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> find(Key key) const override {
    const auto found = places_.find(key);
    return found == places_.end() ? nullptr : found->second;
  }
  [[nodiscard]] std::size_t size() const override { return places_.size(); }

 private:
  std::atomic<int>& described_;
  std::optional<Key> unknown_;
  std::map<Key, std::shared_ptr<const PlaceDescriptor>> places_;
};

}  // namespace

TEST_CASE("module: threads that begin after its end may call it", "[online][module]") {
  // The system may give a new thread the identity of one that has ended.
  const Mission mission = two_circles(1, 12);
  LoopClosureModule module(mission.robots, module_options(), {}, with_oracle(mission));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  module.finish();
  std::atomic<int> failures{0};
  for (int i = 0; i < 8; ++i) {
    std::thread([&] {
      try {
        static_cast<void>(module.wait());
        module.stop();
      } catch (const Error&) {
        ++failures;
      }
    }).join();
  }
  REQUIRE(failures == 0);
}

TEST_CASE("module: a user's place database finds candidates", "[online][module][places]") {
  const Mission mission = two_circles(1, 12);
  std::atomic<int> described{0};
  ModuleParts parts = with_oracle(mission);
  parts.places = std::make_unique<FirstPlace>(described);
  std::mutex mutex;
  std::size_t by_appearance = 0;
  ModuleCallbacks callbacks;
  callbacks.on_result = [&](const RegistrationResult& result) {
    const std::lock_guard<std::mutex> lock(mutex);
    by_appearance += result.candidate.source == CandidateSource::kAppearance ? 1 : 0;
  };
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  REQUIRE_FALSE(options.appearance.enabled);  // giving the part is enough
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(described > 2);
  REQUIRE(by_appearance > 0);
}

TEST_CASE("module: a key that a place database was not given is a problem that names both",
          "[online][module][places][error]") {
  const Mission mission = two_circles(1, 12);
  std::atomic<int> described{0};
  ModuleParts parts = with_oracle(mission);
  parts.places = std::make_unique<FirstPlace>(described, make_key('a', 777));
  ModuleOptions options = module_options("baseline");
  options.engine.use_proximity = false;
  LoopClosureModule module(mission.robots, options, {}, std::move(parts));
  for (const KeyFrame& frame : key_frames(mission)) REQUIRE(module.add_key_frame(frame));
  REQUIRE(module.wait());
  REQUIRE(module.statistics().problems > 0);
  REQUIRE(module.statistics().last_problems.back() ==
          "place recognition: place database \"first_place\" returned key a777, which was not added to it");
}

}  // namespace loopwise::inside_calls_test
