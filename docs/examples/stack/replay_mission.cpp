// SPDX-License-Identifier: BSD-3-Clause
#include <cstdio>

#include <loopwise/replay/replay.hpp>

int main(int, char** argv) {
  using namespace loopwise;
  const Mission mission = read_mission(argv[1]);
  const ReplayResult result = replay(mission);
  for (const ComputedCandidate& computed : result.computed) {
    const LoopCandidate& pair = computed.result.candidate;
    if (computed.weight > 0.5)
      std::printf("%s - %s\n", key_name(pair.from).c_str(), key_name(pair.to).c_str());
  }
}
