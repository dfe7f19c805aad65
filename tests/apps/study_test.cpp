// SPDX-License-Identifier: BSD-3-Clause
// Studies of replays, and runs that are killed: the guarantees for scripts.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <set>
#include <thread>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>

#include "program.hpp"
#include "small_mission.hpp"
#include "testing.hpp"

namespace loopwise::study_test {
namespace {

using testing::Program;
using testing::ProgramRun;
using testing::run_program;
using testing::small_mission;
using testing::TemporaryFolder;
namespace fs = testing::fs;

enum : int { kDone = 0, kBadUsage = 2, kBadInput = 3, kInterrupted = 130, kKilled = 128 + 9 };

/// Rows of a CSV file without quoted values.
std::vector<std::vector<std::string>> rows_of(const fs::path& path) {
  std::vector<std::vector<std::string>> rows;
  std::istringstream lines(testing::read_text(path));
  for (std::string line; std::getline(lines, line);) {
    rows.emplace_back();
    std::istringstream cells(line + ",");
    for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(cell);
  }
  return rows;
}

std::size_t column(const std::vector<std::vector<std::string>>& rows, const std::string& name) {
  const auto found = std::find(rows[0].begin(), rows[0].end(), name);
  REQUIRE(found != rows[0].end());
  return static_cast<std::size_t>(found - rows[0].begin());
}

/// The contents of all files that must be equal in every run, by name and without wall times.
std::map<std::string, std::string> results_of(const fs::path& folder) {
  std::map<std::string, std::string> all;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    const std::string name = fs::relative(entry.path(), folder).generic_string();
    const auto is = [&](const std::string& end) {
      return name.size() >= end.size() && name.compare(name.size() - end.size(), end.size(), end) == 0;
    };
    if (is(".seconds") || is("_timings.csv") || is(".bin") || is("outcomes.jsonl")) continue;
    std::string text = testing::read_text(entry.path());
    if (is("closures.csv")) {
      std::istringstream lines(text);
      text.clear();
      for (std::string line; std::getline(lines, line);) text += line.substr(0, line.rfind(',')) + "\n";
    } else if (is("summary.json")) {
      Json json = parse_json(text, name);
      json.erase("seconds");
      text = json.dump();
    }
    all[name] = text;
  }
  return all;
}

void require_same(const std::map<std::string, std::string>& a, const std::map<std::string, std::string>& b) {
  std::vector<std::string> names, other_names;
  for (const auto& [name, text] : a) names.push_back(name);
  for (const auto& [name, text] : b) other_names.push_back(name);
  REQUIRE(names == other_names);
  for (const auto& [name, text] : a) {
    CAPTURE(name);
    REQUIRE(text == b.at(name));
  }
}

/// Three missions of two worlds.
std::vector<std::string> write_missions(const TemporaryFolder& folder) {
  std::vector<std::string> paths;
  for (const char* name : {"a1", "a2", "b1"}) {
    Mission mission = small_mission(name[0] == 'b' ? 10 : 8, name[1] == '2' ? 17 : 9);
    mission.name = std::string("yard-") + name;
    mission.provenance_json = std::string(R"({"seed": ")") + name[1] +
                              R"(", "parameters_sha256": "0123456789abcdef", "options": {"world": ")" +
                              name[0] + "\"}}";
    paths.push_back((folder / name).string());
    write_mission(paths.back(), mission);
  }
  return paths;
}

std::vector<std::string> with(std::vector<std::string> arguments, const std::vector<std::string>& more) {
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

const std::vector<std::string> kQuick{
    "--skip-recent", "2",         "--set", "observability.min_sum=0", "--batch", "5", "--registration-time",
    "2.0",           "--workers", "2"};

}  // namespace

TEST_CASE("study ablation: tables agree with the runs, for any number of threads", "[apps][study]") {
  const TemporaryFolder folder;
  const std::vector<std::string> missions = write_missions(folder);
  const auto study = [&](const std::string& out, const std::vector<std::string>& more) {
    return with(
        with(with({"study", "ablation"}, missions),
             {"-o", (folder / out).string(), "--methods", "baseline,random,full", "--seeds", "2", "--quiet"}),
        with(kQuick, more));
  };
  const ProgramRun one = run_program(study("one", {"--threads", "1", "--json", "-"}));
  INFO(one.err);
  REQUIRE(one.status == kDone);
  const Json json = parse_json(one.out, "standard output");
  REQUIRE(parse_json(testing::read_text(folder / "one" / "ablation.json"), "ablation.json") == json);

  const auto rows = rows_of(folder / "one" / "runs.csv");
  REQUIRE(rows.size() == 1 + 3 * 2 * 3);
  const std::size_t world = column(rows, "world"), method = column(rows, "method"),
                    ate = column(rows, "ate_m"), odometry = column(rows, "odometry_ate_m"),
                    queued = column(rows, "queued"), computed = column(rows, "computed"),
                    verified = column(rows, "verified"), share = column(rows, "verified_of_queued"),
                    of_computed = column(rows, "verified_of_computed"),
                    parameters = column(rows, "parameters_sha256"), seed = column(rows, "seed"),
                    mission = column(rows, "mission");
  std::map<std::string, std::vector<double>> ates, odometries;
  std::map<std::string, std::map<std::string, std::vector<double>>> by_mission;  // seeds of one go together
  std::set<std::string> seeds;
  for (std::size_t i = 1; i < rows.size(); ++i) {
    REQUIRE(rows[i].size() == rows[0].size());
    REQUIRE(rows[i][parameters] == "0123456789abcdef");
    seeds.insert(rows[i][seed]);
    REQUIRE(std::stod(rows[i][computed]) > 5.0);
    REQUIRE(std::stod(rows[i][share]) ==
            Approx(100.0 * std::stod(rows[i][verified]) / std::stod(rows[i][queued])));
    REQUIRE(std::stod(rows[i][of_computed]) ==
            Approx(100.0 * std::stod(rows[i][verified]) / std::stod(rows[i][computed])));
    ates[rows[i][world] + rows[i][method]].push_back(std::stod(rows[i][ate]));
    by_mission[rows[i][world] + rows[i][method]][rows[i][mission]].push_back(std::stod(rows[i][ate]));
    if (rows[i][method] == "full") odometries[rows[i][world]].push_back(std::stod(rows[i][odometry]));
  }
  REQUIRE(seeds == std::set<std::string>{"1", "2"});
  REQUIRE(json.at("worlds").size() == 2);
  for (const Json& of_world : json.at("worlds")) {
    const std::string name = of_world.at("world").get<std::string>();
    REQUIRE(of_world.at("missions") == (name == "a" ? 2 : 1));
    REQUIRE(of_world.at("parameters_sha256") == Json({"0123456789abcdef"}));
    for (const char* m : {"baseline", "random", "full"}) {
      const Json& entry = of_world.at("methods").at(m).at("ate_m");
      REQUIRE(entry.at("median").get<double>() == quartiles(ates[name + m]).median);
      REQUIRE(entry.at("upper_quartile").get<double>() == quartiles(ates[name + m]).upper);
      std::vector<std::vector<double>> groups;
      for (const auto& [of, seeds_of] : by_mission[name + m]) groups.push_back(seeds_of);
      const Interval interval = bootstrap_median(groups);
      REQUIRE(entry.at("interval_95").at(0).is_null() == std::isnan(interval.low));
      if (!std::isnan(interval.low)) {
        REQUIRE(entry.at("interval_95").at(0).get<double>() == interval.low);
        REQUIRE(entry.at("interval_95").at(1).get<double>() == interval.high);
      }
    }
    REQUIRE(of_world.at("methods").at("odom").at("ate_m").at("median").get<double>() ==
            quartiles(odometries[name]).median);
    REQUIRE(of_world.at("methods").at("odom").at("ate_m").at("count") == odometries[name].size());
    REQUIRE_FALSE(of_world.at("methods").at("odom").contains("queued"));
  }
  // Missions are the pairs: two seeds of one count once.
  const Json& pooled = json.at("pooled").at("full").at("baseline");
  REQUIRE(pooled.at("missions") == 3);
  const double difference = pooled.at("mean_difference_m").get<double>();
  REQUIRE(pooled.at("difference_interval_95_m").at(0).get<double>() <= difference);
  REQUIRE(pooled.at("difference_interval_95_m").at(1).get<double>() >= difference);
  const Json& reductions = json.at("reductions_percent").at("full").at("odom");
  REQUIRE(reductions.at("mean").get<double>() ==
          Approx(0.5 * (reductions.at("a").get<double>() + reductions.at("b").get<double>())));
  const std::string text = testing::read_text(folder / "one" / "ablation.md");
  REQUIRE_THAT(text, Contains("parameters 0123456789ab") && Contains("true inliers, % of queued"));

  // The same bytes with two threads in a new folder, and when continued from existing files.
  REQUIRE(run_program(study("two", {"--threads", "2"})).status == kDone);
  require_same(results_of(folder / "one"), results_of(folder / "two"));
  const auto before = results_of(folder / "two");
  const ProgramRun again = run_program(
      with(with(with({"study", "ablation"}, missions),
                {"-o", (folder / "two").string(), "--methods", "baseline,random,full", "--seeds", "2"}),
           kQuick));
  REQUIRE(again.status == kDone);
  REQUIRE_THAT(again.err, Contains("18 of 18 runs are finished already"));
  require_same(results_of(folder / "two"), before);

  // A changed option makes other runs, next to the first ones.
  const ProgramRun other = run_program(with(
      with(with({"study", "ablation"}, missions), {"-o", (folder / "two").string(), "--methods", "full"}),
      with(kQuick, {"--gi-evaluation-time", "0.05"})));
  REQUIRE(other.status == kDone);
  REQUIRE_THAT(other.err, !Contains("finished already"));
  REQUIRE(rows_of(folder / "two" / "runs.csv").size() == 4);

  // A unit's file that was damaged is computed again.
  std::map<fs::path, std::string> damaged;
  for (const auto& entry : fs::directory_iterator(folder / "one" / "units")) {
    if (entry.path().extension() != ".json" || damaged.size() == 4) continue;
    const std::string written = testing::read_text(entry.path());
    Json unit = parse_json(written, "unit");
    if (damaged.size() == 1) unit["history"][0][4] = -1;
    if (damaged.size() == 2) unit["history"][0].erase(10);
    if (damaged.size() == 3) unit["summary"] = nullptr;
    testing::write_text(entry.path(), damaged.empty() ? unit.dump().substr(0, 100) : unit.dump());
    damaged.emplace(entry.path(), written);
  }
  REQUIRE(damaged.size() == 4);
  REQUIRE(run_program(study("one", {})).status == kDone);
  for (const auto& [path, written] : damaged) REQUIRE(testing::read_text(path) == written);
  auto whole = before;
  require_same(results_of(folder / "one"), whole);
}

namespace {

void require_failure(const std::vector<std::string>& arguments, int status, const std::string& why) {
  const ProgramRun run = run_program(arguments);
  CAPTURE(arguments);
  REQUIRE(run.status == status);
  REQUIRE(run.out.empty());
  REQUIRE_THAT(run.err, Contains(why));
}

}  // namespace

TEST_CASE("study: bad usage and bad input", "[apps][study][error]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(4);
  const std::string path = (folder / "m").string(), out = (folder / "out").string();
  write_mission(path, mission);
  mission.ground_truth.clear();
  write_mission(folder / "untrue", mission);
  require_failure({"study", "ablation", path}, kBadUsage, "output");
  require_failure({"study", "ablation", path, "-o", out, "--methods", "best"}, kBadUsage, "best");
  require_failure({"study", "ablation", path, "-o", out, "--methods", "full,full"}, kBadUsage, "twice");
  require_failure({"study", "ablation", path, "-o", out, "--batch", "-1"}, kBadUsage, "replay.batch = -1");
  require_failure({"study", "ablation", path, "-o", out, "--registration-time", "soon"}, kBadUsage,
                  "registration_time_s");
  require_failure({"study", "ablation", path, path, "-o", out}, kBadUsage, "same mission");
  require_failure({"study", "budget", path, "-o", out, "--workers", "2,0"}, kBadUsage, "cost.workers = 0");
  require_failure({"study", "budget", path, "-o", out, "--everything", "best"}, kBadUsage, "best");
  require_failure({"study", "budget", path, "-o", out, "--thin", "2", "--everything", "none"}, kBadUsage,
                  "--thin");
  require_failure({"study", "ablation", path, "-o", out, "--workers", "0"}, kBadUsage, "cost.workers = 0");
  require_failure({"study", "rssi", (folder / "untrue").string(), "-o", out}, kBadInput,
                  "has no ground truth to compare with; --truth FILE gives the true poses");
  mission.reference = small_mission(4).ground_truth;  // as a session's own optimised poses
  write_mission(folder / "referred", mission);
  require_failure(
      {"study", "ablation", (folder / "referred").string(), "-o", out}, kBadInput,
      "has no ground truth to compare with (its own optimised poses are another program's result)");
  require_failure({"study", "ablation", path, (folder / "untrue").string(), "-o", out, "--truth", "a.g2o"},
                  kBadUsage, "--truth is given 1 times for 2 missions");
  require_failure({"study", "ablation", (folder / "absent").string(), "-o", out}, kBadInput, "absent");
  require_failure({"study", "ablation", path, "-o", path}, kBadUsage, "not empty");
  require_failure({"replay", path, "-o", out, "--clock", "real", "--resume"}, kBadUsage, "--resume");
  require_failure({"replay", path, "-o", out, "--rate", "2"}, kBadUsage, "--rate");
  for (const char* modelled : {"--workers", "--registration-time", "--gi-evaluation-time"}) {
    require_failure({"replay", path, "-o", out, "--clock", "real", modelled, "2"}, kBadUsage, modelled);
  }
  require_failure({"study", "rssi", path, "-o", out, "--outcomes-mb", "0"}, kBadUsage, "--outcomes-mb");
  require_failure({"replay", path, "-o", out, "--outcomes-mb", "10"}, kBadUsage, "--outcomes");
}

TEST_CASE("study: scans behind a link count, and their problems are reported", "[apps][study]") {
  const TemporaryFolder folder;
  Mission mission = small_mission(4);
  mission.name = "yard|1";
  write_mission(folder / "m", mission);
  fs::rename(folder / "m" / "scans", folder / "scans");
  fs::create_directory_symlink(folder / "scans", folder / "m" / "scans");
  const auto study = [&](const std::string& kind) {
    return run_program({"study", kind, (folder / "m").string(), "-o", (folder / "out").string(), "--methods",
                        "rssi", "--skip-recent", "2"});
  };
  const ProgramRun first = study("rssi");
  REQUIRE(first.status == kDone);
  REQUIRE_THAT(first.err, Contains("warning") && Contains("no radio readings"));
  REQUIRE_THAT(study("rssi").err, Contains("1 of 1 runs are finished already"));
  REQUIRE(study("ablation").status == kDone);
  REQUIRE_THAT(testing::read_text(folder / "out" / "ablation.md"), Contains("| yard\\|1 |"));
  write_mission(folder / "n", small_mission(3));
  const ProgramRun odometry = run_program(  // no mission is taken for a value of an option before it
      {"study", "ablation", "-o", (folder / "out").string(), "--odometry-noise", "0.01", "0.001", "--methods",
       "odom", (folder / "m").string(), (folder / "n").string()});
  INFO(odometry.err);
  REQUIRE(odometry.status == kDone);
  REQUIRE_THAT(odometry.out, !Contains("paired") && !Contains("Reductions"));  // nothing to set beside it
  const auto guess = [&](const std::vector<std::string>& more) {
    const ProgramRun run =
        run_program(with({"study", "ablation", (folder / "m").string(), "-o", (folder / "out").string(),
                          "--methods", "odom", "--quiet", "--json", "-"},
                         more));
    return parse_json(run.out, "standard output").at("options").at("engine").at("guess");
  };
  REQUIRE(guess({}) == "odometry");
  REQUIRE(guess({"--set", "engine.guess=estimate"}) == "estimate");
  REQUIRE(guess({"--guess", "estimate"}) == "estimate");
  REQUIRE(run_program({"replay", "-o", (folder / "run").string(), "--method", "odom", "--odometry-noise",
                       "0.01", "0.001", (folder / "m").string()})
              .status == kDone);

  const fs::path scan = fs::directory_iterator(folder / "scans")->path();
  testing::write_text(scan, "not a scan");
  const ProgramRun changed = study("rssi");
  INFO(changed.err);
  REQUIRE(changed.status == kDone);
  REQUIRE_THAT(changed.err, !Contains("finished already"));
  REQUIRE_THAT(changed.err, Contains("warning: yard|1: scan is damaged"));
  // Outcomes with a damaged scan are stored as results; those with a scan that could not be read are not.
  const ProgramRun again = study("rssi");
  INFO(again.err);
  REQUIRE(again.status == kDone);
  REQUIRE_THAT(again.err, Contains("finished already"));
  fs::remove(scan);
  fs::create_directory(scan);
  for (int i = 0; i < 2; ++i) {
    const ProgramRun unreadable = study("rssi");
    INFO(unreadable.err);
    REQUIRE(unreadable.status == kDone);
    REQUIRE_THAT(unreadable.err, Contains("not kept for the next time"));
    REQUIRE_THAT(unreadable.err, !Contains("finished already"));
  }
}

TEST_CASE("study, replay: a network counts by its contents, not by its path", "[apps][study][resume]") {
  const TemporaryFolder folder;
  write_mission(folder / "m", small_mission(6));
  const fs::path network = folder / "weights.json";
  fs::copy_file(fs::path(LOOPWISE_SOURCE_DIR) / "data" / "gnn" / "loopwise.json", network);
  const std::vector<std::string> common = with(kQuick, {"--set", "graph_information.objective=gnn", "--set",
                                                        "graph_information.gnn_weights=" + network.string()});
  const auto study = [&] {
    return run_program(with(
        {"study", "ablation", (folder / "m").string(), "-o", (folder / "out").string(), "--methods", "gi"},
        common));
  };
  const auto replay = [&] {
    return run_program(with(
        {"replay", (folder / "m").string(), "-o", (folder / "run").string(), "--method", "gi", "--resume"},
        common));
  };
  const ProgramRun first = study();
  INFO(first.err);
  REQUIRE(first.status == kDone);
  REQUIRE_THAT(first.err, !Contains("finished already"));
  REQUIRE_THAT(study().err, Contains("1 of 1 runs are finished already"));
  REQUIRE(replay().status == kDone);
  REQUIRE(replay().status == kDone);

  testing::write_text(network, testing::read_text(network) + "\n");  // trained anew
  const ProgramRun changed = study();
  INFO(changed.err);
  REQUIRE(changed.status == kDone);
  REQUIRE_THAT(changed.err, !Contains("finished already"));
  REQUIRE_THAT(study().err, Contains("1 of 1 runs are finished already"));
  const ProgramRun refused = replay();
  INFO(refused.err);
  REQUIRE(refused.status == kBadUsage);
  REQUIRE_THAT(refused.err, Contains("other content of graph_information.gnn_weights"));
}

TEST_CASE("study budget and rssi: tables agree with the curves and robots", "[apps][study]") {
  const TemporaryFolder folder;
  const std::vector<std::string> missions = write_missions(folder);
  const std::vector<std::string> quick{"--skip-recent",           "2",       "--set",
                                       "observability.min_sum=0", "--batch", "5",
                                       "--registration-time",     "2.0",     "--quiet"};
  const ProgramRun budget = run_program(
      with(with(with({"study", "budget"}, missions),
                {"-o", (folder / "out").string(), "--workers", "1,3", "--thin", "2", "--json", "-"}),
           quick));
  INFO(budget.err);
  REQUIRE(budget.status == kDone);
  Json json = parse_json(budget.out, "standard output");
  const auto rows = rows_of(folder / "out" / "curves.csv");
  const std::size_t world = column(rows, "world"), method = column(rows, "method"),
                    workers = column(rows, "workers"), after = column(rows, "after_mission"),
                    ate = column(rows, "ate_m"), time = column(rows, "time_s"),
                    end = column(rows, "mission_end_s"), thin = column(rows, "thin"),
                    computed = column(rows, "computed"), queued = column(rows, "queued");
  std::map<std::string, std::string> last;  // of each run
  for (std::size_t i = 1; i < rows.size(); ++i) {
    REQUIRE(rows[i].size() == rows[0].size());
    last[rows[i][world] + "-" + rows[i][method] + "-" + rows[i][workers] + "-" + rows[i][after]] =
        rows[i][ate];
    REQUIRE(rows[i][thin] == (rows[i][after] == "1" ? "2" : "1"));
    if (rows[i][after] == "0") REQUIRE(std::stod(rows[i][time]) <= std::stod(rows[i][end]));
    const bool is_last = i + 1 == rows.size() || std::stod(rows[i + 1][time]) <= std::stod(rows[i][time]);
    if (rows[i][after] == "1" && is_last) REQUIRE(rows[i][computed] == rows[i][queued]);
  }
  REQUIRE(last.size() == 2 * 5);
  REQUIRE(json.at("everything") == Json({{"method", "baseline"}, {"workers", 1}, {"thin", 2}}));
  for (const Json& of_world : json.at("worlds")) {
    REQUIRE(of_world.at("at_end").size() == 5);
    REQUIRE(of_world.at("over_time").size() == 10);
    if (of_world.at("world") != "b") continue;  // one mission: its figures are the medians
    for (const Json& entry : of_world.at("at_end")) {
      const std::string name = "b-" + entry.at("method").get<std::string>() + "-" +
                               entry.at("workers").dump() + "-" +
                               (entry.at("everything").get<bool>() ? "1" : "0");
      REQUIRE(entry.at("ate_m").at("median").get<double>() ==
              Approx(std::stod(last.at(name))).epsilon(1e-12));
    }
    const Json& whole = of_world.at("over_time").back();
    for (std::size_t k = 0; k < 4; ++k) {
      REQUIRE(whole.at("runs").at(k).at("ate_m").at("median").get<double>() ==
              Approx(of_world.at("at_end").at(k).at("ate_m").at("median").get<double>()).epsilon(1e-12));
    }
  }
  REQUIRE_THAT(testing::read_text(folder / "out" / "budget.md"),
               Contains("one candidate in 2 drawn uniformly"));

  // In the same folder; its runs leave folders that replay would write.
  const ProgramRun rssi =
      run_program(with(with(with({"study", "rssi"}, missions),
                            {"-o", (folder / "out").string(), "--keep-runs", "--json", "-"}),
                       quick));
  INFO(rssi.err);
  REQUIRE(rssi.status == kDone);
  json = parse_json(rssi.out, "standard output");
  const auto robots = rows_of(folder / "out" / "robots.csv");
  REQUIRE(robots.size() == 1 + 3 * 3 * 2);  // missions, methods, robots
  for (const Json& of_world : json.at("worlds")) {
    for (const char* robot : {"a", "b"}) {
      for (const char* of : {"odom", "rssi", "full"}) {
        const Json& entry = of_world.at("robots").at(robot).at(of);
        for (const char* figure : {"translation_percent", "max_m", "rotation_deg_per_m", "max_deg"}) {
          REQUIRE(entry.at(figure).at("median").get<double>() >= 0.0);
        }
      }
    }
  }
  std::size_t folders = 0;
  for (const auto& entry : fs::directory_iterator(folder / "out" / "runs")) {
    ++folders;
    for (const char* file : {"summary.json", "closures.csv", "history.csv", "graph.g2o", "journal.jsonl",
                             "map.pcd", "trajectories/a.tum"}) {
      CAPTURE(entry.path(), file);
      REQUIRE(fs::exists(entry.path() / file));
    }
  }
  REQUIRE(folders == 6);
}

TEST_CASE("study: finished runs survive an interrupt and a kill", "[apps][study][resume]") {
  const TemporaryFolder folder;
  const std::vector<std::string> missions = write_missions(folder);
  const auto study = [&](const std::string& out) {
    return with(with(with({"study", "ablation"}, missions),
                     {"-o", (folder / out).string(), "--methods", "baseline,random,full"}),
                kQuick);
  };
  REQUIRE(run_program(study("whole")).status == kDone);
  const auto units = [&] {
    std::size_t count = 0;
    if (!fs::exists(folder / "cut" / "units")) return count;
    for (const auto& entry : fs::directory_iterator(folder / "cut" / "units")) {
      count += entry.path().extension() == ".json" ? 1 : 0;
    }
    return count;
  };
  std::size_t ended = 0;
  for (int trial = 0; trial < 4 || (ended == 0 && trial < 20); ++trial) {
    const bool interrupt = trial % 4 == 1 || trial % 4 == 2;
    if (ended == 0)
      fs::remove_all(folder / "cut");  // on a busy machine the first may end before it is stopped
    const std::size_t at = units() + 1;
    Program program(with(study("cut"), {"--threads", "1"}));
    while (units() < at && program.running()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    interrupt ? program.interrupt() : program.kill();
    const ProgramRun run = program.finish();
    REQUIRE((run.status == kDone || run.status == (interrupt ? kInterrupted : kKilled)));
    ended += run.status == kDone ? 0 : 1;
    if (run.status == kInterrupted) REQUIRE_THAT(run.err, Contains("runs are kept"));
  }
  REQUIRE(ended > 0);
  const ProgramRun rest = run_program(with(study("cut"), {"--resume"}));
  REQUIRE(rest.status == kDone);
  REQUIRE_THAT(rest.err, Contains("of 9 runs are finished already"));
  require_same(results_of(folder / "cut"), results_of(folder / "whole"));
}

TEST_CASE("replay: killed at random moments and resumed, it ends with the same bytes", "[apps][resume]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission(16));
  const auto replay = [&](const std::string& out) {
    return with({"replay", (folder / "mission").string(), "-o", (folder / out).string(), "--method", "full",
                 "--resume"},
                with(kQuick, {"--outcomes", (folder / ("store-" + out)).string()}));
  };
  REQUIRE(run_program(replay("whole")).status == kDone);
  const auto outcomes = [&] {
    const fs::path path = folder / "cut" / "outcomes.jsonl";
    const std::string text = fs::exists(path) ? testing::read_text(path) : "";
    return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
  };
  Rng rng(11);
  std::size_t killed = 0;
  for (int trial = 0; trial < 5 || (killed == 0 && trial < 20); ++trial) {
    if (killed == 0)
      fs::remove_all(folder / "cut");  // on a busy machine the first may end before it is killed
    if (killed == 0) fs::remove_all(folder / "store-cut");
    const std::size_t at = outcomes() + 1 + rng.below(6);
    Program program(replay("cut"));
    while (outcomes() < at && program.running()) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::microseconds(rng.below(3000)));
    program.kill();
    killed += program.finish().status == kKilled ? 1 : 0;
  }
  REQUIRE(killed > 0);
  REQUIRE(run_program(replay("cut")).status == kDone);
  require_same(results_of(folder / "cut"), results_of(folder / "whole"));
}

TEST_CASE("replay: the folder of a run on a real clock has the same files", "[apps][live]") {
  const TemporaryFolder folder;
  write_mission(folder / "mission", small_mission());
  const fs::path out = folder / "out";
  const ProgramRun run =
      run_program({"replay", (folder / "mission").string(), "-o", out.string(), "--method", "random",
                   "--clock", "real", "--rate", "200", "--after-mission", "--skip-recent", "2", "--quiet",
                   "--json", "-", "--record-trace", (folder / "run.trace").string()});
  INFO(run.err);
  REQUIRE(run.status == kDone);
  const Json summary = parse_json(run.out, "standard output");
  REQUIRE(summary.at("candidates").at("computed").get<std::size_t>() > 10);
  REQUIRE(summary.at("candidates").at("pending") == 0);
  REQUIRE(summary.at("ate_m").at("optimized").get<double>() <
          summary.at("ate_m").at("odometry").get<double>());
  for (const char* file : {"summary.json", "closures.csv", "history.csv", "graph.g2o", "journal.jsonl",
                           "map.pcd", "picture.svg", "trajectories/b.tum"}) {
    CAPTURE(file);
    REQUIRE(fs::exists(out / file));
  }
  REQUIRE_FALSE(fs::exists(out / "outcomes.jsonl"));

  // It cannot be repeated, so nothing may replace it without --overwrite.
  const ProgramRun again =
      run_program({"replay", (folder / "mission").string(), "-o", out.string(), "--resume"});
  REQUIRE(again.status == kBadUsage);
  REQUIRE_THAT(again.err, Contains("--overwrite replaces it"));
  REQUIRE(fs::exists(out / "summary.json"));
  REQUIRE(fs::exists(out / "map.pcd"));

  // Its trace repeats it, with the mission or without.
  const std::string trace = (folder / "run.trace").string();
  for (const std::string& mission : {(folder / "mission").string(), std::string()}) {
    CAPTURE(mission);
    const fs::path repeated = folder / (mission.empty() ? "alone" : "with_mission");
    std::vector<std::string> words{"replay", "--trace", trace, "-o", repeated.string(), "--quiet"};
    if (!mission.empty()) words.push_back(mission);
    const ProgramRun once_more = run_program(words);
    INFO(once_more.err);
    REQUIRE(once_more.status == kDone);
    for (const char* file : {"closures.csv", "graph.g2o", "trajectories/a.tum"}) {
      CAPTURE(file);
      REQUIRE(testing::read_text(repeated / file) == testing::read_text(out / file));
    }
  }
  // What it does not write would be taken for its results.
  const fs::path alone = folder / "alone";
  const std::vector<std::string> former = {"map.ply",      "map.pcd",       "picture.svg",
                                           "odometry.csv", "journal.jsonl", "outcomes.jsonl"};
  for (const std::string& file : former) testing::write_text(alone / file, "of another run\n");
  REQUIRE(run_program({"replay", "--trace", trace, "-o", alone.string(), "--overwrite", "--quiet"}).status ==
          kDone);
  for (const std::string& file : former) {
    CAPTURE(file);
    REQUIRE_FALSE(fs::exists(alone / file));
  }
  require_failure({"replay", "--trace", trace, "-o", out.string(), "--method", "obs"}, kBadUsage, "--method");
  require_failure({"replay", "--trace", (folder / "none").string(), "-o", (folder / "x").string()}, kBadInput,
                  "none");
  require_failure({"replay", "-o", (folder / "x").string()}, kBadUsage, "MISSION is missing");
  require_failure(
      {"replay", (folder / "mission").string(), "-o", (folder / "x").string(), "--record-trace", trace},
      kBadUsage, "--record-trace needs --clock real");
}

}  // namespace loopwise::study_test
