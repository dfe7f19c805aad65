// SPDX-License-Identifier: BSD-3-Clause
// Cost of a message for rank 0 in MPI: mpirun -n 2 loopwise_distributed_messages [COUNT]. Rank 1 answers each
// request; eight are in progress at a time, as with a few ranks that compute.
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>

#include <loopwise/core/clock.hpp>
#include <loopwise/distributed/mpi_session.hpp>

#include "tags.hpp"

namespace {

double thread_cpu_s() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace loopwise;
  MpiSession session;
  Transport& transport = session.transport();
  const int count = argc > 1 ? std::atoi(argv[1]) : 200000;
  constexpr int kUnderWay = 8;
  const std::string request(560, 'r'), answer(380, 'a');
  if (transport.size() < 2) {
    std::fprintf(stderr, "loopwise_distributed_messages: start it with mpirun -n 2\n");
    return 2;
  }
  if (transport.rank() > 1) return 0;
  if (transport.rank() == 1) {
    for (int left = count; left > 0;) {
      if (!transport.receive()) continue;
      transport.send(0, detail::kAnswer, answer);
      --left;
    }
    return 0;
  }
  const Stopwatch watch;
  const double before = thread_cpu_s();
  double waiting = 0.0;
  int sent = 0, received = 0;
  while (received < count) {
    for (; sent < count && sent - received < kUnderWay; ++sent) transport.send(1, detail::kRequest, request);
    const double start = thread_cpu_s();
    if (transport.receive()) {
      ++received;
    } else {
      waiting += thread_cpu_s() - start;  // nothing there: not the message's cost
    }
  }
  const double busy = thread_cpu_s() - before - waiting;
  std::printf("messages,per_s,cpu_us_per_request_and_answer\n%d,%.0f,%.2f\n", count,
              static_cast<double>(count) / watch.seconds(), 1e6 * busy / count);
  return 0;
}
