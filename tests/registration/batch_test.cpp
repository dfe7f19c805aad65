// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/registration/batch.hpp>

#include <atomic>
#include <new>

#include <loopwise/core/error.hpp>
#include "testing.hpp"

namespace loopwise::batch_test {
namespace {

/// Accepts even `from`, rejects odd, throws for 7; may stop the batch at a number of calls.
class FakeRegistrar final : public Registrar {
 public:
  explicit FakeRegistrar(StopSource* stop = nullptr, int stop_at = 0) : stop_(stop), stop_at_(stop_at) {}
  [[nodiscard]] std::string_view name() const override { return "fake"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    if (++calls_ == stop_at_) stop_->request_stop();
    if (task.candidate.from == 7) throw InputError("seven");
    RegistrationResult result;
    result.candidate = task.candidate;
    if (task.candidate.from % 2 == 0) {
      result.closure = LoopClosure{task.candidate.from, task.candidate.to};
    } else {
      result.reason = RejectionReason::kFewMatches;
    }
    return result;
  }
  [[nodiscard]] int calls() const { return calls_; }

 private:
  StopSource* stop_;
  int stop_at_;
  mutable std::atomic<int> calls_{0};
};

std::vector<RegistrationTask> tasks(Key count) {
  std::vector<RegistrationTask> out;
  for (Key i = 0; i < count; ++i) out.push_back(pair_task(i, 100, i));
  return out;
}

TEST_CASE("compute_batch: results in the order of the tasks; an exception becomes a reason", "[batch]") {
  const int threads = GENERATE(1, 2, 4);
  ThreadPool pool(threads);
  std::vector<std::size_t> done;
  std::string last;
  const auto results = compute_batch(FakeRegistrar(), tasks(20), pool, {}, [&](const Progress& progress) {
    REQUIRE(progress.total == 20);
    done.push_back(progress.done);
    last = progress.detail;
  });
  REQUIRE(results.size() == 20);
  for (Key i = 0; i < 20; ++i) {
    REQUIRE(results[i].has_value());
    REQUIRE(results[i]->candidate.from == i);
    REQUIRE(results[i]->verified() == (i % 2 == 0));
  }
  REQUIRE(results[7]->reason == RejectionReason::kFailed);
  REQUIRE(results[7]->message == "seven");
  REQUIRE(done.size() == 20);
  REQUIRE(std::is_sorted(done.begin(), done.end()));
  REQUIRE(last == "10 accepted, 10 rejected");
}

TEST_CASE("compute_batch: after a stop no task is begun", "[batch]") {
  StopSource stop;
  const FakeRegistrar registrar(&stop, 5);
  ThreadPool pool(1);
  const auto results = compute_batch(registrar, tasks(20), pool, stop.token());
  REQUIRE(registrar.calls() == 5);
  for (std::size_t i = 0; i < 20; ++i) REQUIRE(results[i].has_value() == (i < 5));
}

TEST_CASE("compute_batch: nothing to do", "[batch]") {
  ThreadPool pool(2);
  REQUIRE(compute_batch(FakeRegistrar(), {}, pool).empty());
}

TEST_CASE("compute_or_fail: every exception becomes a result with its message", "[batch][error]") {
  struct Throwing final : Registrar {
    [[nodiscard]] std::string_view name() const override { return "throwing"; }
    [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
      if (task.candidate.from == 1) throw std::bad_alloc();
      if (task.candidate.from == 2) throw 2;
      throw InputError("three");
    }
  };
  const std::vector<std::string> words{"out of memory",
                                       "the registrar threw something that is not a std::exception", "three"};
  for (Key from = 1; from <= 3; ++from) {
    const RegistrationResult result = compute_or_fail(Throwing(), pair_task(from, 0, 1));
    REQUIRE(result.reason == RejectionReason::kFailed);
    REQUIRE(result.candidate.from == from);
    REQUIRE(result.message == words[from - 1]);
  }
}

TEST_CASE("compute_or_fail: the result has the candidate of the task, not that of the registrar",
          "[batch][error]") {
  struct ResultWithoutCandidate final : Registrar {
    [[nodiscard]] std::string_view name() const override { return "without_candidate"; }
    [[nodiscard]] RegistrationResult compute(const RegistrationTask&) const override {
      RegistrationResult result;
      result.reason = RejectionReason::kLowOverlap;
      return result;
    }
  };
  RegistrationTask task = pair_task(5, 3, 1);
  task.candidate.id = 9;
  task.candidate.source = CandidateSource::kUser;
  const RegistrationResult result = compute_or_fail(ResultWithoutCandidate(), task);
  REQUIRE(result.candidate.id == 9);
  REQUIRE(result.candidate.from == 5);
  REQUIRE(result.candidate.to == 3);
  REQUIRE(result.candidate.source == CandidateSource::kUser);
}

TEST_CASE("compute_or_fail: closures that a graph refuses are failed", "[batch][error]") {
  struct Single final : Registrar {  // poses in single precision, as of other libraries
    [[nodiscard]] std::string_view name() const override { return "single"; }
    [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
      RegistrationResult result;
      result.candidate = task.candidate;
      result.closure = LoopClosure{task.candidate.from, task.candidate.to};
      result.closure->T_from_to.linear() =
          Eigen::AngleAxisd(1.0, Eigen::Vector3d(1.0, 2.0, 3.0).normalized()).toRotationMatrix();
      if (task.candidate.from == 1) result.closure->T_from_to.linear() *= 1.0 + 1e-5;
      if (task.candidate.from == 2) result.closure->T_from_to.linear() *= 1.1;
      if (task.candidate.from == 3) result.closure->T_from_to.translation().x() = std::nan("");
      if (task.candidate.from == 4) result.closure->covariance.setZero();
      if (task.candidate.from == 5) result.closure->covariance(0, 0) = std::nan("");
      if (task.candidate.from == 6) result.closure->to = 7;
      if (task.candidate.from == 7) result.reason = RejectionReason::kLowOverlap;
      if (task.candidate.from == 8) result.closure.reset();
      return result;
    }
  };
  const RegistrationResult rounded = compute_or_fail(Single(), pair_task(1, 0, 1));
  REQUIRE(rounded.verified());
  const Eigen::Matrix3d R = rounded.closure->T_from_to.linear();
  REQUIRE((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-12);
  const std::vector<std::string> words{"not a rigid transform",
                                       "not finite",
                                       "not positive definite",
                                       "not positive definite",
                                       "other nodes than the candidate's",
                                       "a rejected one with one",
                                       "without a closure"};
  for (Key from = 2; from <= 8; ++from) {
    const RegistrationResult result = compute_or_fail(Single(), pair_task(from, 0, 1));
    CAPTURE(from, result.message);
    REQUIRE(result.reason == RejectionReason::kFailed);
    REQUIRE_FALSE(result.closure);
    REQUIRE_THAT(result.message, Contains(words[from - 2]));
  }
}

}  // namespace
}  // namespace loopwise::batch_test
