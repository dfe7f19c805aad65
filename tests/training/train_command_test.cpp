// SPDX-License-Identifier: BSD-3-Clause
#include <chrono>
#include <thread>

#include <nlohmann/json.hpp>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/mission.hpp>

#include "apps/program.hpp"
#include "missions.hpp"
#include "testing.hpp"

namespace loopwise::train_command_test {
namespace {

using testing::Program;
using testing::ProgramRun;
using testing::run_program;
using testing::TemporaryFolder;
namespace fs = std::filesystem;

/// Waits until a training has finished an epoch.
void wait_for(const fs::path& file, Program& program) {
  while (!fs::exists(file) && program.running()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
}

}  // namespace

TEST_CASE("loopwise-train: from data to a judgement", "[train][program]") {
  const TemporaryFolder folder;
  const std::string data = (folder / "data").string(), run = (folder / "run").string();
  testing::write_small_data_set(data, 4);
  const ProgramRun fit = run_program({"fit", data, "-o", run, "--epochs", "2", "--quiet", "--json", "-"});
  CAPTURE(fit.err);
  REQUIRE(fit.status == 0);
  REQUIRE(nlohmann::json::parse(fit.out).at("epochs") == 2);
  fs::rename(run + "/checkpoint.cbor", folder / "aside");
  REQUIRE(run_program({"fit", data, "-o", run, "--epochs", "2", "--resume"}).status == 2);
  fs::rename(folder / "aside", run + "/checkpoint.cbor");
  const ProgramRun judge_run =
      run_program({"evaluate", data, run + "/weights.json", "--quiet", "--set", "judge.set_sizes=3", "--set",
                   "judge.sets=5", "--set", "judge.evaluations=150", "--set", "judge.swaps=10"});
  CAPTURE(judge_run.err);
  REQUIRE(judge_run.status == 0);
  REQUIRE_THAT(judge_run.out, Contains("| 3 | weights |"));
  // What was trained with is not tested.
  const ProgramRun other = run_program({"evaluate", data, run + "/weights.json", "--split-seed", "2"});
  if (other.status != 0) {
    REQUIRE(other.status == 3);
    REQUIRE_THAT(other.err, Contains("was trained with mission"));
  }
}

TEST_CASE("loopwise-train: interrupted or killed, and resumed", "[train][program]") {
  const TemporaryFolder folder;
  const std::string data = (folder / "data").string();
  testing::write_small_data_set(data, 3);
  const auto words = [&](const std::string& run) {
    return std::vector<std::string>{"fit",      data,      "-o",      (folder / run).string(),
                                    "--epochs", "12",      "--quiet", "--patience",
                                    "100",      "--resume"};
  };
  REQUIRE(run_program(words("whole")).status == 0);
  const std::string whole = read_file(folder / "whole" / "weights.json");
  {
    Program program(words("interrupted"));
    wait_for(folder / "interrupted" / "history.csv", program);
    program.interrupt();
    const ProgramRun run = program.finish();
    REQUIRE((run.status == 130 || run.status == 0));
    REQUIRE(run_program(words("interrupted")).status == 0);
    REQUIRE(read_file(folder / "interrupted" / "weights.json") == whole);
  }
  Program program(words("killed"));
  wait_for(folder / "killed" / "history.csv", program);
  program.kill();
  (void)program.finish();
  REQUIRE(run_program(words("killed")).status == 0);
  REQUIRE(read_file(folder / "killed" / "weights.json") == whole);
  REQUIRE(read_file(folder / "killed" / "history.csv") == read_file(folder / "whole" / "history.csv"));
}

TEST_CASE("loopwise-train: data of recorded missions, resumed", "[train][program]") {
  const TemporaryFolder folder;
  std::vector<std::string> words{"data"};
  for (int k = 0; k < 3; ++k) {
    const auto record = testing::small_record("walk", static_cast<std::uint64_t>(k + 1));
    Mission mission;
    mission.name = "walk" + std::to_string(k);
    mission.robots = record.robots;
    mission.graph = record.graph;
    write_mission(folder / mission.name, mission);
    words.push_back((folder / mission.name).string());
  }
  for (const char* word : {"--quiet", "--json", "-", "--set", "data.candidates=12", "--set",
                           "data.random_sets=8", "--set", "data.annealing_runs=0", "-o"}) {
    words.emplace_back(word);
  }
  words.push_back((folder / "data").string());
  const ProgramRun made = run_program(words);
  CAPTURE(made.err);
  REQUIRE(made.status == 0);
  REQUIRE(nlohmann::json::parse(made.out).at("missions") == 3);
  REQUIRE(run_program(words).status == 2);  // the folder is not empty
  fs::remove(folder / "data" / "dataset.json");
  fs::resize_file(folder / "data" / "missions" / "walk1.cbor", 100);
  words.emplace_back("--resume");
  const ProgramRun again = run_program(words);
  CAPTURE(again.err);
  REQUIRE(again.status == 0);
  REQUIRE(nlohmann::json::parse(again.out).at("kept") == 2);

  // Data of another odometry do not belong to this mission, although the nodes' positions are equal.
  const fs::path graph = folder / "walk2" / "graph.g2o";
  std::string text = read_file(graph);
  text.insert(text.rfind(' ') + 1, "1");
  testing::write_text(graph, text);
  fs::remove(folder / "data" / "dataset.json");
  const ProgramRun mended = run_program(words);
  CAPTURE(mended.err);
  REQUIRE(mended.status == 0);
  REQUIRE(nlohmann::json::parse(mended.out).at("kept") == 2);

  // A set that is made again with other options is invalid until it is complete: the second mission cannot be
  // written.
  const fs::path second = folder / "data" / "missions" / "walk1.cbor";
  REQUIRE(fs::exists(folder / "data" / "dataset.json"));
  fs::remove(second);
  fs::create_directories(second / "in_the_way");
  words.insert(words.end(), {"--set", "data.random_sets=9", "--threads", "1"});
  REQUIRE(run_program(words).status == 3);
  REQUIRE_FALSE(fs::exists(folder / "data" / "dataset.json"));
}

TEST_CASE("loopwise-train: bad usage and bad data", "[train][program][error]") {
  const TemporaryFolder folder;
  const std::string run = (folder / "run").string();
  REQUIRE(run_program({}).status == 2);
  REQUIRE(run_program({"fit", "--nonsense"}).status == 2);
  const ProgramRun absent = run_program({"fit", (folder / "absent").string(), "-o", run});
  REQUIRE(absent.status == 3);
  REQUIRE_THAT(absent.err, Contains("no dataset.json"));
  const std::string data = (folder / "one").string();
  testing::write_small_data_set(data, 1);
  const ProgramRun one = run_program({"fit", data, "-o", run});
  REQUIRE(one.status == 3);
  REQUIRE_THAT(one.err, Contains("3 are needed"));
  testing::write_small_data_set(folder / "three", 3);
  const ProgramRun option =
      run_program({"fit", (folder / "three").string(), "-o", run, "--set", "fit.epoch=3"});
  REQUIRE(option.status == 2);
  REQUIRE_THAT(option.err, Contains("fit.epochs"));
  REQUIRE(run_program({"fit", (folder / "three").string(), "-o", run, "--set", "data.seed=3"}).status == 2);
  REQUIRE(run_program({"fit", (folder / "three").string(), "-o", run, "--target", "trace"}).status == 2);
  for (const auto& entry : fs::directory_iterator(folder / "three" / "missions")) {
    fs::resize_file(entry.path(), fs::file_size(entry.path()) / 2);
  }
  const ProgramRun cut = run_program({"fit", (folder / "three").string(), "-o", run});
  REQUIRE(cut.status == 3);
  REQUIRE_THAT(cut.err, Contains("cut short"));
}

}  // namespace loopwise::train_command_test
