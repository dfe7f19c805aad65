// SPDX-License-Identifier: BSD-3-Clause
#include "statistics_board.hpp"

namespace loopwise {

ModuleStatistics StatisticsBoard::read() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  ModuleStatistics result = statistics_;
  if (!ended_) (busy_ ? result.computing_s : result.idle_s) += watch_.seconds() - since_s_;
  return result;
}

void StatisticsBoard::publish(const Engine& engine, std::size_t events) {
  const CandidatePool& pool = engine.pool();
  const std::optional<double> oldest = pool.oldest_pending_s();
  const std::lock_guard<std::mutex> lock(mutex_);
  if (busy_ && !engine.computing()) set_busy(false);
  statistics_.events = events;
  statistics_.factors_waiting = engine.factors_waiting();
  statistics_.factors_dropped = engine.factors_dropped();
  statistics_.candidates = pool.accounting();
  statistics_.oldest_pending_s = oldest ? engine.now_s() - *oldest : 0.0;
  for (std::size_t i = 0; i < pool.queue().prioritizers().size(); ++i) {
    statistics_.handed_out[std::string(pool.queue().prioritizers()[i]->name())] =
        pool.queue().handed_out()[i];
  }
}

void StatisticsBoard::batch_begins() {
  const std::lock_guard<std::mutex> lock(mutex_);
  set_busy(true);
  ++statistics_.batches;
}

void StatisticsBoard::end() {
  const std::lock_guard<std::mutex> lock(mutex_);
  set_busy(false);
  ended_ = true;
}

void StatisticsBoard::problem(const std::string& text) {
  constexpr std::size_t kKept = 20;
  const std::lock_guard<std::mutex> lock(mutex_);
  ++statistics_.problems;
  statistics_.last_problems.push_back(text);
  if (statistics_.last_problems.size() > kKept) {
    statistics_.last_problems.erase(statistics_.last_problems.begin());
  }
}

void StatisticsBoard::registration_overdue() {
  const std::lock_guard<std::mutex> lock(mutex_);
  ++statistics_.overdue;
  ++statistics_.overdue_now;
}

void StatisticsBoard::overdue_registration_back() {
  const std::lock_guard<std::mutex> lock(mutex_);
  --statistics_.overdue_now;
}

void StatisticsBoard::set_busy(bool busy) {
  const double now_s = watch_.seconds();
  (busy_ ? statistics_.computing_s : statistics_.idle_s) += now_s - since_s_;
  since_s_ = now_s;
  busy_ = busy;
}

}  // namespace loopwise
