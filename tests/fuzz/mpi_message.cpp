// SPDX-License-Identifier: BSD-3-Clause
// Messages between ranks. The first byte chooses: a task or a result.
#include <loopwise/distributed/registration.hpp>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(mpi_message, bytes) {
  using namespace loopwise;
  if (fuzz::take_choice(bytes, 2) == 0) {
    const auto task = fuzz::attempt([&] { return unpack_task(bytes); });
    if (!task) return;
    fuzz::expect(!std::string(enum_name(task->candidate.source)).empty(), "a source has a name");
    const std::string again = pack_task(*task);
    fuzz::expect(pack_task(unpack_task(again)) == again, "packed and unpacked again: the same");
  } else {
    const auto result = fuzz::attempt([&] { return unpack_result(bytes, {}); });
    if (!result) return;
    fuzz::expect(enum_name(result->reason).empty() == result->verified(), "a reason has a name");
    fuzz::expect((result->reason == RejectionReason::kNone) == result->closure.has_value(),
                 "a result has a closure exactly if it is not rejected");
    const std::string again = pack_result(*result);
    fuzz::expect(pack_result(unpack_result(again, {})) == again, "packed and unpacked again: the same");
  }
}
