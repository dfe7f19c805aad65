// SPDX-License-Identifier: BSD-3-Clause
#include <cstdio>

#include <loopwise/pipeline/replay.hpp>
#include <loopwise/registration/fast_registrar.hpp>

int main(int, char** argv) {
  using namespace loopwise;
  const Mission mission = read_mission(argv[1]);
  const auto features = std::make_shared<FeatureCache>(mission.scans->loader());
  const auto registrar = std::make_shared<FastRegistrar>(features);
  ThreadPool threads;
  const ReplayResult result = MissionReplay(mission, Config(), features, registrar).run(threads);
  for (const ComputedCandidate& computed : result.computed) {
    const LoopCandidate& pair = computed.result.candidate;
    if (computed.weight > 0.5)
      std::printf("%s - %s\n", key_name(pair.from).c_str(), key_name(pair.to).c_str());
  }
}
