// SPDX-License-Identifier: BSD-3-Clause
#include "scheduler.hpp"

#include <algorithm>
#include <exception>
#include <map>
#include <mutex>
#include <thread>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/work.hpp>
#endif
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/output_folder.hpp>
#include <loopwise/replay/code_version.hpp>

namespace loopwise::study {
namespace {

namespace fs = std::filesystem;

/// Missions while units need them: the first unit reads them, the last one releases them.
class LoadedMissions {
 public:
  LoadedMissions(const std::vector<StudyMission>& missions, const Config& config,
                 std::shared_ptr<OutcomeStore> store)
      : missions_(missions), config_(config), store_(std::move(store)), slots_(missions.size()) {}

  void expect(std::size_t mission) { ++slots_[mission].expected; }
  std::shared_ptr<const LoadedMission> get(std::size_t mission) {
    Slot& slot = slots_[mission];
    const std::lock_guard<std::mutex> lock(slot.mutex);
    if (!slot.loaded) slot.loaded = load(missions_[mission], config_, store_);
    std::shared_ptr<const LoadedMission> loaded = slot.loaded;
    if (--slot.expected == 0) slot.loaded.reset();
    return loaded;
  }

 private:
  struct Slot {
    std::mutex mutex;
    std::size_t expected = 0;
    std::shared_ptr<const LoadedMission> loaded;
  };
  const std::vector<StudyMission>& missions_;
  const Config& config_;
  std::shared_ptr<OutcomeStore> store_;
  std::vector<Slot> slots_;
};

std::string name_of(const StudyMission& mission, const StudyUnit& unit) {
  return mission.name + " " + unit.label;
}

}  // namespace

Config study_config() {
  Config config;
  config.replay.engine.guess = GuessSource::kOdometry;
  return config;
}

bool serves(const StudyOptions& options) {
#ifdef LOOPWISE_HAS_MPI
  return options.job != nullptr && options.job->rank() > 0;
#else
  static_cast<void>(options);
  return false;
#endif
}

Study::Study(std::string name, const StudyOptions& options, const StudyHooks& hooks)
    : name_(std::move(name)), options_(options), hooks_(hooks) {
  validate_config(config());
  std::map<ContentHash, std::string> seen;
  for (const StudySource& source : options.missions) {
    Mission mission = read_mission(source.path, config().mission, hooks.progress);
    set_truth(mission, source.truth, config().mission);
    for (const Problem& problem : mission.problems.all()) warn(to_string(problem));
    require_truth(source.path, mission);
    missions_.push_back(describe(source, mission));
    const auto [other, first] = seen.emplace(missions_.back().content, source.path);
    if (!first) throw OptionError(source.path + ": the same mission as " + other->second);
  }
  if (serves(options)) return;  // the first rank makes the folder
  prepare_output_folder(folder(), options.resume || fs::is_directory(folder() / "units"),
                        ", and no study is in it");
  for (const char* part : {"units", "runs"}) {
    std::error_code failure;
    if (std::string(part) == "runs" && !options.keep_runs) continue;
    fs::create_directories(folder() / part, failure);
    if (failure) throw IoError((folder() / part).string(), failure.message());
  }
}

void Study::note(const std::string& text) const {
  if (hooks_.note) hooks_.note(text);
}

void Study::warn(const std::string& text) const {
  if (hooks_.warn) hooks_.warn(text);
}

void Study::show(std::size_t done, std::size_t total, const std::string& detail) const {
  if (hooks_.progress) hooks_.progress({"runs", done, total, detail});
}

std::vector<std::uint64_t> Study::seeds() const {
  std::vector<std::uint64_t> seeds;
  for (std::int64_t i = 0; i < options_.seeds; ++i) {
    seeds.push_back(config().replay.engine.seed + static_cast<std::uint64_t>(i));
  }
  return seeds;
}

/// The units to compute, and the destination of their results.
struct Study::Open {
  const std::vector<StudyUnit>& units;
  const std::vector<std::size_t>& numbers;  ///< Of the units that are not finished, mission by mission.
  const std::vector<UnitFiles>& files;      ///< Of all units.
  std::vector<std::optional<UnitResult>>& results;
  std::shared_ptr<OutcomeStore> store;
};

std::shared_ptr<OutcomeStore> Study::open_outcomes() const {
  const fs::path outcomes = options_.outcomes.empty() ? folder() / "outcomes" : options_.outcomes;
  return std::make_shared<OutcomeStore>(outcomes, options_.outcomes_bound);
}

void Study::run_here(const Open& open, const StopToken& stop) {
  LoadedMissions loaded(missions_, config(), open.store);
  for (const std::size_t i : open.numbers) loaded.expect(open.units[i].mission);
  std::mutex mutex;                       // of all below
  std::map<std::size_t, Problems> flaws;  // of each mission's scans, so far
  std::size_t next = 0, done = open.units.size() - open.numbers.size();
  std::exception_ptr failure;
  StopSource failed;
  const auto stopped = [&] { return stop.stop_requested() || failed.stop_requested(); };
  const auto work = [&] {
    while (!stopped()) {
      std::size_t i = 0;
      {
        const std::lock_guard<std::mutex> lock(mutex);
        if (next == open.numbers.size()) return;
        i = open.numbers[next++];
      }
      const StudyUnit& unit = open.units[i];
      const StudyMission& mission = missions_[unit.mission];
      const std::string name = name_of(mission, unit);
      try {
        const std::shared_ptr<const LoadedMission> own = loaded.get(unit.mission);
        const auto computed =
            compute(*own, mission, unit, open.files[i], options_.keep_runs, stop, [&](const Progress& p) {
              const std::lock_guard<std::mutex> lock(mutex);
              show(done, open.units.size(), name + ": " + std::to_string(p.done) + " registrations");
            });
        const std::lock_guard<std::mutex> lock(mutex);
        if (!computed) return;
        open.results[i] = keep(*computed, open.files[i]);
        flaws[unit.mission] = own->mission.scans->problems();
        for (const std::string& why : computed->not_repeatable)
          warn(name + ": not kept for the next time: " + why);
        ++done;
        show(done, open.units.size(), name + " finished");
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex);
        if (!failure) {
          failure = std::current_exception();
          note(name + " failed: no more runs are begun");
        }
        failed.request_stop();
      }
    }
  };
  std::vector<std::thread> threads;
  const int count = std::min(resolve_threads(options_.threads), static_cast<int>(open.numbers.size()));
  try {
    for (int t = 1; t < count; ++t) threads.emplace_back(work);
  } catch (const std::exception& error) {  // the existing threads do all
    const std::lock_guard<std::mutex> lock(mutex);
    warn(std::string("no more threads: ") + error.what());
  }
  work();
  for (std::thread& thread : threads) thread.join();
  for (const auto& [mission, problems] : flaws) {
    for (const Problem& problem : problems.all()) warn(missions_[mission].name + ": " + to_string(problem));
  }
  if (failure) std::rethrow_exception(failure);
}

#ifdef LOOPWISE_HAS_MPI
std::string Study::greeting(const std::vector<StudyUnit>& units) const {
  ContentHasher hasher;
  for (const StudyMission& mission : missions_)
    hasher.integer(mission.content.high).integer(mission.content.low);
  for (const StudyUnit& unit : units) {
    hasher.integer(unit.mission).text(config_key(unit.config)).integer(unit.map_quality ? 1 : 0);
  }
  return "study " + replay_code_version() + " " + to_string(hasher.finish());
}

void Study::run_on_ranks(const Open& open, const StopToken& stop) {
  std::vector<Work> work;
  for (const std::size_t i : open.numbers) {
    work.push_back({std::to_string(i), open.units[i].mission});
  }
  WorkOptions limits;
  limits.time_limit_s = options_.rank_time_limit_s;
  limits.ahead = 1;  // a rank that waits briefly costs less than a run that waits for a rank
  WorkServer server(*options_.job, greeting(open.units), limits);
  std::mutex mutex;  // of all below
  std::map<std::size_t, std::shared_ptr<const LoadedMission>> loaded;
  std::size_t done = open.units.size() - open.numbers.size();
  const auto take = [&](std::size_t i, const ComputedUnit& computed, int rank) {
    const std::lock_guard<std::mutex> lock(mutex);
    open.results[i] = keep(computed, open.files[i]);
    const std::string name = name_of(missions_[open.units[i].mission], open.units[i]);
    for (const std::string& why : computed.not_repeatable)
      warn(name + ": not kept for the next time: " + why);
    ++done;
    show(done, open.units.size(), name + " finished by rank " + std::to_string(rank));
  };
  const auto here = [&](std::size_t k) {
    const std::size_t i = open.numbers[k], m = open.units[i].mission;
    std::shared_ptr<const LoadedMission> own;
    {
      const std::lock_guard<std::mutex> lock(mutex);
      if (loaded.count(m) == 0) loaded = {{m, load(missions_[m], config(), open.store)}};
      own = loaded.at(m);
    }
    const auto computed =
        compute(*own, missions_[m], open.units[i], open.files[i], options_.keep_runs, stop, {});
    if (computed) take(i, *computed, 0);
  };
  const auto there = [&](int rank, std::size_t k, std::string_view answer) {
    if (answer.empty()) return;  // interrupted
    const Json json = parse_json(answer, "answer of rank " + std::to_string(rank));
    take(open.numbers[k],
         {json.at("unit"), json.at("seconds").get<double>(),
          json.at("not_repeatable").get<std::vector<std::string>>()},
         rank);
  };
  const int threads = options_.threads > 0 ? options_.threads : 1;
  server.run(work, threads, here, there, stop);
}

void Study::serve(const std::vector<StudyUnit>& units, const StopToken& stop) {
  std::pair<std::size_t, std::shared_ptr<const LoadedMission>> last;
  std::shared_ptr<OutcomeStore> store;
  serve_work(*options_.job, greeting(units), [&](std::string_view request) {
    // Only now, because it is in the folder that rank 0 checks first.
    if (!store) store = open_outcomes();
    const std::size_t i = std::stoul(std::string(request));
    const StudyUnit& unit = units.at(i);
    if (!last.second || last.first != unit.mission) {
      last = {unit.mission, load(missions_[unit.mission], config(), store)};
    }
    const auto computed =
        compute(*last.second, missions_[unit.mission], unit,
                files_of(folder(), missions_[unit.mission], unit), options_.keep_runs, stop, {});
    if (!computed) return std::string();  // interrupted
    Json answer = Json::object();
    answer["seconds"] = computed->seconds;
    answer["not_repeatable"] = computed->not_repeatable;
    answer["unit"] = computed->json;
    return json_text(answer);
  });
}
#else
void Study::run_on_ranks(const Open&, const StopToken&) {}
void Study::serve(const std::vector<StudyUnit>&, const StopToken&) {}
#endif

std::optional<std::vector<UnitResult>> Study::run(const std::vector<StudyUnit>& units) {
  const StopToken& stop = hooks_.stop;
  std::vector<UnitFiles> files;
  std::vector<std::optional<UnitResult>> results(units.size());
  std::vector<std::size_t> open;
  for (std::size_t i = 0; i < units.size(); ++i) {
    const StudyUnit& unit = units[i];
    validate_config(unit.config);
    files.push_back(files_of(folder(), missions_[unit.mission], unit));
    results[i] = finished(unit, files[i], options_.keep_runs);
    if (!results[i]) open.push_back(i);
  }
  if (open.size() < units.size()) {
    note(std::to_string(units.size() - open.size()) + " of " + std::to_string(units.size()) +
         " runs are finished already");
  }

  if (serves(options_)) {
    serve(units, stop);
    return std::nullopt;
  }
  // Other ranks wait for their end, even if all units are finished.
  if (!open.empty() || options_.job != nullptr) {
    // One mission after the other: memory holds only the needed ones, and units of a mission share its pairs.
    std::stable_sort(open.begin(), open.end(),
                     [&](std::size_t a, std::size_t b) { return units[a].mission < units[b].mission; });
    const Open work{units, open, files, results, open_outcomes()};
    options_.job != nullptr ? run_on_ranks(work, stop) : run_here(work, stop);
    if (hooks_.outcomes) hooks_.outcomes(work.store->statistics());
    if (stop.stop_requested()) {
      const auto done =
          std::count_if(results.begin(), results.end(), [](const auto& r) { return r.has_value(); });
      note("interrupted: " + std::to_string(done) + " of " + std::to_string(units.size()) +
           " runs are kept; the same command goes on");
      return std::nullopt;
    }
  }

  CsvText timings({"mission", "run", "seed", "seconds"});
  std::vector<UnitResult> all;
  for (std::size_t i = 0; i < units.size(); ++i) {
    all.push_back(*std::move(results[i]));
    const std::string seconds = fs::exists(files[i].seconds) ? read_file(files[i].seconds) : "";
    timings.row(missions_[units[i].mission].name, units[i].label, units[i].config.replay.engine.seed,
                seconds.substr(0, seconds.find('\n')));
  }
  write_file(folder() / (name_ + "_timings.csv"), timings.text());
  return all;
}

std::vector<StudyUnit> units_by_method(const Study& study, const std::vector<std::string>& methods,
                                       std::optional<std::int64_t> workers) {
  std::vector<StudyUnit> units;
  for (std::size_t m = 0; m < study.missions().size(); ++m) {
    for (const std::uint64_t seed : study.seeds()) {
      for (const std::string& method : methods) {
        StudyUnit unit{m, method, study.config()};
        unit.config.replay.prioritization.method = parse_method(method);
        unit.config.replay.engine.seed = seed;
        if (workers) unit.config.replay.cost.workers = *workers;
        units.push_back(unit);
      }
    }
  }
  return units;
}

Json study_json(const Study& study) {
  Json json = Json::object();
  Json missions = Json::array();
  for (const StudyMission& m : study.missions()) {
    missions.push_back({{"name", m.name},
                        {"world", m.world},
                        {"seed", m.seed},
                        {"parameters_sha256", m.parameters_sha256},
                        {"content", to_string(m.content)}});
  }
  json["missions"] = missions;
  json["seeds"] = study.seeds();
  json["code"] = replay_code_version();
  json["options"] = parse_json(config_json(study.config()), "options");
  return json;
}

}  // namespace loopwise::study
