// SPDX-License-Identifier: BSD-3-Clause
#ifdef LOOPWISE_CATCH2_V3
#include <catch2/catch_session.hpp>
#include <catch2/catch_test_case_info.hpp>
#include <catch2/reporters/catch_reporter_event_listener.hpp>
#include <catch2/reporters/catch_reporter_registrars.hpp>
#else
#define CATCH_CONFIG_RUNNER
#include <catch2/catch.hpp>
#endif

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <string>
#include <thread>

namespace {

#ifdef LOOPWISE_CATCH2_V3
using ListenerBase = Catch::EventListenerBase;
#else
using ListenerBase = Catch::TestEventListenerBase;
#endif

/// Ends the program by SIGABRT, with the name of the test, if a test takes so long that it must be
/// deadlocked. LOOPWISE_TEST_WATCHDOG_S sets the seconds, 0 disables it.
class Watchdog : public ListenerBase {
 public:
  using ListenerBase::ListenerBase;

  void testCaseStarting(const Catch::TestCaseInfo& test) override {
    const char* given = std::getenv("LOOPWISE_TEST_WATCHDOG_S");
    const double seconds = given != nullptr ? std::strtod(given, nullptr) : 1200.0;
    if (!(seconds > 0.0)) return;
    ended_ = false;
    watch_ = std::thread([this, seconds, name = test.name] {
      std::unique_lock<std::mutex> lock(mutex_);
      if (end_.wait_for(lock, std::chrono::duration<double>(seconds), [this] { return ended_; })) return;
      std::fprintf(stderr, "watchdog: \"%s\" is not done after %g s\n", name.c_str(), seconds);
      std::abort();
    });
  }

  void testCaseEnded(const Catch::TestCaseStats&) override {
    if (!watch_.joinable()) return;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      ended_ = true;
    }
    end_.notify_one();
    watch_.join();
  }

 private:
  std::mutex mutex_;
  std::condition_variable end_;
  bool ended_ = false;
  std::thread watch_;
};

CATCH_REGISTER_LISTENER(Watchdog)

}  // namespace

int main(int argc, char** argv) {
  return Catch::Session().run(argc, argv);
}
