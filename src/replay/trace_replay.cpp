// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/trace.hpp>

#include <fstream>
#include <map>
#include <optional>
#include <unordered_map>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/replay/code_version.hpp>

#include "account.hpp"
#include "closure_weights.hpp"
#include "trace_codec.hpp"

namespace loopwise {
namespace {

constexpr std::size_t kProgressLines = 1000;

/// One run: passes the events in a file's lines to the engine.
class TraceRun {
  /// \throws ParseError that names the line
  template <class Function>
  auto parsed(Function&& function) {
    try {
      return function();
    } catch (const Error& error) {
      throw ParseError(file_.string(), line_number_, error.what());
    }
  }

 public:
  TraceRun(std::filesystem::path file, const ReplayHooks& hooks, const PrioritizerFactory& own)
      : file_(std::move(file)), hooks_(hooks), in_(file_, std::ios::binary) {
    if (!in_) throw IoError(file_.string(), "cannot be read");
    std::string line;
    if (!next_line(line)) throw InputError(file_.string() + ": is empty");
    header_ = parsed([&] { return parse_trace_header(line); });
    if (header_.code != replay_code_version()) {
      result_.problems.add("trace", "recorded by another version of the program: results may differ");
    }
    ScanInsight insight;
    insight.eigenvalue = [this](const KeyedScan&) { return observability_.value_or(0.0); };
    insight.signature = [this](const KeyedScan&) { return signature_.value_or(ScanSignature()); };
    engine_.emplace(
        header_.robots, header_.options.engine,
        RoundRobinQueue(own ? own()
                            : make_prioritizers(header_.options.prioritization, header_.options.engine.seed,
                                                header_.robots, insight)));
    optimizer_.emplace(header_.options.back_end.optimization);
  }

  ReplayResult execute() {
    const Stopwatch watch;
    std::string line;
    while (!hooks_.stop.stop_requested() && next_line(line)) {
      if (in_.eof() && !complete(line)) break;
      parsed([&] { feed(parse_trace_event(line)); });
      if (hooks_.progress && line_number_ % kProgressLines == 0) {
        hooks_.progress({"events", line_number_, line_number_, ""});
      }
    }
    result_.interrupted = hooks_.stop.stop_requested();
    finish();
    result_.total_s = watch.seconds();
    return std::move(result_);
  }

 private:
  bool next_line(std::string& line) {
    if (!std::getline(in_, line)) {
      if (in_.bad()) throw IoError(file_.string(), "cannot be read");
      return false;
    }
    ++line_number_;
    return true;
  }

  /// Whether a line is complete. The last line of a run that was killed is not.
  [[nodiscard]] bool complete(const std::string& line) {
    try {
      static_cast<void>(parse_trace_event(line));
      return true;
    } catch (const Error&) {
      result_.problems.add("trace", "line " + std::to_string(line_number_) + " is cut short and left out");
      return false;
    }
  }

  void feed(TraceEvent traced) {
    observability_ = traced.observability;
    signature_ = std::move(traced.signature);
    now_s_ = traced.now_s;
    if (auto* optimized = std::get_if<event::Optimized>(&traced.event)) estimate(traced, *optimized);
    if (auto* improve = std::get_if<event::Improve>(&traced.event)) improve->stop = hooks_.stop;
    for (Effect& effect : engine_->handle(std::move(traced.event), traced.now_s)) {
      std::visit([this](auto& e) { carry_out(e); }, effect);
    }
  }

  void estimate(const TraceEvent& traced, event::Optimized& optimized) {
    if (!asked_) throw InputError("an estimate that was not requested");
    if (traced.estimate_hash.empty()) {
      if (!optimized.stopped && optimized.failure.empty()) throw InputError("an estimate without its hash");
      return;
    }
    const Stopwatch watch;
    GncOptions options = header_.options.back_end.gnc;
    if (from_scratch_) options.warm_growth = 0.0;
    optimized.gnc = optimizer_->optimize_gnc(*asked_, options, hooks_.stop);
    asked_.reset();
    if (optimized.gnc.optimization.termination == Termination::kStopped) {
      optimized.stopped = true;
      return;
    }
    ++result_.optimizations;
    if (!optimized.gnc.fresh) ++result_.continued_optimizations;
    result_.optimization_s += watch.seconds();
    if (estimate_hash(optimized.gnc) != traced.estimate_hash) {
      result_.problems.add(
          "trace", "line " + std::to_string(line_number_) + ": the estimate differs from the recorded one");
    }
  }

  // ---- effects

  void carry_out(effect::Compute& /*compute*/) { ++result_.batches; }
  void carry_out(effect::Optimize& optimize) {
    asked_ = std::move(optimize.graph);
    from_scratch_ = optimize.from_scratch;
  }
  void carry_out(effect::Closure& /*closure*/) {}
  void carry_out(effect::Computed& computed) { result_.computed.push_back({computed.result, now_s_, 0.0}); }
  void carry_out(effect::EstimateReady& ready) {
    if (hooks_.moment) show(ReplayMoment::Kind::kBatch, ready.estimate->graph);
  }
  void carry_out(effect::Problem& problem) { result_.problems.add(problem.topic, problem.detail); }

  void finish() {
    result_.graph = engine_->graph();
    result_.odometry = engine_->odometry();
    take_weights(result_.graph, result_.computed);
    const CandidatePool& pool = engine_->pool();
    take_account(pool, result_);
    result_.mission_time_s = result_.mission_end_s = now_s_;
    result_.problems.add(engine_->radio_problems());
    if (hooks_.moment) show(ReplayMoment::Kind::kEnd, result_.graph);
  }

  void show(ReplayMoment::Kind kind, const PoseGraph& graph) {
    take_weights(graph, result_.computed);
    hooks_.moment({kind, now_s_, graph, engine_->odometry(), result_.computed, engine_->pool().accounting()});
  }

  const std::filesystem::path file_;
  const ReplayHooks& hooks_;
  std::ifstream in_;
  std::size_t line_number_ = 0;
  TraceHeader header_;
  std::optional<double> observability_;
  std::optional<ScanSignature> signature_;
  std::optional<Engine> engine_;
  std::optional<PoseGraphOptimizer> optimizer_;
  bool from_scratch_ = false;
  std::shared_ptr<const PoseGraph> asked_;
  double now_s_ = 0.0;
  ReplayResult result_;
};

}  // namespace

TraceHeader read_trace_header(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string line;
  if (!in || !std::getline(in, line)) throw IoError(file.string(), "cannot be read");
  try {
    return parse_trace_header(line);
  } catch (const Error& error) {
    throw ParseError(file.string(), 1, error.what());
  }
}

ReplayResult replay_trace(const std::filesystem::path& file, const ReplayHooks& hooks,
                          const PrioritizerFactory& prioritizers) {
  return TraceRun(file, hooks, prioritizers).execute();
}

}  // namespace loopwise
