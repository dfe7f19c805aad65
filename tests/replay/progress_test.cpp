// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <vector>

#include <loopwise/replay/replay.hpp>

#include "testing_mission.hpp"

namespace loopwise::progress_test {
namespace {

struct Shown {
  ReplayResult result;
  std::vector<Progress> progress;
};

Shown replayed(const ReplayOptions& options) {
  const Mission mission = testing::two_circles();
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features);
  const auto registrar = std::make_shared<testing::OracleRegistrar>(mission.ground_truth);
  Shown shown;
  ReplayHooks hooks;
  hooks.progress = [&](const Progress& progress) { shown.progress.push_back(progress); };
  ThreadPool pool(1);
  shown.result = MissionReplay(mission, options, {features, registrar}).run(pool, hooks);
  return shown;
}

}  // namespace

TEST_CASE("replay: progress counts the candidates that fit into the time", "[replay][progress]") {
  ReplayOptions options;
  options.prioritization.method = parse_method("random");
  options.batch = 20;
  options.cost.workers = 2;
  options.cost.registration_time_s = 1.3;
  const Shown shown = replayed(options);
  const CandidateAccounting& account = shown.result.accounting;
  REQUIRE(account.pending > 3 * account.computed);  // far more than there is time for
  REQUIRE(account.computed > 50);
  std::size_t largest = 0;
  for (const Progress& progress : shown.progress) largest = std::max(largest, progress.total);
  CAPTURE(largest, account.computed);
  REQUIRE(largest <= account.computed + 4);  // two turns of the workers
  REQUIRE(shown.progress.back().done == account.computed);

  // Refusals that take less time leave time for more.
  options.cost.refused_time_share = 0.1;
  const Shown cheap = replayed(options);
  for (const Progress& progress : cheap.progress) {
    if (2 * progress.done < cheap.result.accounting.computed) continue;  // few candidates are there yet
    REQUIRE(progress.total >= cheap.result.accounting.computed);
  }
  options.cost.refused_time_share = 1.0;

  // After the mission there is time for all.
  options.after_mission = true;
  const Shown whole = replayed(options);
  REQUIRE(whole.progress.back().total == whole.result.accounting.computed);
  REQUIRE(whole.progress.back().done == whole.result.accounting.computed);
}

}  // namespace loopwise::progress_test
