// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/thread_pool.hpp>

#include <atomic>
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <loopwise/core/error.hpp>

#ifdef __SANITIZE_THREAD__
#include <sanitizer/tsan_interface.h>
#endif

namespace loopwise {
namespace {

/// Work of one for_each. Indices and the end of the work pass through one mutex: tasks are coarse, so it
/// costs nothing, and it orders memory between threads in a way that sanitizers can see.
class Loop {
 public:
  Loop(std::size_t count, const std::function<void(std::size_t)>& body) : count_(count), body_(body) {}

  /// Takes part until nothing is left. Who comes late finds nothing, and does not touch the body.
  void run() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++running_;
    }
    for (std::optional<std::size_t> i = next(); i; i = next()) {
      try {
        body_(*i);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!error_ || *i < error_index_) {
          error_ = std::current_exception();
          error_index_ = *i;
        }
      }
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    ++ended_;
    if (--running_ == 0) idle_.notify_all();
  }

  /// For the end of all work, and that so many have taken part.
  void wait(int runners) {
    std::unique_lock<std::mutex> lock(mutex_);
    idle_.wait(lock, [&] { return next_ == count_ && running_ == 0 && ended_ >= runners; });
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
  }

  /// enqueue() orders what came before it before the task, but the thread sanitizer cannot see into TBB. Told
  /// of the hand-over here, it finds the races inside our tasks and takes none of TBB's bookkeeping for one.
  void hand_over() {
#ifdef __SANITIZE_THREAD__
    __tsan_release(this);
#endif
  }

  void own() {
    ++owners_;
  }
  /// The last who does destroys it: where not all come that were called, nobody waits for them.
  void disown() {
    if (--owners_ == 0) delete this;
  }

 private:
  ~Loop() = default;

  std::optional<std::size_t> next() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return next_ < count_ ? std::optional<std::size_t>(next_++) : std::nullopt;
  }

  const std::size_t count_;
  const std::function<void(std::size_t)>& body_;
  std::mutex mutex_;
  std::condition_variable idle_;
  std::size_t next_ = 0;
  int running_ = 0, ended_ = 0;
  std::atomic<int> owners_{0};
  std::exception_ptr error_;
  std::size_t error_index_ = 0;
};

#ifdef __SANITIZE_THREAD__
#define LOOPWISE_NOT_WATCHED __attribute__((no_sanitize_thread, noinline))
#else
#define LOOPWISE_NOT_WATCHED
#endif

/// What TBB runs, and who owns the loop: a pointer that counts. It travels through TBB before the hand-over
/// is known, so that reading it is not watched. (The analyser cannot tell how far it has counted.)
// NOLINTBEGIN(clang-analyzer-cplusplus.NewDelete)
class LoopPointer {
 public:
  explicit LoopPointer(Loop& loop) : loop_(&loop) { loop_->own(); }
  LOOPWISE_NOT_WATCHED LoopPointer(const LoopPointer& other) : loop_(other.loop_) { loop_->own(); }
  LOOPWISE_NOT_WATCHED ~LoopPointer() { loop_->disown(); }
  LoopPointer& operator=(const LoopPointer&) = delete;

  LOOPWISE_NOT_WATCHED void operator()() const {
#ifdef __SANITIZE_THREAD__
    __tsan_acquire(loop_);
#endif
    loop_->run();
  }
  /// For whoever waits; see Loop::wait().
  Loop* operator->() const {
    return loop_;
  }

 private:
  Loop* loop_;
};
// NOLINTEND(clang-analyzer-cplusplus.NewDelete)

}  // namespace

struct ThreadPool::Impl {
  int num_threads = 1;
  // TBB starts no more workers than processors minus one unless told; the pool's size is the user's choice.
  std::unique_ptr<tbb::global_control> limit;
  std::unique_ptr<tbb::task_arena> arena;
};

ThreadPool::ThreadPool(int num_threads) : impl_(std::make_unique<Impl>()) {
  resize(num_threads);
}
ThreadPool::~ThreadPool() = default;

int ThreadPool::num_threads() const {
  return impl_->num_threads;
}

void ThreadPool::resize(int num_threads) {
  if (num_threads < 0) throw OptionError("threads = " + std::to_string(num_threads) + ", must be >= 0");
  if (num_threads == 0) num_threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  impl_->num_threads = num_threads;
  impl_->arena.reset();
  impl_->limit.reset();
  if (num_threads > 1) {
    impl_->limit = std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism,
                                                         static_cast<std::size_t>(num_threads) + 1);
    impl_->arena = std::make_unique<tbb::task_arena>(num_threads, 0);
  }
}

void ThreadPool::for_each(std::size_t count, const std::function<void(std::size_t)>& body) {
  if (count == 0) return;
  const auto runners =
      static_cast<int>(std::min<std::size_t>(count, static_cast<std::size_t>(impl_->num_threads)));
  const LoopPointer loop(*new Loop(count, body));
  int called = 0;
  if (impl_->arena) {
    loop->hand_over();
    try {
      for (; called < runners; ++called) impl_->arena->enqueue(LoopPointer(loop));
    } catch (...) {  // no memory, or no thread: whoever comes helps this one
      called = 0;
      loop();
    }
  } else {
    loop();
  }
  loop->wait(called);
}

}  // namespace loopwise
