// SPDX-License-Identifier: BSD-3-Clause
// Folders of a run and of studies, of which one file is the fuzzer's. The first byte chooses which.
#include <nlohmann/json.hpp>

#include <loopwise/evaluation/report.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>

#include "mission_seeds.hpp"
#include "target.hpp"

LOOPWISE_FUZZ_TARGET(report, bytes) {
  using namespace loopwise;
  static const auto folder = [] {
    auto path = fuzz::scratch() / "runs";
    fuzz::write_seed_runs(path);
    return path;
  }();
  static ThreadPool threads(1);
  const auto& files = fuzz::seed_run_files();
  const auto& place = files[fuzz::take_choice(bytes, files.size())];
  const auto run = folder / place.first, file = run / place.second;
  const std::string ours = read_file(file);
  fuzz::put_file(file, bytes);
  const auto report = fuzz::attempt([&] { return make_report({run}, {}, {}, threads); });
  fuzz::put_file(file, ours);
  if (!report) return;
  fuzz::expect(report->runs + report->studies > 0, "a report shows something");
  if (fuzz::one_in(4, bytes)) {
    fuzz::expect(parse_json(report->data, "report").is_object(), "a report's data are JSON");
  }
}
