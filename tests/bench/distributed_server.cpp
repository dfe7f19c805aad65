// SPDX-License-Identifier: BSD-3-Clause
// Cost for rank 0 of each registration that another rank computes, measured alone: packing the task, its
// queues, and unpacking the result. Ranks answer at once and without MPI, whose cost
// loopwise_distributed_messages measures.
#include <cstdio>
#include <cstdlib>
#include <deque>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/distributed/registration.hpp>

#include "tags.hpp"

namespace {

using namespace loopwise;

/// Ranks that answer immediately, always with the same result.
class Echo final : public Transport {
 public:
  Echo(int size, std::string answer) : size_(size), answer_(std::move(answer)) {
    for (int rank = 1; rank < size; ++rank) waiting_.push_back({rank, detail::kGreeting, "hello"});
  }
  [[nodiscard]] int rank() const override { return 0; }
  [[nodiscard]] int size() const override { return size_; }
  void send(int to, int tag, std::string_view bytes) override {
    if (tag == detail::kRequest)
      waiting_.push_back({to, detail::kAnswer, std::string(bytes.substr(0, 8)) + answer_});
  }
  [[nodiscard]] std::optional<Message> receive() override {
    if (waiting_.empty()) return std::nullopt;
    Message message = std::move(waiting_.front());
    waiting_.pop_front();
    return message;
  }

 private:
  int size_;
  std::string answer_;
  std::deque<Message> waiting_;
};

class Nobody final : public Registrar {
 public:
  [[nodiscard]] std::string_view name() const override { return "nobody"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask&) const override { std::abort(); }
};

}  // namespace

int main(int argc, char** argv) {
  const std::size_t count = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 200000;
  Rng rng(1);
  std::vector<RegistrationTask> tasks;
  for (std::size_t i = 0; i < count; ++i) {
    RegistrationTask task = pair_task(1000 + i, i / 20, i);
    task.guess_from_to = Eigen::Isometry3d::Identity();
    for (Key neighbour = 1; neighbour <= 4; ++neighbour) {
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      T.translation().x() = 2.0 * static_cast<double>(neighbour);
      task.target.push_back({neighbour, T});
    }
    tasks.push_back(std::move(task));
  }
  RegistrationResult result;
  result.T_from_to = Eigen::Isometry3d::Identity();
  result.closure.emplace();
  std::printf("ranks,registrations,results_per_s,request_bytes,answer_bytes\n");
  for (const int ranks : {2, 8, 64, 512}) {
    Echo transport(ranks, pack_result(result));
    const auto server = std::make_shared<WorkServer>(transport, "hello");
    const BatchComputer compute = distributed_batches(server, std::make_shared<Nobody>(), 0);
    const Stopwatch watch;
    const auto results = compute(tasks, {}, {}, {});
    const double seconds = watch.seconds();
    const WorkStatistics& s = server->statistics();
    std::printf("%d,%zu,%.0f,%.0f,%.0f\n", ranks, results.size(), static_cast<double>(count) / seconds,
                static_cast<double>(s.request_bytes) / static_cast<double>(s.requests),
                static_cast<double>(s.answer_bytes) / static_cast<double>(s.answers));
  }
  return 0;
}
