// SPDX-License-Identifier: BSD-3-Clause
#include "study_units.hpp"

#include <algorithm>
#include <exception>
#include <fstream>
#include <map>
#include <mutex>
#include <thread>

#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_history.hpp>
#ifdef LOOPWISE_HAS_MPI
#include <loopwise/distributed/work.hpp>
#endif
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/replay.hpp>

#include "outcome_file.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

constexpr double kNear_m = 0.5, kNear_rad = 3.0 * 0.017453292519943295;
constexpr double kMapVoxel_m = 0.2;

ContentHash hash_of_files(const fs::path& path) {
  std::vector<fs::path> files;
  if (fs::is_directory(path)) {
    // Scans are often a link to another disk.
    for (const auto& entry :
         fs::recursive_directory_iterator(path, fs::directory_options::follow_directory_symlink)) {
      if (entry.is_regular_file()) files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
  } else {
    files.push_back(path);
  }
  ContentHasher hasher;
  std::string piece(1 << 20, '\0');
  for (const fs::path& file : files) {
    hasher.text(file == path ? "" : fs::relative(file, path).generic_string());
    // In pieces: a bag may be larger than the memory.
    hasher.integer(fs::file_size(file));
    std::ifstream in(file, std::ios::binary);
    while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())) || in.gcount() > 0) {
      hasher.bytes(piece.data(), static_cast<std::size_t>(in.gcount()));
    }
    if (!in.eof()) throw IoError(file.string(), "cannot be read");
  }
  return hasher.finish();
}

std::string text_at(const Json& json, const char* key) {
  if (!json.contains(key)) return {};
  return json[key].is_string() ? json[key].get<std::string>() : json[key].dump();
}

StudyMission described(const std::string& path, const std::vector<std::string>& truth,
                       const Mission& mission) {
  StudyMission out;
  out.path = path;
  out.truth = truth;
  out.name = mission.name;
  const Json provenance = parse_json(mission.provenance_json, path + ": provenance");
  if (provenance.contains("options")) out.world = text_at(provenance["options"], "world");
  if (out.world.empty()) out.world = mission.name;
  out.seed = text_at(provenance, "seed");
  out.has_radio = !mission.radio.empty();
  out.truth_is_aligned = mission.truth_is_aligned;
  out.parameters_sha256 = text_at(provenance, "parameters_sha256");
  out.content = hash_of_files(fs::is_regular_file(path) && fs::path(path).filename() == "mission.json"
                                  ? fs::path(path).parent_path()
                                  : fs::path(path));
  for (const std::string& given : truth) {
    // "ROBOT=FILE" as set_truth() reads it: whose poses they are counts, not where the file lies.
    const std::size_t at = fs::exists(given) ? std::string::npos : given.find('=');
    const ContentHash of_file = hash_of_files(at == std::string::npos ? given : given.substr(at + 1));
    out.content = ContentHasher()
                      .integer(out.content.high)
                      .integer(out.content.low)
                      .text(at == std::string::npos ? "" : given.substr(0, at))
                      .integer(of_file.high)
                      .integer(of_file.low)
                      .finish();
  }
  return out;
}

/// A mission in memory with what its units share.
struct Loaded {
  Mission mission;
  Registration registration;
};

std::shared_ptr<const Loaded> load(const StudyMission& mission, const Config& config,
                                   const std::shared_ptr<OutcomeStore>& store) {
  auto loaded = std::make_shared<Loaded>();
  loaded->mission = read_mission(mission.path, config.mission);
  set_truth(loaded->mission, mission.truth, config.mission);
  loaded->registration =
      make_registration(config.replay.registration, loaded->mission.scans->loader(), store);
  return loaded;
}

/// Missions while units need them: read by the first, let go after the last.
class LoadedMissions {
 public:
  LoadedMissions(const std::vector<StudyMission>& missions, const Config& config,
                 std::shared_ptr<OutcomeStore> store)
      : missions_(missions), config_(config), store_(std::move(store)), slots_(missions.size()) {}

  void expect(std::size_t mission) { ++slots_[mission].expected; }
  std::shared_ptr<const Loaded> get(std::size_t mission) {
    Slot& slot = slots_[mission];
    const std::lock_guard<std::mutex> lock(slot.mutex);
    if (!slot.loaded) slot.loaded = load(missions_[mission], config_, store_);
    std::shared_ptr<const Loaded> loaded = slot.loaded;
    if (--slot.expected == 0) slot.loaded.reset();
    return loaded;
  }

 private:
  struct Slot {
    std::mutex mutex;
    std::size_t expected = 0;
    std::shared_ptr<const Loaded> loaded;
  };
  const std::vector<StudyMission>& missions_;
  const Config& config_;
  std::shared_ptr<OutcomeStore> store_;
  std::vector<Slot> slots_;
};

Json unit_json(const StudyMission& about, const Mission& mission, const ReplayOptions& options,
               const ReplayResult& result, const RunHistory& history) {
  const RunEvaluation evaluation = evaluate_run(mission, result);
  Json summary = parse_json(run_summary_json(mission, options, result, evaluation), "summary");
  summary.erase("seconds");
  // Scans are read by all units of a mission: which of them meets a flaw first is chance.
  summary.erase("problems");
  std::vector<RegistrationResult> results;
  std::vector<double> weights;
  for (const ComputedCandidate& computed : result.computed) {
    results.push_back(computed.result);
    weights.push_back(computed.weight);
  }
  ClosureClassOptions near;
  near.true_inlier_m = kNear_m;
  near.true_inlier_rad = kNear_rad;
  const ClosureStatistics of_near =
      closure_statistics(results, weights, result.accounting.queued(), mission.ground_truth, near);
  summary["closures"]["right_inliers"] = evaluation.closures.right_inliers;
  summary["closures"]["near_inliers"] = of_near.true_inliers;
  return unit_file_json({{"name", about.name},
                         {"world", about.world},
                         {"seed", about.seed},
                         {"parameters_sha256", about.parameters_sha256},
                         {"content", to_string(about.content)}},
                        std::move(summary), history.rows());
}

Config study_defaults() {
  Config config;
  config.replay.engine.guess = GuessSource::kOdometry;
  return config;
}

/// Nothing if it was not finished, or the file is broken.
std::optional<UnitResult> finished(const UnitFiles& files, bool with_run) {
  if (with_run && !fs::exists(files.run / "summary.json")) return std::nullopt;
  try {
    return parse_unit_file(read_json_file(files.result), files.result.string());
  } catch (const IoError&) {
  } catch (const InputError&) {
  }
  return std::nullopt;
}

std::string plain(std::string text) {
  for (char& c : text) {
    const bool fine = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                      c == '-' || c == '+' || c == '.';
    if (!fine) c = '_';
  }
  return text;
}

/// A unit that was computed, as it is kept and sent.
struct ComputedUnit {
  Json json;
  double seconds = 0.0;
  /// What circumstances have spoilt, see depends_on_circumstances(): scans that could not be read,
  /// registrations that failed. Nothing, usually.
  std::vector<std::string> spoilt;
};

/// What circumstances have spoilt goes into this study's tables and is said, but the next one computes it
/// again.
UnitResult keep(const ComputedUnit& unit, const UnitFiles& files) {
  const std::string text = json_text(unit.json);
  if (unit.spoilt.empty()) {
    write_file(files.seconds, Json(unit.seconds).dump() + "\n");
    write_file(files.result, text + "\n");
  }
  // As it will be read the next time.
  const std::string name = files.result.string();
  return parse_unit_file(parse_json(text, name), name);
}

/// Computes one unit. Nothing if it was stopped.
std::optional<ComputedUnit> compute(const Loaded& loaded, const StudyMission& about, const StudyUnit& unit,
                                    const UnitFiles& files, bool keep_run, const StopToken& stop,
                                    const ProgressCallback& progress) {
  const Stopwatch watch;
  RunHistory history(loaded.mission);
  ReplayHooks hooks;
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.stop = stop;
  hooks.progress = progress;
  std::ofstream journal;
  if (keep_run) {
    fs::create_directories(files.run);
    fs::remove(files.run / "summary.json");
    journal.open(files.run / "journal.jsonl", std::ios::binary | std::ios::trunc);
    hooks.journal = [&](const std::string& line) { journal << line << "\n"; };
  }
  ThreadPool one(1);
  ReplayResult result =
      MissionReplay(loaded.mission, unit.config.replay, loaded.registration).run(one, hooks);
  if (result.interrupted) return std::nullopt;
  if (keep_run) {
    finish_log(journal, files.run / "journal.jsonl");
    const StitchedMap map = stitch_map(result.graph, *loaded.mission.scans, kMapVoxel_m, stop, {},
                                       unit.config.replay.registration.features.max_range_m);
    if (stop.stop_requested()) return std::nullopt;
    result.problems.add(map.problems);
    add_scan_problems(result, *loaded.mission.scans);
    write_run_folder(files.run, loaded.mission, unit.config.replay, result,
                     evaluate_run(loaded.mission, result), history.rows(), map.cloud);
  }
  ComputedUnit computed{unit_json(about, loaded.mission, unit.config.replay, result, history), 0.0, {}};
  for (const Problem& problem : result.problems.all()) {
    for (const char* kind : {"scan cannot be read", "neighbour's scan cannot be read", "registration failed",
                             "registration reached its time limit"}) {
      if (problem.kind == kind) computed.spoilt.push_back(to_string(problem));
    }
  }
  computed.seconds = watch.seconds();
  return computed;
}

}  // namespace

void add_study_options(CLI::App& command, StudyOptions& options) {
  command
      .add_option("missions", options.missions,
                  "Missions with ground truth, own or given by --truth; those of one world are repetitions")
      ->required()
      ->type_name("MISSION");
  command.add_option("-o,--output", options.output, "Folder for the tables, the units and what they share")
      ->required()
      ->type_name("DIR")
      ->check(not_standard_output());
  command
      .add_option("--seeds", options.seeds,
                  "Replay each mission with this many seeds, from --seed on (default 1)")
      ->type_name("N")
      ->check(CLI::Range(1, 100000));
  add_truth_option(command, options.truth);
  add_replay_arguments(command, options.replay);
  command.add_flag("--keep-runs", options.keep_runs,
                   "Keep each run's folder, as replay writes it, in DIR/runs");
  command.add_flag("--resume", options.resume,
                   "Go on in DIR; what is finished there is never computed again anyway");
  add_key_frame_options(command, options.common);
  add_common_options(command, options.common);
}

Study::Study(std::string name, const StudyOptions& options, Console& console)
    : name_(std::move(name)),
      options_(options),
      console_(console),
      config_(load_config(options.common, study_defaults())),
      folder_(options.output) {
  apply(options.replay, config_);
  validate_config(config_);
  std::map<ContentHash, std::string> seen;
  for (std::size_t i = 0; i < options.missions.size(); ++i) {
    const std::string& path = options.missions[i];
    const auto truth = truth_of_mission(options.truth, i, options.missions.size());
    Mission mission = read_mission(path, config_.mission, console.progress_callback());
    set_truth(mission, truth, config_.mission);
    console.warn(mission.problems);
    require_truth(path, mission);
    missions_.push_back(described(path, truth, mission));
    const auto [other, first] = seen.emplace(missions_.back().content, path);
    if (!first) throw OptionError(path + ": the same mission as " + other->second);
  }
  if (serves()) return;  // the first rank makes the folder
  prepare_output_folder(folder_, options.resume || fs::is_directory(folder_ / "units"),
                        ", and no study is in it");
  for (const char* part : {"units", "runs"}) {
    std::error_code failure;
    if (std::string(part) == "runs" && !options.keep_runs) continue;
    fs::create_directories(folder_ / part, failure);
    if (failure) throw IoError((folder_ / part).string(), failure.message());
  }
}

std::vector<std::uint64_t> Study::seeds() const {
  std::vector<std::uint64_t> seeds;
  for (std::int64_t i = 0; i < options_.seeds; ++i) {
    seeds.push_back(config_.replay.engine.seed + static_cast<std::uint64_t>(i));
  }
  return seeds;
}

/// What is left to compute, and where it goes.
struct Study::Open {
  const std::vector<StudyUnit>& units;
  const std::vector<std::size_t>& numbers;  ///< Of the units that are not finished, mission by mission.
  const std::vector<UnitFiles>& files;      ///< Of all units.
  std::vector<std::optional<UnitResult>>& results;
  std::shared_ptr<OutcomeStore> store;
};

std::shared_ptr<OutcomeStore> Study::open_outcomes() const {
  const fs::path outcomes =
      options_.replay.outcomes.empty() ? folder_ / "outcomes" : fs::path(options_.replay.outcomes);
  return std::make_shared<OutcomeStore>(outcomes, options_.replay.outcomes_bound);
}

void Study::run_here(const Open& open, const StopToken& stop) {
  LoadedMissions loaded(missions_, config_, open.store);
  for (const std::size_t i : open.numbers) loaded.expect(open.units[i].mission);
  std::mutex mutex;                       // of all below
  std::map<std::size_t, Problems> flaws;  // of each mission's scans, by now
  std::size_t next = 0, done = open.units.size() - open.numbers.size();
  std::exception_ptr failure;
  StopSource failed;
  const auto show = [&](const std::string& detail) {
    console_.progress({"runs", done, open.units.size(), detail});
  };
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
      const std::string name = mission.name + " " + unit.label;
      try {
        const std::shared_ptr<const Loaded> own = loaded.get(unit.mission);
        const auto computed =
            compute(*own, mission, unit, open.files[i], options_.keep_runs, stop, [&](const Progress& p) {
              const std::lock_guard<std::mutex> lock(mutex);
              show(name + ": " + std::to_string(p.done) + " registrations");
            });
        const std::lock_guard<std::mutex> lock(mutex);
        if (!computed) return;
        open.results[i] = keep(*computed, open.files[i]);
        flaws[unit.mission] = own->mission.scans->problems();
        for (const std::string& why : computed->spoilt)
          console_.warn(name + ": not kept for the next time: " + why);
        ++done;
        show(name + " finished");
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex);
        if (!failure) {
          failure = std::current_exception();
          console_.note(name + " failed: no more runs are begun");
        }
        failed.request_stop();
      }
    }
  };
  std::vector<std::thread> threads;
  const int count = std::min(thread_count(options_.common), static_cast<int>(open.numbers.size()));
  try {
    for (int t = 1; t < count; ++t) threads.emplace_back(work);
  } catch (const std::exception& error) {  // those that there are do all
    const std::lock_guard<std::mutex> lock(mutex);
    console_.warn(std::string("no more threads: ") + error.what());
  }
  work();
  for (std::thread& thread : threads) thread.join();
  for (const auto& [mission, problems] : flaws) {
    for (const Problem& problem : problems.all())
      console_.warn(missions_[mission].name + ": " + to_string(problem));
  }
  if (failure) std::rethrow_exception(failure);
}

UnitFiles Study::files_of(const StudyUnit& unit) const {
  const StudyMission& mission = missions_[unit.mission];
  const std::string id = to_string(ContentHasher()
                                       .integer(static_cast<std::uint64_t>(kUnitFormat))
                                       .integer(mission.content.high)
                                       .integer(mission.content.low)
                                       .text(config_key(unit.config))
                                       .text(replay_code_version())
                                       .finish());
  const std::string name = plain(mission.name) + "-" + plain(unit.label) + "-s" +
                           std::to_string(unit.config.replay.engine.seed) + "-" + id.substr(0, 8);
  return {folder_ / "units" / (id + ".json"), folder_ / "units" / (id + ".seconds"), folder_ / "runs" / name};
}

bool Study::serves() const {
#ifdef LOOPWISE_HAS_MPI
  return options_.job != nullptr && options_.job->rank() > 0;
#else
  return false;
#endif
}

int Study::status_without_results() const {
  return serves() ? kDone : kInterrupted;
}

#ifdef LOOPWISE_HAS_MPI
std::string Study::greeting(const std::vector<StudyUnit>& units) const {
  ContentHasher hasher;
  for (const StudyMission& mission : missions_)
    hasher.integer(mission.content.high).integer(mission.content.low);
  for (const StudyUnit& unit : units) hasher.integer(unit.mission).text(config_key(unit.config));
  return "study " + replay_code_version() + " " + to_string(hasher.finish());
}

void Study::run_on_ranks(const Open& open, const StopToken& stop) {
  std::vector<Work> work;
  for (const std::size_t i : open.numbers) {
    work.push_back({std::to_string(i), open.units[i].mission});
  }
  WorkOptions limits;
  limits.time_limit_s = options_.replay.rank_time_limit_s.value_or(86400.0);
  limits.ahead = 1;  // a rank that waits for a moment costs less than a run that waits for a rank
  WorkServer server(*options_.job, greeting(open.units), limits);
  std::mutex mutex;  // of all below
  std::map<std::size_t, std::shared_ptr<const Loaded>> loaded;
  std::size_t done = open.units.size() - open.numbers.size();
  const auto take = [&](std::size_t i, const ComputedUnit& computed, int rank) {
    const std::lock_guard<std::mutex> lock(mutex);
    open.results[i] = keep(computed, open.files[i]);
    for (const std::string& why : computed.spoilt) {
      console_.warn(missions_[open.units[i].mission].name + " " + open.units[i].label +
                    ": not kept for the next time: " + why);
    }
    ++done;
    console_.progress({"runs", done, open.units.size(),
                       missions_[open.units[i].mission].name + " " + open.units[i].label +
                           " finished by rank " + std::to_string(rank)});
  };
  const auto here = [&](std::size_t k) {
    const std::size_t i = open.numbers[k], m = open.units[i].mission;
    std::shared_ptr<const Loaded> own;
    {
      const std::lock_guard<std::mutex> lock(mutex);
      if (loaded.count(m) == 0) loaded = {{m, load(missions_[m], config_, open.store)}};
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
          json.at("spoilt").get<std::vector<std::string>>()},
         rank);
  };
  const int threads = options_.common.threads > 0 ? options_.common.threads : 1;
  server.run(work, threads, here, there, stop);
}

void Study::serve(const std::vector<StudyUnit>& units, const StopToken& stop) {
  std::pair<std::size_t, std::shared_ptr<const Loaded>> last;
  std::shared_ptr<OutcomeStore> store;
  serve_work(*options_.job, greeting(units), [&](std::string_view request) {
    // Not before: it lies in the folder that rank 0 looks at first.
    if (!store) store = open_outcomes();
    const std::size_t i = std::stoul(std::string(request));
    const StudyUnit& unit = units.at(i);
    if (!last.second || last.first != unit.mission) {
      last = {unit.mission, load(missions_[unit.mission], config_, store)};
    }
    const auto computed =
        compute(*last.second, missions_[unit.mission], unit, files_of(unit), options_.keep_runs, stop, {});
    if (!computed) return std::string();  // interrupted
    Json answer = Json::object();
    answer["seconds"] = computed->seconds;
    answer["spoilt"] = computed->spoilt;
    answer["unit"] = computed->json;
    return json_text(answer);
  });
}
#else
void Study::run_on_ranks(const Open&, const StopToken&) {}
void Study::serve(const std::vector<StudyUnit>&, const StopToken&) {}
#endif

std::optional<std::vector<UnitResult>> Study::run(const std::vector<StudyUnit>& units,
                                                  const StopToken& stop) {
  std::vector<UnitFiles> files;
  std::vector<std::optional<UnitResult>> results(units.size());
  std::vector<std::size_t> open;
  for (std::size_t i = 0; i < units.size(); ++i) {
    const StudyUnit& unit = units[i];
    validate_config(unit.config);
    files.push_back(files_of(unit));
    results[i] = finished(files[i], options_.keep_runs);
    if (!results[i]) open.push_back(i);
  }
  if (open.size() < units.size()) {
    console_.note(std::to_string(units.size() - open.size()) + " of " + std::to_string(units.size()) +
                  " runs are finished already");
  }

  if (serves()) {
    serve(units, stop);
    return std::nullopt;
  }
  // Other ranks wait for their end, also where all is finished.
  if (!open.empty() || options_.job != nullptr) {
    // Missions one after the other: no more than needed are in memory, and units of one share its pairs.
    std::stable_sort(open.begin(), open.end(),
                     [&](std::size_t a, std::size_t b) { return units[a].mission < units[b].mission; });
    const Open work{units, open, files, results, open_outcomes()};
    options_.job != nullptr ? run_on_ranks(work, stop) : run_here(work, stop);
    note_outcomes(console_, *work.store);
    if (stop.stop_requested()) {
      const auto done =
          std::count_if(results.begin(), results.end(), [](const auto& r) { return r.has_value(); });
      console_.note("interrupted: " + std::to_string(done) + " of " + std::to_string(units.size()) +
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
  write_file(folder_ / (name_ + "_timings.csv"), timings.text());
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

}  // namespace loopwise::cli
