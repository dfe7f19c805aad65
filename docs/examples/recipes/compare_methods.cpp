// SPDX-License-Identifier: BSD-3-Clause
// compare_methods MISSION FOLDER: methods over missions and seeds, as a table. A study that was stopped
// continues.
#include <cstdio>

#include <loopwise/study/study.hpp>

int main(int argc, char** argv) {
  using namespace loopwise;
  if (argc != 3) return 2;
  study::StudyOptions options;
  options.missions = {{argv[1], {}}};  // each with ground truth
  options.folder = argv[2];
  options.config.replay.max_registrations = 20;  // keeps the example short
  study::AblationOptions wanted;
  wanted.methods = {"baseline", "obs"};
  const auto report = study::ablation(options, wanted);
  if (!report) return 1;  // stopped
  std::printf("%s\n", report->markdown.c_str());
}
