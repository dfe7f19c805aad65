// SPDX-License-Identifier: BSD-3-Clause
#include "engine_thread.hpp"

#include <algorithm>
#include <exception>
#include <new>
#include <utility>

namespace loopwise {

void EngineThread::start(Engine engine, Workers workers) {
  engine_.emplace(std::move(engine));
  workers_ = std::move(workers);
  statistics_.publish(*engine_, 0);
  thread_ = std::thread([this] { run(); });
}

void EngineThread::end() {
  no_more_batches_.request_stop();
  interrupt_improvement();
  inbox_.close();
  if (thread_.joinable()) thread_.join();
}

bool EngineThread::post(Event event) {
  work_.begin();
  bool taken = false;
  try {
    // Callbacks and prioritisers run in this thread, so they must not wait for it to make room.
    if (is_own_thread()) {
      taken = inbox_.post_now(std::move(event));
    } else {
      taken = inbox_.post(std::move(event), [this] { statistics_.producer_waits(); });
      if (half_full()) interrupt_improvement();
    }
  } catch (...) {
    work_.end();
    throw;
  }
  if (!taken) work_.end();
  return taken;
}

void EngineThread::post_inside(Message message) {
  try {
    work_.begin();
    try {
      inbox_.post_inside(std::move(message));
    } catch (...) {
      work_.end();
      throw;
    }
    interrupt_improvement();
  } catch (const std::bad_alloc&) {
    give_up();
  }
}

void EngineThread::give_up() {
  out_of_memory_ = true;
  inbox_.close(/*abandon=*/true);
  no_more_batches_.request_stop();
  interrupt_improvement();
  work_.stop();  // messages may be lost, so wait() must not report that all is done
}

PoseGraph EngineThread::graph() const {
  if (is_own_thread()) return engine_->graph();  // this thread may hold the mutex
  const std::lock_guard<std::mutex> lock(graph_mutex_);
  return engine_->graph();
}

std::shared_ptr<const Estimate> EngineThread::estimate() const {
  if (is_own_thread()) return estimate_;
  const std::lock_guard<std::mutex> lock(graph_mutex_);
  return estimate_;
}

void EngineThread::interrupt_improvement() {
  const std::lock_guard<std::mutex> lock(improvement_mutex_);
  improvement_.request_stop();
}

void EngineThread::run() {
  id_ = std::this_thread::get_id();
  try {
    handle_messages();
    // Intermediate estimates may continue each other; the last one is made from scratch. No effect if it
    // already is.
    if (!out_of_memory_) feed(event::Settle{true});
    handle_messages();
    statistics_.publish(*engine_, events_);
  } catch (const std::bad_alloc&) {
    out_of_memory_ = true;
  }
  if (out_of_memory_) end_without_memory();
  id_ = std::thread::id();  // a later thread of the process may get the same id
}

/// Returns when the inbox is closed and no answer of a worker is pending.
void EngineThread::handle_messages() {
  while (auto message = next_message()) {
    if (auto* event = std::get_if<Event>(&*message)) {
      if (!std::holds_alternative<RegistrationResult>(*event)) improved_ = improving_ = false;
      feed(std::move(*event));
    } else {
      carry_out(std::get<effect::Problem>(*message));
    }
    keep_busy();
    ++events_;
    statistics_.publish(*engine_, events_);
    work_.end();
  }
}

/// While a batch is computed, the next set is improved. Events from outside wait during this time; otherwise
/// they would invalidate the prepared set before it is used. They wait until the set cannot be improved
/// further, the batch is done, or the inbox is half full.
std::optional<EngineThread::Message> EngineThread::next_message() {
  while (engine_->computing() && !improved_ && engine_->pool().accounting().pending > 0 &&
         (improving_ ? !half_full() : inbox_.size() == 0) && !no_more_batches_.stop_requested()) {
    if (auto message = inbox_.try_next_inside()) return message;
    improving_ = true;
    improve();
  }
  return inbox_.next(engine_->computing() || engine_->optimizing() || engine_->in_computation() > 0);
}

void EngineThread::improve() {
  StopToken token;
  {
    const std::lock_guard<std::mutex> lock(improvement_mutex_);
    improvement_ = StopSource();
    token = improvement_.token();
  }
  if (inbox_.inside_waits() || half_full() || no_more_batches_.stop_requested()) return;
  improved_ = true;  // unless it is interrupted
  feed(event::Improve{next_batch(), token, {}});
  improved_ = !token.stop_requested();
  statistics_.improved();
}

namespace {

/// The node of an event with a key frame or scan.
std::optional<Key> new_node(const Event& event) {
  if (const auto* frame = std::get_if<KeyFrame>(&event)) return frame->node.key;
  if (const auto* scan = std::get_if<event::Scan>(&event)) return scan->scan.key;
  return std::nullopt;
}

}  // namespace

/// Passes an event to the engine. All events take this path.
void EngineThread::feed(Event event) {
  Event record = settings_.on_event ? event : Event();
  const std::optional<Key> node = settings_.recognise ? new_node(event) : std::nullopt;
  const double now_s = settings_.clock->now();
  observability_.reset();
  signature_.reset();
  std::vector<Effect> effects;
  try {
    std::unique_lock<std::mutex> lock(graph_mutex_, std::defer_lock);
    // These two may take long and do not change the graph.
    const bool chooses =
        std::holds_alternative<event::Choose>(event) || std::holds_alternative<event::Improve>(event);
    if (!chooses) lock.lock();
    effects = engine_->handle(std::move(event), now_s);
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    return reporter_.problem(error.what());
  }
  if (settings_.on_event) {
    if (auto* improve = std::get_if<event::Improve>(&record)) {
      improve->stop = StopToken();
      improve->max_evaluations = engine_->evaluations();
    }
    reporter_.call("on_event", settings_.on_event, HandledEvent{record, now_s, observability_, signature_});
  }
  for (Effect& effect : effects) std::visit([this](auto& e) { carry_out(e); }, effect);
  if (node) recognise(*node);
}

void EngineThread::recognise(Key key) {
  event::Candidates alike;
  try {
    alike.candidates = settings_.recognise(engine_->graph(), key, settings_.clock->now());
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    return reporter_.problem(std::string("place recognition: ") + error.what());
  }
  if (!alike.candidates.empty()) feed(std::move(alike));
}

/// After each event: requests an estimate or a batch if the engine needs one.
void EngineThread::keep_busy() {
  constexpr double kTick_s = 1.0;
  if (settings_.clock->now() >= last_tick_s_ + kTick_s) {
    last_tick_s_ = settings_.clock->now();
    feed(event::Tick{});
  }
  if (engine_->wants_estimate() && !engine_->optimizing() && !engine_->computing()) feed(event::Settle{});
  measure_batch();
  if (engine_->wants_batch() && !no_more_batches_.stop_requested()) feed(event::Choose{next_batch()});
}

void EngineThread::measure_batch() {
  if (batch_ == 0 || engine_->computing()) return;
  candidate_s_ = (settings_.clock->now() - batch_began_s_) / static_cast<double>(batch_);
  batch_ = 0;
}

/// Number of candidates that take about two seconds, so that results of slow registrars soon change the
/// order. No thread is idle, and the first batch, whose time is not known, has one for each.
std::size_t EngineThread::next_batch() const {
  constexpr double kBatch_s = 2.0;
  const auto least = static_cast<double>(std::min(settings_.threads, settings_.batch));
  const auto most = static_cast<double>(settings_.batch);
  const double wanted = candidate_s_ ? kBatch_s / std::max(*candidate_s_, 1e-9) : least;
  return static_cast<std::size_t>(std::clamp(wanted, least, most));
}

void EngineThread::carry_out(effect::Compute& compute) {
  improved_ = improving_ = false;
  batch_ = compute.tasks.size();
  batch_began_s_ = settings_.clock->now();
  statistics_.batch_begins();
  work_.begin();
  workers_.compute(std::move(compute.tasks));
}

void EngineThread::carry_out(effect::Optimize& optimize) {
  work_.begin();
  workers_.optimize(std::move(optimize));
}

void EngineThread::carry_out(effect::EstimateReady& ready) {
  {
    const std::lock_guard<std::mutex> lock(graph_mutex_);
    estimate_ = ready.estimate;
  }
  reporter_.estimate(ready.estimate);
}

/// Ends the module; graph and statistics stay readable.
void EngineThread::end_without_memory() {
  give_up();
  try {
    reporter_.problem("out of memory: the module has stopped");
  } catch (const std::bad_alloc&) {  // no memory for the report either
  }
}

}  // namespace loopwise
