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

/// The thread of a module that runs the engine: feeds it, improves the next set while a batch is computed,
/// and carries out effects.
class EngineThread {
 public:
  struct Settings {
    std::size_t batch = 1;     ///< Candidates handed out at a time.
    std::size_t capacity = 1;  ///< Events that wait before producers are held up.
    std::shared_ptr<const Clock> clock;
    std::function<void(const HandledEvent&)> on_event;  ///< May be empty.
    /// Proposes what looks like a node whose frame or scan has come; may be empty.
    std::function<std::vector<LoopCandidate>(const PoseGraph&, Key, double now_s)> recognise;
  };
  /// What the other threads of the module do. Must not wait.
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

  /// Begins. \throws std::system_error if the system has no more threads
  void start(Engine engine, Workers workers);
  /// Handles the waiting events, begins no more batches, and ends once those under way are done and the last
  /// estimate is one from scratch. To be called once started.
  void end();

  /// Whether the caller runs in this thread, as callbacks and prioritisers do.
  [[nodiscard]] bool is_own_thread() const { return std::this_thread::get_id() == id_; }

  /// An event from outside: waits while the inbox is full, unless called from this thread itself, where
  /// callbacks and prioritisers run. \returns false, with the event not taken, after the end
  [[nodiscard]] bool post(Event event);
  /// An event from a worker, or a problem that it has met: never waits. Without memory, the thread ends.
  void post_inside(std::variant<Event, effect::Problem> message);

  /// A worker has no memory to go on with: the thread ends.
  void give_up();

  /// An eigenvalue that a prioritiser has asked for while an event is handled.
  void note_observability(double eigenvalue) { observability_ = eigenvalue; }
  void note_signature(const ScanSignature& signature) { signature_ = signature; }

  [[nodiscard]] std::size_t waiting() const { return inbox_.size(); }
  [[nodiscard]] PoseGraph graph() const;
  [[nodiscard]] std::shared_ptr<const Estimate> estimate() const;
  /// Requested at the end.
  [[nodiscard]] StopToken no_more_batches() const { return no_more_batches_.token(); }

 private:
  /// Events, and problems that other threads have met.
  using Message = std::variant<Event, effect::Problem>;

  void run();
  void handle_messages();
  std::optional<Message> next_message();
  void improve();
  void feed(Event event);
  void recognise(Key key);
  void keep_busy();
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

  // Of this thread alone, but for the graph, which others read with the mutex held.
  std::optional<double> observability_;  // of the scan that the last event brought
  std::optional<ScanSignature> signature_;
  mutable std::mutex graph_mutex_;  // taken by this thread to write, and by others to read
  std::optional<Engine> engine_;
  std::shared_ptr<const Estimate> estimate_;
  bool improving_ = false;  // the next set is being prepared ...
  bool improved_ = false;   // ... and is as good as it can be
  double last_tick_s_ = 0.0;
  std::size_t events_ = 0;  // handled

  std::atomic<std::thread::id> id_{};
  std::thread thread_;
};

}  // namespace loopwise
