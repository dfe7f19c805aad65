// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <atomic>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <variant>
#include <vector>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/engine/engine.hpp>

#include "mailbox.hpp"
#include "open_work.hpp"
#include "reporter.hpp"
#include "statistics_board.hpp"

namespace loopwise {

/// The thread of a module that runs the engine. It passes events to it, improves the next set while a batch
/// is computed, and executes effects.
class EngineThread {
 public:
  struct Settings {
    std::size_t batch = 1;     ///< Candidates per batch, at most.
    std::size_t threads = 1;   ///< That compute a batch.
    std::size_t capacity = 1;  ///< Waiting events from which on producers block.
    std::shared_ptr<const Clock> clock;
    std::function<void(const HandledEvent&)> on_event;  ///< May be empty.
    /// Proposes candidates that look like a node with a new frame or scan; may be empty.
    std::function<std::vector<LoopCandidate>(const PoseGraph&, Key, double now_s)> recognise;
  };
  /// Starts work in the other threads of the module. Must not block.
  struct Workers {
    std::function<void(std::vector<RegistrationTask>)> compute;  ///< Answer: event::BatchDone.
    std::function<void(effect::Optimize)> optimize;              ///< Answer: event::Optimized.
  };

  EngineThread(Settings settings, OpenWork& work, StatisticsBoard& statistics, Reporter& reporter)
      : settings_(std::move(settings)),
        work_(work),
        statistics_(statistics),
        reporter_(reporter),
        inbox_(settings_.capacity) {}

  /// Starts the thread. \throws std::system_error if the system has no more threads
  void start(Engine engine, Workers workers);
  /// Handles the waiting events and starts no more batches. Returns when those in progress are done and the
  /// last estimate is from scratch. \pre start() was called
  void end();

  /// Whether the caller runs in this thread, as callbacks and prioritisers do.
  [[nodiscard]] bool is_own_thread() const { return std::this_thread::get_id() == id_; }

  /// Posts an event from outside. Blocks while the inbox is full, unless called from this thread (by
  /// callbacks or prioritisers). \returns false, without using the event, after the end
  [[nodiscard]] bool post(Event event);
  /// Posts an event or a problem from a worker; never blocks. If an allocation fails, the thread ends.
  void post_inside(std::variant<Event, effect::Problem> message);

  /// Ends the thread because of an allocation failure in a worker.
  void give_up();

  /// Records an eigenvalue that a prioritiser requests while an event is handled.
  void note_observability(double eigenvalue) { observability_ = eigenvalue; }
  void note_signature(const ScanSignature& signature) { signature_ = signature; }

  [[nodiscard]] std::size_t waiting() const { return inbox_.size(); }
  [[nodiscard]] PoseGraph graph() const;
  [[nodiscard]] std::shared_ptr<const Estimate> estimate() const;
  /// Its stop is requested at the end.
  [[nodiscard]] StopToken no_more_batches() const { return no_more_batches_.token(); }

 private:
  /// Events, and problems of other threads.
  using Message = std::variant<Event, effect::Problem>;

  void run();
  void handle_messages();
  std::optional<Message> next_message();
  void improve();
  void feed(Event event);
  void recognise(Key key);
  void keep_busy();
  void measure_batch();
  [[nodiscard]] std::size_t next_batch() const;
  void end_without_memory();
  [[nodiscard]] bool half_full() const { return 2 * inbox_.size() > settings_.capacity; }
  void interrupt_improvement();

  void carry_out(effect::Compute& compute);
  void carry_out(effect::Optimize& optimize);
  void carry_out(effect::Closure& closure) { reporter_.closure(closure.closure); }
  void carry_out(effect::Computed& computed) { reporter_.result(computed.result); }
  void carry_out(effect::EstimateReady& ready);
  void carry_out(effect::Problem& p) { reporter_.problem(p.topic + ": " + p.detail); }

  const Settings settings_;
  OpenWork& work_;
  StatisticsBoard& statistics_;
  Reporter& reporter_;
  Workers workers_;
  Mailbox<Message> inbox_;
  StopSource no_more_batches_;
  std::atomic<bool> out_of_memory_{false};
  std::mutex improvement_mutex_;
  StopSource improvement_;

  // Only this thread uses these, except for the graph, which others read with the mutex held.
  std::optional<double> observability_;  // of the scan in the current event
  std::optional<ScanSignature> signature_;
  mutable std::mutex graph_mutex_;  // this thread holds it to write, others hold it to read
  std::optional<Engine> engine_;
  std::shared_ptr<const Estimate> estimate_;
  bool improving_ = false;  // the next set is being prepared
  bool improved_ = false;   // the next set cannot be improved further
  double last_tick_s_ = 0.0;
  std::size_t batch_ = 0;  // candidates of the batch in computation
  double batch_began_s_ = 0.0;
  std::optional<double> candidate_s_;  // time of the last batch, per candidate
  std::size_t events_ = 0;             // handled

  std::atomic<std::thread::id> id_{};
  std::thread thread_;
};

}  // namespace loopwise
