// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A batch on two threads beside two processes of one thread that share the same pairs:
///   loopwise_registration_scaling MISSION [PAIRS] [ROUNDS]
/// Both run the same tasks with warm caches, each thread or process pinned to a processor of its own, in
/// turns. 1 is what two machines would reach; memory bandwidth and shared locks take from it.
#include <pthread.h>
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/task.hpp>

namespace loopwise::bench {
namespace {

constexpr int kProcessors = 2;

void pin(int processor) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<unsigned>(processor), &set);
  pthread_setaffinity_np(pthread_self(), sizeof set, &set);
}

void release() {
  cpu_set_t set;
  CPU_ZERO(&set);
  for (unsigned i = 0; i < kProcessors; ++i) CPU_SET(i, &set);
  pthread_setaffinity_np(pthread_self(), sizeof set, &set);
}

/// Pins each thread that computes, in turn.
class PinnedRegistrar final : public Registrar {
 public:
  explicit PinnedRegistrar(const Registrar& registrar) : registrar_(registrar) {}
  [[nodiscard]] std::string_view name() const override { return registrar_.name(); }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    thread_local const bool pinned = [this] {
      pin(next_.fetch_add(1) % kProcessors);
      return true;
    }();
    static_cast<void>(pinned);
    return registrar_.compute(task);
  }

 private:
  const Registrar& registrar_;
  mutable std::atomic<int> next_{0};
};

/// Pairs of nodes within 30 m of each other that are no neighbours, drawn uniformly.
std::vector<RegistrationTask> draw_tasks(const Mission& mission, std::size_t count) {
  const auto& nodes = mission.graph.nodes();
  std::vector<LoopCandidate> near;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    for (std::size_t j = 0; j + 10 < i; ++j) {
      if ((nodes[i].pose.translation() - nodes[j].pose.translation()).norm() > 30.0) continue;
      LoopCandidate candidate;
      candidate.from = nodes[i].key;
      candidate.to = nodes[j].key;
      near.push_back(candidate);
    }
  }
  Rng(1).shuffle(near);
  if (near.size() > count) near.resize(count);
  std::vector<RegistrationTask> tasks;
  for (const LoopCandidate& c : near) {
    tasks.push_back(
        make_task(mission.graph, mission.robots, c, {}, 1, [&](Key key) { return mission.scans->has(key); }));
  }
  return tasks;
}

std::shared_ptr<FeatureCache> features_of(const Mission& mission) {
  return std::make_shared<FeatureCache>(mission.scans->loader(), FeatureOptions());
}

/// Registrations per second of one process that takes every kProcessors-th task; written to `out` as text
/// once `go` says that all are warm.
[[noreturn]] void child(const Mission& mission, const std::vector<RegistrationTask>& tasks, int rank,
                        int ready, int go, int out) {
  pin(rank);
  std::vector<RegistrationTask> own;
  for (std::size_t i = static_cast<std::size_t>(rank); i < tasks.size(); i += kProcessors)
    own.push_back(tasks[i]);
  const FastRegistrar registrar(features_of(mission));
  ThreadPool one(1);
  static_cast<void>(compute_batch(registrar, own, one));
  char byte = 0;
  if (write(ready, &byte, 1) != 1 || read(go, &byte, 1) != 1) _exit(1);
  const Stopwatch watch;
  static_cast<void>(compute_batch(registrar, own, one));
  const double rate = static_cast<double>(own.size()) / watch.seconds();
  _exit(write(out, &rate, sizeof rate) == sizeof rate ? 0 : 1);
}

double processes(const Mission& mission, const std::vector<RegistrationTask>& tasks) {
  int ready[2], go[2], out[2];
  if (pipe(ready) != 0 || pipe(go) != 0 || pipe(out) != 0) throw InputError("no pipe");
  for (int rank = 0; rank < kProcessors; ++rank) {
    if (fork() == 0) child(mission, tasks, rank, ready[1], go[0], out[1]);
  }
  char bytes[kProcessors] = {};
  bool good = true;
  for (char& byte : bytes) good = good && read(ready[0], &byte, 1) == 1;
  good = good && write(go[1], bytes, kProcessors) == kProcessors;
  double sum = 0.0;
  for (int rank = 0; rank < kProcessors; ++rank) {
    double rate = 0.0;
    good = good && read(out[0], &rate, sizeof rate) == sizeof rate;
    sum += rate;
  }
  while (wait(nullptr) > 0) {
  }
  for (const int end : {ready[0], ready[1], go[0], go[1], out[0], out[1]}) close(end);
  if (!good) throw InputError("a process of the comparison ended early");
  return sum;
}

double threads(const Mission& mission, const std::vector<RegistrationTask>& tasks) {
  const FastRegistrar registrar(features_of(mission));
  const PinnedRegistrar pinned(registrar);
  ThreadPool pool(kProcessors);
  static_cast<void>(compute_batch(pinned, tasks, pool));
  const Stopwatch watch;
  static_cast<void>(compute_batch(pinned, tasks, pool));
  const double rate = static_cast<double>(tasks.size()) / watch.seconds();
  release();
  return rate;
}

void run(const std::string& folder, std::size_t count, int rounds) {
  const Mission mission = read_mission(folder, {});
  const std::vector<RegistrationTask> tasks = draw_tasks(mission, count);
  std::printf("%zu pairs of %s\n%-10s%12s%12s%9s\n", tasks.size(), mission.name.c_str(), "round", "processes",
              "threads", "ratio");
  std::vector<double> ratios;
  // Each measurement in a process of its own: one with threads must not fork.
  for (int round = 0; round < rounds; ++round) {
    const auto in_child = [&](double (*measure)(const Mission&, const std::vector<RegistrationTask>&)) {
      int out[2];
      if (pipe(out) != 0) throw InputError("no pipe");
      if (fork() == 0) {
        double rate = 0.0;
        try {
          rate = measure(mission, tasks);
        } catch (const std::exception& error) {
          std::fprintf(stderr, "%s\n", error.what());
          _exit(1);
        }
        _exit(write(out[1], &rate, sizeof rate) == sizeof rate ? 0 : 1);
      }
      close(out[1]);
      double rate = 0.0;
      const bool good = read(out[0], &rate, sizeof rate) == sizeof rate;
      close(out[0]);
      wait(nullptr);
      if (!good) throw InputError("a measurement ended early");
      return rate;
    };
    const double apart_rate = in_child(processes), together = in_child(threads);
    ratios.push_back(together / apart_rate);
    std::printf("%-10d%10.1f/s%10.1f/s%9.2f\n", round + 1, apart_rate, together, ratios.back());
  }
  std::sort(ratios.begin(), ratios.end());
  std::printf("median of the rounds' ratios %.2f\n", ratios[ratios.size() / 2]);
}

}  // namespace
}  // namespace loopwise::bench

int main(int argc, char** argv) {
  if (argc < 2) {
    std::printf("loopwise_registration_scaling MISSION [PAIRS] [ROUNDS]\n");
    return 2;
  }
  try {
    loopwise::bench::run(argv[1], argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 400,
                         argc > 3 ? std::max(1, std::atoi(argv[3])) : 5);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 3;
  }
  return 0;
}
