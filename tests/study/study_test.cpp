// SPDX-License-Identifier: BSD-3-Clause
// Studies as functions: their results and the files in their folder.
#include <loopwise/study/study.hpp>

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/study/registration.hpp>

#include "apps/small_mission.hpp"
#include "testing.hpp"

namespace loopwise::study::study_test {
namespace {

using testing::small_mission;
using testing::TemporaryFolder;

/// One small mission, replayed quickly.
StudyOptions small_study(const TemporaryFolder& folder, const std::string& name) {
  const auto path = folder / "yard";
  if (!testing::fs::exists(path)) write_mission(path, small_mission(8));
  StudyOptions options;
  options.missions = {{path.string(), {}}};
  options.folder = folder / name;
  options.threads = 1;
  options.config.replay.engine.generation.skip_recent = 2;
  options.config.replay.batch = 5;
  options.config.replay.cost.registration_time_s = 2.0;
  options.config.replay.cost.workers = 2;
  return options;
}

struct RecordedHooks {
  std::vector<std::string> notes;
  std::size_t progress = 0, computed = 0;
  StudyHooks hooks;

  RecordedHooks() {
    hooks.note = [this](const std::string& text) { notes.push_back(text); };
    hooks.progress = [this](const Progress&) { ++progress; };
    hooks.outcomes = [this](const OutcomeStoreStatistics& s) { computed = s.computed; };
  }
};

std::size_t lines_of(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

}  // namespace

TEST_CASE("study: a function returns its tables, and uses finished runs again", "[study]") {
  const TemporaryFolder folder;
  const StudyOptions options = small_study(folder, "ablation");
  AblationOptions wanted;
  wanted.methods = {"baseline", "random"};
  RecordedHooks first;
  const auto report = ablation(options, wanted, first.hooks);
  REQUIRE(report);
  REQUIRE(lines_of(report->csv) == 1 + 2);
  const Json json = parse_json(report->json, "report");
  REQUIRE(json["methods"] == Json({"odom", "baseline", "random"}));
  REQUIRE(json["worlds"][0]["methods"]["baseline"]["ate_m"]["count"] == 1);
  CHECK_THAT(report->markdown, Contains("# Ablation") && Contains("| ATE, m |"));
  CHECK(first.progress > 0);
  CHECK(first.computed > 0);
  REQUIRE(testing::fs::exists(options.folder / "ablation_timings.csv"));

  RecordedHooks again;
  const auto same = ablation(options, wanted, again.hooks);
  REQUIRE(same);
  REQUIRE(same->json == report->json);
  REQUIRE(same->csv == report->csv);
  REQUIRE(same->markdown == report->markdown);
  REQUIRE(again.notes.size() == 1);
  CHECK_THAT(again.notes.front(), Contains("2 of 2 runs are finished already"));
}

TEST_CASE("study: budget and rssi as functions", "[study]") {
  const TemporaryFolder folder;
  BudgetOptions budgets;
  budgets.methods = {"baseline"};
  budgets.workers = {2};
  const auto curves = budget(small_study(folder, "budget"), budgets);
  REQUIRE(curves);
  REQUIRE(parse_json(curves->json, "budget")["worlds"][0]["at_end"].size() == 2);
  CHECK_THAT(curves->markdown, Contains("everything computed"));

  RssiOptions robots;
  robots.methods = {"baseline"};
  RecordedHooks recorded;
  std::vector<std::string> warnings;
  recorded.hooks.warn = [&](const std::string& text) { warnings.push_back(text); };
  const auto table = rssi(small_study(folder, "rssi"), robots, recorded.hooks);
  REQUIRE(table);
  REQUIRE(lines_of(table->csv) == 1 + 2 * 2);  // two robots by odometry and by the method
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings.front(), Contains("no radio readings"));
}

TEST_CASE("study: a stopped study returns no tables; errors name the bad option", "[study][error]") {
  const TemporaryFolder folder;
  const StudyOptions options = small_study(folder, "stopped");
  StopSource stop;
  stop.request_stop();
  RecordedHooks recorded;
  recorded.hooks.stop = stop.token();
  REQUIRE_FALSE(ablation(options, {}, recorded.hooks));
  REQUIRE(recorded.notes.size() == 1);
  CHECK_THAT(recorded.notes.front(), Contains("interrupted: 0 of 5 runs are kept"));

  AblationOptions twice;
  twice.methods = {"full", "gi+obs"};
  REQUIRE_THROWS_WITH(ablation(options, twice), Contains("twice"));
  BudgetOptions none;
  none.workers.clear();
  REQUIRE_THROWS_AS(budget(options, none), OptionError);
}

TEST_CASE("study: registrars are judged by a function", "[study]") {
  const Mission mission = small_mission(8);
  RegistrationStudyOptions options;
  options.registrars = {RegistrarKind::kFast};
  options.count = 12;
  options.threads = 1;
  const auto study = study_registration(mission, ReplayOptions(), options);
  REQUIRE(study);
  REQUIRE(study->pairs.size() == std::min<std::size_t>(12, study->generated));
  REQUIRE(study->registrars.size() == 1);
  REQUIRE(study->registrars[0].outcomes.size() == study->pairs.size());
  const RegistrationReport report = report_registration(*study, "yard", 1, 0.5);
  REQUIRE(lines_of(report.csv) == 1 + study->pairs.size());
  REQUIRE(parse_json(report.json, "report")["registrars"]["fast"]["pairs"] == study->pairs.size());
}

TEST_CASE("study: with the true pose as guess, drift of odometry excludes no closure", "[study]") {
  const Mission mission = small_mission(8);
  ReplayOptions replay;
  replay.registration.fast.tests.max_translation_m = 0.1;
  RegistrationStudyOptions options;
  options.registrars = {RegistrarKind::kFast};
  options.threads = 1;
  const auto accepted = [&] {
    const auto study = study_registration(mission, replay, options);
    const std::vector<PairOutcome>& outcomes = study.value().registrars.at(0).outcomes;
    return std::count_if(outcomes.begin(), outcomes.end(), [](const PairOutcome& o) { return o.accepted; });
  };
  const auto by_odometry = accepted();
  options.true_guess = true;
  const auto by_truth = accepted();
  CAPTURE(by_odometry, by_truth);
  REQUIRE(by_truth > 3 * by_odometry);  // measured 7 and 1
}

}  // namespace loopwise::study::study_test
