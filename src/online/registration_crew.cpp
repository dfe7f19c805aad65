// SPDX-License-Identifier: BSD-3-Clause
#include "registration_crew.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <iterator>
#include <tuple>
#include <utility>

#include <loopwise/core/thread_pool.hpp>
#include <loopwise/registration/batch.hpp>

namespace loopwise {
namespace {

/// The clock's type cannot represent the end of an arbitrarily long pause.
constexpr double kLongestPause_s = 3600.0;

}  // namespace

RegistrationCrew::RegistrationCrew(const Registrar& registrar, int threads, double overdue_after_s,
                                   Hooks hooks)
    : registrar_(registrar), overdue_after_s_(overdue_after_s), hooks_(std::move(hooks)) {
  threads = resolve_threads(threads);
  threads_ = static_cast<std::size_t>(threads);
  try {
    for (int i = 0; i < threads; ++i) {
      Worker& worker = workers_.emplace_back();
      start(worker);
    }
  } catch (...) {
    end();
    throw;
  }
}

RegistrationCrew::~RegistrationCrew() {
  end();
}

bool RegistrationCrew::is_own_thread() {
  const std::lock_guard<std::mutex> lock(mutex_);
  return std::any_of(workers_.begin(), workers_.end(),
                     [](const Worker& worker) { return worker.id == std::this_thread::get_id(); });
}

void RegistrationCrew::start(Worker& worker) {
  worker.thread = std::thread([this, &worker] { work(worker); });
  worker.id = worker.thread.get_id();
}

void RegistrationCrew::end() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    ending_ = true;
    some_.notify_all();
  }
  for (Worker& worker : workers_) {
    if (worker.thread.joinable()) worker.thread.join();
  }
}

void RegistrationCrew::work(Worker& self) {
  std::unique_lock<std::mutex> lock(mutex_);
  while (true) {
    some_.wait(lock, [this] { return ending_ || !tasks_.empty(); });
    if (tasks_.empty()) return;
    const RegistrationTask task = std::move(tasks_.front());
    tasks_.pop_front();
    if (stop_.stop_requested()) {
      not_begun_.push_back(task.candidate);
      changed_.notify_all();
      continue;
    }
    self.busy = true;
    self.overdue = false;
    self.candidate = task.candidate;
    self.watch = Stopwatch();
    changed_.notify_all();
    lock.unlock();
    hooks_.result(compute_or_fail(registrar_, task));
    lock.lock();
    self.busy = false;
    if (self.overdue && hooks_.back) {
      lock.unlock();
      hooks_.back();
      lock.lock();
    }
    changed_.notify_all();
    if (self.overdue && spares_ > 0) {
      --spares_;
      self.ended = true;
      return;
    }
  }
}

bool RegistrationCrew::finished() const {
  return tasks_.empty() && std::none_of(workers_.begin(), workers_.end(),
                                        [](const Worker& worker) { return worker.busy && !worker.overdue; });
}

void RegistrationCrew::report_overdue() {
  for (Worker& worker : workers_) {
    if (!worker.busy || worker.overdue || worker.watch.seconds() < overdue_after_s_) continue;
    worker.overdue = true;
    if (hooks_.overdue) hooks_.overdue(worker.candidate, worker.watch.seconds());
  }
}

void RegistrationCrew::replace_hanging() {
  const auto hangs = [](const Worker& worker) { return worker.ended || (worker.busy && worker.overdue); };
  if (tasks_.empty() || spares_ == threads_ || !std::all_of(workers_.begin(), workers_.end(), hangs)) return;
  const auto ended =
      std::find_if(workers_.begin(), workers_.end(), [](const Worker& worker) { return worker.ended; });
  try {
    Worker& worker = ended == workers_.end() ? workers_.emplace_back() : *ended;
    worker.ended = true;
    if (worker.thread.joinable())
      worker.thread.join();         // the thread has released the mutex and is about to end
    worker.id = std::thread::id();  // a later thread may get the same id
    start(worker);
    worker.ended = worker.overdue = false;
    ++spares_;
  } catch (const std::exception&) {
    // No memory or no threads: the next attempt follows when another registration is overdue or returns.
  }
}

void RegistrationCrew::pause(std::unique_lock<std::mutex>& lock, double seconds) {
  const auto length = std::chrono::duration<double>(seconds);
#ifdef __SANITIZE_THREAD__
  // The thread sanitizer of GCC 12 does not support waits on the steady clock.
  changed_.wait_until(lock, std::chrono::system_clock::now() +
                                std::chrono::duration_cast<std::chrono::system_clock::duration>(length));
#else
  changed_.wait_for(lock, length);  // on the steady clock, because the system clock may be set
#endif
}

std::vector<LoopCandidate> RegistrationCrew::run(std::vector<RegistrationTask> tasks, const StopToken& stop) {
  // Pairs with the same target follow each other, as in compute_batch().
  std::sort(tasks.begin(), tasks.end(), [](const RegistrationTask& a, const RegistrationTask& b) {
    return std::tie(a.candidate.to, a.candidate.from) < std::tie(b.candidate.to, b.candidate.from);
  });
  std::deque<RegistrationTask> queue(std::make_move_iterator(tasks.begin()),
                                     std::make_move_iterator(tasks.end()));
  std::unique_lock<std::mutex> lock(mutex_);
  not_begun_.clear();
  not_begun_.reserve(queue.size());
  stop_ = stop;
  tasks_ = std::move(queue);
  some_.notify_all();
  replace_hanging();  // threads may hang in registrations of an earlier batch
  while (!finished()) {
    if (overdue_after_s_ <= 0.0) {
      changed_.wait(lock);
      continue;
    }
    double soonest_s = std::min(overdue_after_s_, kLongestPause_s);
    for (const Worker& worker : workers_) {
      if (worker.busy && !worker.overdue) {
        soonest_s = std::min(soonest_s, overdue_after_s_ - worker.watch.seconds());
      }
    }
    pause(lock, std::max(0.001, soonest_s));
    report_overdue();
    replace_hanging();
  }
  return std::exchange(not_begun_, {});
}

}  // namespace loopwise
