// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/evaluation/given_truth.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/replay/rank.hpp>
#include <loopwise/replay/registration.hpp>

#include "study.hpp"
#include "study_statistics.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::string mission;
  std::vector<std::string> truth;
  std::string registrar = "both";
  std::string preset;
  std::string csv;
  std::string markdown;
  std::size_t count = 2000;
  std::size_t pcl_count = 0;
  bool no_guess = false;
  std::uint64_t seed = 1;
};

Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json();
}

/// Share of the source's points with a point of the target within 0.5 m under T_to_from. Both as the
/// registrars have them: downsampled, the target with the neighbours that they would merge.
double true_overlap(FeatureCache& features, const RegistrationTask& task,
                    const Eigen::Isometry3d& T_to_from) {
  const auto source = features.get(task.candidate.from);
  std::vector<Eigen::Vector3f> target;
  for (const SubmapMember& member : task.target) {
    if (task.enough_points > 0 && target.size() >= task.enough_points) break;
    const auto scan = features.get(member.key);
    if (!scan) continue;
    const Eigen::Isometry3f T = member.T_center_member.cast<float>();
    for (const Eigen::Vector3f& p : scan->cloud.points) target.push_back(T * p);
  }
  if (!source || source->cloud.empty() || target.empty()) return 0.0;
  const KdTree tree(target);
  const Eigen::Isometry3f T = T_to_from.cast<float>();
  std::size_t near = 0;
  for (const Eigen::Vector3f& p : source->cloud.points) {
    if (tree.nearest(T * p, 0.5F)) ++near;
  }
  return static_cast<double>(near) / static_cast<double>(source->cloud.size());
}

Json to_json(const StudySummary& s) {
  return {{"pairs", s.pairs},
          {"overlapping", s.overlapping},
          {"recalled", s.recalled},
          {"recall", number(s.recall)},
          {"accepted", s.accepted},
          {"wrong", s.wrong},
          {"false_accepts", s.false_accepts},
          {"false_accept_bound_95", number(s.false_accept_bound)},
          {"error",
           {{"median_m", number(s.median_m)},
            {"median_rad", number(s.median_rad)},
            {"max_m", number(s.largest_m)}}},
          {"normalized_error",
           {{"mean", number(s.mean_squared_error)},
            {"beyond_5_percent_point", number(s.beyond_5)},
            {"beyond_95_percent_point", number(s.beyond_95)},
            {"beyond_999_permille_point", number(s.beyond_999)},
            {"degenerate", s.degenerate},
            {"degenerate_beyond_95_percent_point", number(s.degenerate_beyond_95)}}},
          {"milliseconds",
           {{"features", number(s.features_ms)},
            {"global", number(s.global_ms)},
            {"refine", number(s.refine_ms)},
            {"accepted", number(s.accepted_ms)},
            {"rejected", number(s.rejected_ms)},
            {"mean", number(s.mean_ms)}}}};
}

const std::vector<std::string> kColumns{"registrar", "pairs",  "overlapping", "recall %",   "accepted",
                                        "wrong",     "false",  "bound %",     "median m",   "median deg",
                                        "chi2/6",    "> 95 %", "ms accepted", "ms refused", "ms mean"};

std::vector<std::string> row(const std::string& name, const StudySummary& s) {
  return {name,
          std::to_string(s.pairs),
          std::to_string(s.overlapping),
          fixed(100.0 * s.recall, 1),
          std::to_string(s.accepted),
          std::to_string(s.wrong),
          std::to_string(s.false_accepts),
          fixed(100.0 * s.false_accept_bound, 2),
          fixed(s.median_m, 3),
          fixed(57.29577951308232 * s.median_rad, 2),
          fixed(s.mean_squared_error / 6.0, 2),
          fixed(100.0 * s.beyond_95, 1),
          fixed(s.accepted_ms, 2),
          fixed(s.rejected_ms, 2),
          fixed(s.mean_ms, 2)};
}

std::string markdown(const std::vector<std::vector<std::string>>& rows) {
  std::string out;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    for (const std::string& cell : rows[r]) out += "| " + cell + " ";
    out += "|\n";
    if (r > 0) continue;
    for (std::size_t c = 0; c < rows[r].size(); ++c) out += "| --- ";
    out += "|\n";
  }
  return out;
}

std::string range(const Stratum& stratum) {
  const int decimals = stratum.property == "distance_m" ? 0 : stratum.property == "overlap" ? 1 : 2;
  const std::string from = fixed(stratum.from, decimals);
  return std::isfinite(stratum.to) ? from + "-" + fixed(stratum.to, decimals) : "from " + from;
}

std::string csv_rows(const std::string& registrar, const std::vector<StudyPair>& pairs,
                     const std::vector<StudyOutcome>& outcomes) {
  std::string out;
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    const StudyPair& p = pairs[i];
    const StudyOutcome& o = outcomes[i];
    const auto cell = [](double value, int decimals) {
      return std::isnan(value) ? "" : fixed(value, decimals);
    };
    out += registrar + "," + std::to_string(p.candidate.from) + "," + std::to_string(p.candidate.to) + "," +
           cell(p.distance_m, 3) + "," + cell(p.overlap, 4) + "," + cell(p.observability, 5) + "," +
           enum_name(o.reason) + "," + cell(o.error_m, 4) + "," + cell(o.error_rad, 5) + "," +
           cell(o.squared_mahalanobis, 3) + "," + cell(o.weak_sigma_m, 4) + "," + cell(o.weak_error, 3) +
           "," + cell(o.features_s, 6) + "," + cell(o.global_s, 6) + "," + cell(o.refine_s, 6) + "\n";
  }
  return out;
}

int run(const Options& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = load_config(options.common);
  if (!options.preset.empty()) config.replay.engine.generation = proximity_preset(options.preset);
  if (options.no_guess) config.replay.engine.task.use_guess = false;
  std::vector<RegistrarKind> kinds;
  if (options.registrar == "both") {
    kinds = {RegistrarKind::kFast, RegistrarKind::kPcl};
  } else {
    kinds = {parse_enum<RegistrarKind>("--registrar", options.registrar)};
  }
  Mission mission =
      read_mission(options.mission, config.mission, console.progress_callback(), interrupt.token());
  set_truth(mission, options.truth, config.mission);
  console.warn(mission.problems);
  require_truth(options.mission, mission);

  std::vector<LoopCandidate> sample = all_candidates(mission, config.replay);
  const std::size_t generated = sample.size();
  sample.erase(std::remove_if(sample.begin(), sample.end(),
                              [&](const LoopCandidate& c) {
                                return mission.ground_truth.count(c.from) == 0 ||
                                       mission.ground_truth.count(c.to) == 0 || !mission.scans->has(c.from) ||
                                       !mission.scans->has(c.to);
                              }),
               sample.end());
  Rng(options.seed).shuffle(sample);
  if (options.count > 0 && sample.size() > options.count) sample.resize(options.count);

  ThreadPool threads(thread_count(options.common));
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), config.replay.registration.features);
  std::vector<StudyPair> pairs(sample.size());
  std::vector<RegistrationTask> tasks(sample.size());
  std::vector<Eigen::Isometry3d> truths(sample.size());
  threads.for_each(sample.size(), [&](std::size_t i) {
    const LoopCandidate& c = sample[i];
    const Eigen::Isometry3d truth = mission.ground_truth.at(c.from).inverse() * mission.ground_truth.at(c.to);
    tasks[i] = make_task(mission.graph, mission.robots, c, config.replay.engine.task, options.seed,
                         [&](Key key) { return mission.scans->has(key); });
    pairs[i].candidate = c;
    pairs[i].distance_m = truth.translation().norm();
    pairs[i].overlap = true_overlap(*features, tasks[i], truth.inverse());
    const auto from = features->get(c.from), to = features->get(c.to);
    pairs[i].observability =
        std::min(from->observability.min_eigenvalue_lamp, to->observability.min_eigenvalue_lamp);
    truths[i] = truth;
  });

  Json json = {{"mission", mission.name},
               {"candidates", generated},
               {"sampled", sample.size()},
               {"threads", thread_count(options.common)},
               {"registrars", Json::object()}};
  std::vector<std::vector<std::string>> rows{kColumns};
  std::string detail;
  std::string csv =
      "registrar,from,to,distance_m,overlap,observability,reason,error_m,error_rad,squared_mahalanobis,"
      "weak_sigma_m,weak_error,features_s,global_s,refine_s\n";
  for (const RegistrarKind kind : kinds) {
    const std::string name = enum_name(kind);
    RegistrationOptions of_kind = config.replay.registration;
    of_kind.registrar = kind;
    const auto registrar = make_registration(of_kind, mission.scans->loader()).registrar;
    std::vector<RegistrationTask> own = tasks;
    if (kind == RegistrarKind::kPcl && options.pcl_count > 0 && own.size() > options.pcl_count) {
      own.resize(options.pcl_count);
    }
    const Stopwatch batch_watch;
    const auto results =
        compute_batch(*registrar, own, threads, interrupt.token(), console.progress_callback());
    const double batch_s = batch_watch.seconds();
    if (interrupt.interrupted()) {
      console.note("interrupted: nothing was written");
      return kInterrupted;
    }
    std::vector<StudyOutcome> outcomes;
    std::map<std::string, std::size_t> reasons;
    for (std::size_t i = 0; i < own.size(); ++i) {
      outcomes.push_back(judge(*results[i], truths[i]));
      if (!outcomes.back().accepted) ++reasons[enum_name(outcomes.back().reason)];
    }
    std::vector<std::size_t> all(own.size());
    std::iota(all.begin(), all.end(), 0);
    const StudySummary summary = summarize(pairs, outcomes, all);
    Json entry = to_json(summary);
    entry["rejected"] = reasons;
    entry["seconds"] = batch_s;
    entry["strata"] = Json::array();
    rows.push_back(row(name, summary));
    std::vector<std::vector<std::string>> table_rows{kColumns};
    table_rows.front().front() = name;
    for (const Stratum& stratum : strata(pairs, own.size())) {
      const StudySummary of = summarize(pairs, outcomes, stratum.pairs);
      Json cell = to_json(of);
      cell["property"] = stratum.property;
      cell["from"] = stratum.from;
      cell["to"] = number(stratum.to);
      entry["strata"].push_back(cell);
      table_rows.push_back(row(stratum.property + " " + range(stratum), of));
    }
    detail += "\n" + (options.markdown.empty() ? table(table_rows) : markdown(table_rows));
    json["registrars"][name] = entry;
    csv += csv_rows(name, pairs, outcomes);
  }
  json["seconds"] = watch.seconds();
  if (!options.csv.empty()) write_file(options.csv, csv);
  if (!options.markdown.empty()) write_file(options.markdown, markdown(rows) + detail);
  print_results(options.common, json,
                std::to_string(sample.size()) + " of " + std::to_string(generated) + " candidates\n\n" +
                    table(rows) + (options.markdown.empty() ? detail : ""));
  return kDone;
}

}  // namespace

void add_registration_study(CLI::App& study, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command =
      study.add_subcommand("registration", "Recall, false accepts, errors and times of the registrars");
  command->footer(
      "Candidates of the mission, by proximity of its odometry, drawn uniformly. Overlapping: at the true "
      "pose 40 %\n"
      "of the source's points lie within 0.5 m of the target. Recalled: overlapping, and accepted within 0.5 "
      "m and\n"
      "3 degrees. Wrong: accepted beyond that; false: wrong, and outside the closure's own covariance.\n"
      "  loopwise study registration my_mission --count 500 --csv pairs.csv");
  command->add_option("mission", options->mission, "Mission or session folder with ground truth")
      ->required()
      ->type_name("MISSION");
  add_truth_option(*command, options->truth);
  command->add_option("--registrar", options->registrar, "fast, pcl or both (default both)")
      ->type_name("WORD");
  command->add_option("--count", options->count, "Candidates to draw; 0 takes all (default 2000)")
      ->type_name("N")
      ->check(not_negative());
  command->add_option("--pcl-count", options->pcl_count, "PCL computes only the first N of them; 0: all")
      ->type_name("N")
      ->check(not_negative());
  command->add_option("--preset", options->preset, "How candidates are found (default lamp_base)")
      ->type_name("NAME");
  command->add_flag("--no-guess", options->no_guess,
                    "The registrars do not get the odometry's relative pose");
  command->add_option("--seed", options->seed, "Of the draw (default 1)")
      ->type_name("S")
      ->check(not_negative());
  command->add_option("--csv", options->csv, "Write a row for every pair and registrar")
      ->type_name("FILE")
      ->check(not_standard_output());
  command->add_option("--markdown", options->markdown, "Write the tables as Markdown")
      ->type_name("FILE")
      ->check(not_standard_output());
  add_key_frame_options(*command, options->common);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
