// SPDX-License-Identifier: BSD-3-Clause
// The first byte chooses: a complete file of a store, or the payload of a record with a valid checksum.
#include <loopwise/replay/outcome_store.hpp>

#include "target.hpp"

namespace {

using namespace loopwise;

template <class T>
void put(std::string& out, T value) {
  out.append(reinterpret_cast<const char*>(&value), sizeof value);
}

std::string record(const ContentHash& key, std::string_view payload) {
  std::string out;
  put<std::uint32_t>(out, 0x3157'4f4c);
  put(out, static_cast<std::uint32_t>(payload.size()));
  put(out, key.high);
  put(out, key.low);
  put(out,
      ContentHasher().integer(key.high).integer(key.low).bytes(payload.data(), payload.size()).finish().high);
  return out.append(payload);
}

}  // namespace

LOOPWISE_FUZZ_TARGET(outcome_store, bytes) {
  const bool whole = fuzz::take_choice(bytes, 2) == 0;
  if (bytes.size() > (std::size_t{1} << 20)) return;  // no record is larger
  const ContentHash key{1, 2};
  const auto folder = fuzz::scratch() / "store";
  std::filesystem::create_directories(folder);
  for (const auto& entry : std::filesystem::directory_iterator(folder)) std::filesystem::remove(entry.path());
  fuzz::put_file(folder / "outcomes-00000001.bin", whole ? std::string(bytes) : record(key, bytes));
  LoopCandidate candidate;
  candidate.from = 5;
  candidate.to = 3;
  OutcomeStore store(folder);
  const OutcomeStoreStatistics at_start = store.statistics();
  fuzz::expect(at_start.damaged_bytes <= bytes.size(), "no more is damaged than there is");
  fuzz::expect(whole || at_start.found_at_start == 1, "a record is found");
  bool computed = false;
  const RegistrationResult result = store.get(key, candidate, [&] {
    computed = true;
    RegistrationResult rejected;
    rejected.candidate = candidate;
    rejected.reason = RejectionReason::kLowOverlap;
    return rejected;
  });
  fuzz::expect(result.candidate.from == 5 && result.candidate.to == 3, "an outcome is of what was asked for");
  fuzz::expect((result.reason == RejectionReason::kNone) == result.closure.has_value(),
               "an outcome has a closure exactly if it is not rejected");
  fuzz::expect(store.statistics().computed == (computed ? 1u : 0u), "what was computed is counted");
}
