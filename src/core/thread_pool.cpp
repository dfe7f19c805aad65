// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/thread_pool.hpp>

#include <algorithm>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

/// One call of for_each(). The pool's mutex is held except during calls of the body. Tasks are coarse, so the
/// lock costs little.
struct Loop {
  Loop(std::size_t count_in, const std::function<void(std::size_t)>& body_in)
      : count(count_in), body(body_in) {}

  [[nodiscard]] bool begun() const { return next == count; }
  [[nodiscard]] bool done() const { return begun() && running == 0; }

  /// Runs tasks until all have begun.
  void run(std::unique_lock<std::mutex>& lock) {
    ++running;
    while (!begun()) {
      const std::size_t i = next++;
      std::exception_ptr thrown;
      lock.unlock();
      try {
        body(i);
      } catch (...) {
        thrown = std::current_exception();
      }
      lock.lock();
      if (thrown && (!error || i < error_index)) {
        error = std::move(thrown);
        error_index = i;
      }
    }
    if (--running == 0) idle.notify_all();
  }

  const std::size_t count;
  const std::function<void(std::size_t)>& body;
  std::size_t next = 0;
  int running = 0;
  std::condition_variable idle;
  std::exception_ptr error;
  std::size_t error_index = 0;
  Loop* following = nullptr;  // next loop in the pool's list
};

}  // namespace

/// The pool has its own threads and uses no library's arena: the number of threads of such an arena is a
/// setting of the whole process, which belongs to the calling program.
struct ThreadPool::Impl {
  ~Impl() { end(); }

  /// Starts threads up to this number, or fewer if memory or threads run out.
  void start(std::size_t count) {
    try {
      workers.reserve(count);
      while (workers.size() < count) workers.emplace_back([this] { work(); });
    } catch (const std::exception&) {
    }
  }

  void work() {
    std::unique_lock<std::mutex> lock(mutex);
    while (true) {
      some.wait(lock, [this] { return ending || waiting() != nullptr; });
      if (ending) return;
      waiting()->run(lock);
    }
  }

  /// The first loop with tasks that have not begun, or null.
  [[nodiscard]] Loop* waiting() const {
    Loop* loop = first;
    while (loop != nullptr && loop->begun()) loop = loop->following;
    return loop;
  }

  void add(Loop& loop) {
    Loop** end = &first;
    while (*end != nullptr) end = &(*end)->following;
    *end = &loop;
  }
  void remove(const Loop& loop) {
    Loop** at = &first;
    while (*at != &loop) at = &(*at)->following;
    *at = loop.following;
  }

  void end() {
    {
      const std::lock_guard<std::mutex> lock(mutex);
      ending = true;
      some.notify_all();
    }
    for (std::thread& worker : workers) worker.join();
    workers.clear();
    ending = false;
  }

  int threads = 1;
  std::mutex mutex;  // guards the members below and all loops
  std::condition_variable some;
  std::vector<std::thread> workers;
  Loop* first = nullptr;
  bool ending = false;
};

int resolve_threads(int threads) {
  if (threads < 0) throw OptionError("threads = " + std::to_string(threads) + ", must be >= 0");
  return threads > 0 ? threads : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
}

ThreadPool::ThreadPool(int threads) : impl_(std::make_unique<Impl>()) {
  resize(threads);
}
ThreadPool::~ThreadPool() = default;

int ThreadPool::num_threads() const {
  return impl_->threads;
}

void ThreadPool::resize(int threads) {
  threads = resolve_threads(threads);
  if (threads != impl_->threads) impl_->end();
  impl_->threads = threads;
}

void ThreadPool::for_each(std::size_t count, const std::function<void(std::size_t)>& body) {
  if (count == 0) return;
  Impl& pool = *impl_;
  const auto threads = static_cast<std::size_t>(pool.threads);
  Loop loop(count, body);
  {
    std::unique_lock<std::mutex> lock(pool.mutex);
    if (threads > 1) {
      pool.start(std::min(count, threads));
      pool.add(loop);
      pool.some.notify_all();
    }
    if (threads == 1 || pool.workers.size() < std::min(count, threads)) loop.run(lock);
    loop.idle.wait(lock, [&] { return loop.done(); });
    if (threads > 1) pool.remove(loop);
  }
  if (loop.error) std::rethrow_exception(std::exchange(loop.error, nullptr));
}

}  // namespace loopwise
