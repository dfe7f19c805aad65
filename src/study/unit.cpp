// SPDX-License-Identifier: BSD-3-Clause
#include "unit.hpp"

#include <algorithm>
#include <fstream>
#include <utility>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/evaluation/map_quality.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_history.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/line_log.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise::study {
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

Json unit_json(const StudyMission& about, const Mission& mission, const ReplayOptions& options,
               const ReplayResult& result, const RunHistory& history) {
  const RunEvaluation evaluation = evaluate_run(mission, result);
  Json summary = parse_json(run_summary_json(mission, options, result, evaluation), "summary");
  summary.erase("seconds");
  // All units of a mission read its scans; which of them finds a flaw first depends on timing.
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

/// Compares the map of a run with the map by its odometry.
MapQuality judge_map(const LoadedMission& loaded, const ReplayOptions& options, const ReplayResult& result,
                     ThreadPool& pool, const StopToken& stop) {
  PosesByKey before, after;
  for (std::size_t i = 0; i < result.graph.nodes().size(); ++i) {
    const Node& node = result.graph.nodes()[i];
    before[node.key] = result.odometry[i];
    after[node.key] = node.pose;
  }
  return map_quality(loaded.mission, before, after, closure_pairs(result.graph), options, pool, stop, {},
                     loaded.registration.registrar.get());
}

std::string plain(std::string text) {
  for (char& c : text) {
    const bool fine = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                      c == '-' || c == '+' || c == '.';
    if (!fine) c = '_';
  }
  return text;
}

}  // namespace

StudyMission describe(const StudySource& source, const Mission& mission) {
  const std::string& path = source.path;
  StudyMission out;
  out.source = source;
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
  for (const std::string& given : source.truth) {
    // "ROBOT=FILE" as set_truth() reads it: the robot matters, not the path of the file.
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

UnitFiles files_of(const std::filesystem::path& folder, const StudyMission& mission, const StudyUnit& unit) {
  const std::string id = to_string(ContentHasher()
                                       .integer(static_cast<std::uint64_t>(kUnitFormat))
                                       .integer(mission.content.high)
                                       .integer(mission.content.low)
                                       .text(config_key(unit.config))
                                       .text(replay_code_version())
                                       .finish());
  const std::string name = plain(mission.name) + "-" + plain(unit.label) + "-s" +
                           std::to_string(unit.config.replay.engine.seed) + "-" + id.substr(0, 8);
  return {folder / "units" / (id + ".json"), folder / "units" / (id + ".seconds"), folder / "runs" / name};
}

std::shared_ptr<const LoadedMission> load(const StudyMission& mission, const Config& config,
                                          const std::shared_ptr<OutcomeStore>& store) {
  auto loaded = std::make_shared<LoadedMission>();
  loaded->mission = read_mission(mission.source.path, config.mission);
  set_truth(loaded->mission, mission.source.truth, config.mission);
  loaded->registration =
      make_registration(config.replay.registration, loaded->mission.scans->loader(), store);
  return loaded;
}

std::optional<ComputedUnit> compute(const LoadedMission& loaded, const StudyMission& about,
                                    const StudyUnit& unit, const UnitFiles& files, bool keep_run,
                                    const StopToken& stop, const ProgressCallback& progress) {
  const Stopwatch watch;
  RunHistory history(loaded.mission);
  ReplayHooks hooks;
  hooks.moment = [&](const ReplayMoment& moment) { history.add(moment); };
  hooks.stop = stop;
  hooks.progress = progress;
  std::optional<LineLog> journal;
  if (keep_run) {
    fs::create_directories(files.run);
    fs::remove(files.run / "summary.json");
    journal.emplace(files.run / "journal.jsonl");
    hooks.journal = [&](const std::string& line) { journal->add(line); };
  }
  ThreadPool one(1);
  ReplayResult result =
      MissionReplay(loaded.mission, unit.config.replay, loaded.registration).run(one, hooks);
  if (result.interrupted) return std::nullopt;
  const double seconds = watch.seconds();
  std::optional<MapQuality> quality;
  if (unit.map_quality) quality = judge_map(loaded, unit.config.replay, result, one, stop);
  if (stop.stop_requested()) return std::nullopt;
  if (keep_run) {
    journal->finish();
    const PointCloud map = map_of_run(loaded.mission, result, kMapVoxel_m, stop, {},
                                      unit.config.replay.registration.features.max_range_m);
    if (stop.stop_requested()) return std::nullopt;
    write_run_folder(files.run, loaded.mission, unit.config.replay, result,
                     evaluate_run(loaded.mission, result), history.rows(), map);
    if (quality) keep_map_quality(files.run, *quality);
  }
  ComputedUnit computed{unit_json(about, loaded.mission, unit.config.replay, result, history), 0.0, {}};
  if (quality)
    computed.json["summary"]["map_quality"] = parse_json(map_quality_json(*quality), "map quality");
  if (quality && !keep_run) add_scan_problems(result, *loaded.mission.scans);
  for (const Problem& problem : result.problems.all()) {
    for (const char* kind : {"scan cannot be read", "neighbour's scan cannot be read", "registration failed",
                             "registration reached its time limit"}) {
      if (problem.kind == kind) computed.not_repeatable.push_back(to_string(problem));
    }
  }
  computed.seconds = seconds;
  return computed;
}

UnitResult keep(const ComputedUnit& unit, const UnitFiles& files) {
  const std::string text = json_text(unit.json);
  if (unit.not_repeatable.empty()) {
    write_file(files.seconds, Json(unit.seconds).dump() + "\n");
    write_file(files.result, text + "\n");
  }
  // In the form in which the next study will read it.
  const std::string name = files.result.string();
  return parse_unit_file(parse_json(text, name), name);
}

std::optional<UnitResult> finished(const StudyUnit& unit, const UnitFiles& files, bool with_run) {
  try {
    if (with_run) {
      // A run that an earlier study kept may lack the quality of its map.
      const Json summary = read_json_file(files.run / "summary.json");
      if (unit.map_quality && !summary.contains("map_quality")) return std::nullopt;
    }
    UnitResult result = parse_unit_file(read_json_file(files.result), files.result.string());
    if (unit.map_quality && !result.summary.contains("map_quality")) return std::nullopt;
    return result;
  } catch (const IoError&) {
  } catch (const InputError&) {
  }
  return std::nullopt;
}

}  // namespace loopwise::study
