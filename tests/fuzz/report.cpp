// SPDX-License-Identifier: BSD-3-Clause
// Folders of a run and of studies, of which one file is the fuzzer's. The first byte chooses which.
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/report.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>

#include "mission_seeds.hpp"
#include "target.hpp"

namespace {

using namespace loopwise;
namespace fs = std::filesystem;

/// Only the nodes of a graph, because the files beside the fuzzer's file are read for each input.
std::string nodes_of(const std::string& graph) {
  std::istringstream lines(graph);
  std::string nodes;
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind("VERTEX_", 0) == 0) nodes += line + "\n";
  }
  return nodes;
}

/// For each file, a folder with only this file and those that its reader needs. A report of this folder is
/// several times as fast as one of all files, which one input in 64 uses.
std::vector<fs::path> folders_of_one(const fs::path& whole, const fs::path& parent) {
  const auto& files = fuzz::seed_run_files();
  std::vector<fs::path> folders;
  for (const auto& [folder, name] : files) {
    folders.push_back(parent / std::to_string(folders.size()));
    std::vector<std::string> beside;
    if (folder == "run") beside = {"summary.json"};
    if (name == "journal.jsonl") beside.emplace_back("closures.csv");
    if (name == "map.pcd") beside.emplace_back("graph.g2o");
    if (name == "trajectories/husky.tum")
      beside.insert(beside.end(), {"graph.g2o", "trajectories/husky_odometry.tum"});
    if (name == "ablation.json" || name == "units/one.json") beside.emplace_back("runs.csv");
    beside.push_back(name);
    for (const std::string& file : beside) {
      fs::create_directories((folders.back() / file).parent_path());
      const std::string contents = read_file(whole / folder / file);
      const bool is_beside = name != file;
      write_file(folders.back() / file, is_beside && file == "graph.g2o"      ? nodes_of(contents)
                                        : is_beside && file == "summary.json" ? "{}"
                                                                              : contents);
    }
  }
  return folders;
}

/// The file keeps the contents; code that reads its folder for another file restores the former ones.
void check_report(const fs::path& folder, const std::string& name, std::string_view bytes) {
  static ThreadPool threads(1);
  fuzz::put_file(folder / name, bytes);
  const auto report = fuzz::attempt([&] { return make_report({folder}, {}, {}, threads); });
  if (!report) return;
  fuzz::expect(report->runs + report->studies > 0, "a report shows something");
  if (fuzz::one_in(16, bytes)) {
    fuzz::expect(parse_json(report->data, "report").is_object(), "a report's data are JSON");
  }
}

}  // namespace

LOOPWISE_FUZZ_TARGET(report, bytes) {
  const auto& files = fuzz::seed_run_files();
  static const fs::path whole = [] {
    auto path = fuzz::scratch() / "runs";
    fuzz::write_seed_runs(path);
    return path;
  }();
  static const std::vector<fs::path> folders = folders_of_one(whole, fuzz::scratch() / "runs_of_one");
  const std::size_t chosen = fuzz::take_choice(bytes, files.size());
  check_report(folders[chosen], files[chosen].second, bytes);
  if (!fuzz::one_in(64, bytes)) return;
  const fs::path folder = whole / files[chosen].first;
  const std::string ours = read_file(folder / files[chosen].second);
  check_report(folder, files[chosen].second, bytes);
  fuzz::put_file(folder / files[chosen].second, ours);
}
