// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Traces of the online module: all events that its engine has handled, as text. A trace repeats a run in the
/// field, without its scans and registrations: to the bit with the same build on the same type of processor.
/// On other processors, estimates that differ are reported. Prioritisers that read clouds cannot be repeated.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/engine/events.hpp>
#include <loopwise/online/loop_closure_module.hpp>
#include <loopwise/replay/replay.hpp>

namespace loopwise {

/// Makes the lines of a trace. Call add() from ModuleParts::on_event:
///
///     LineLog file("run.trace");  // each line is flushed, because traces are for the time after a crash
///     TraceWriter trace(robots, options, [&](const std::string& line) { file.add(line); });
///     parts.on_event = [&](const HandledEvent& handled) { trace.add(handled); };
///
/// Writer and file must outlive the module. The first line holds the version, the robots and the options,
/// each other line one event. Not thread-safe.
class LOOPWISE_EXPORT TraceWriter {
 public:
  /// \param robots of the module
  /// \param options of the module
  /// \param line gets each line, without its end
  TraceWriter(const Robots& robots, const ModuleOptions& options,
              std::function<void(const std::string& line)> line);
  /// Writes a line. \throws exceptions of `line`; InputError on a name that is not UTF-8. The trace has then
  /// ended, and every further event is refused with an InputError
  void add(const HandledEvent& handled);

 private:
  std::function<void(const std::string& line)> line_;
  bool broken_ = false;
};

/// The header of a trace.
struct TraceHeader {
  Robots robots;          ///< Robots of the module.
  ModuleOptions options;  ///< Decisions, order and estimates; the other parts have their defaults.
  std::string code;       ///< Version of the code that recorded it.
};

/// An event of a trace.
struct TraceEvent {
  Event event;         ///< Clouds are empty; an event::Optimized has no result, see estimate_hash.
  double now_s = 0.0;  ///< Time on the module's clock, s.
  std::optional<double> observability;     ///< As HandledEvent::observability.
  std::optional<ScanSignature> signature;  ///< As HandledEvent::signature.
  std::string estimate_hash;  ///< Hash of the poses and weights of an estimate; empty for other events.
};

/// Reads the first line of a trace. \throws InputError, OptionError
[[nodiscard]] LOOPWISE_EXPORT TraceHeader parse_trace_header(const std::string& line);
/// Reads the header of a trace file. \throws IoError; ParseError naming the file
[[nodiscard]] LOOPWISE_EXPORT TraceHeader read_trace_header(const std::filesystem::path& file);
/// Reads any other line. \throws InputError, OptionError
[[nodiscard]] LOOPWISE_EXPORT TraceEvent parse_trace_event(const std::string& line);

/// Gives the events of a trace to an engine, which reaches the same graph, closures and estimates. Estimates
/// are computed again. An estimate that differs from the recorded one is a problem of the result, and so is
/// another version of the code. Of the hooks, `moment`, `progress` and `stop` are used.
/// \param file trace of a TraceWriter; a truncated last line is left out and reported
/// \param hooks to watch the run, or to stop it
/// \param prioritizers of the module, if they differ from those of its method
/// \throws IoError; ParseError naming a line that cannot be read, or that comes from a run with other
/// prioritisers
[[nodiscard]] LOOPWISE_EXPORT ReplayResult replay_trace(const std::filesystem::path& file,
                                                        const ReplayHooks& hooks = {},
                                                        const PrioritizerFactory& prioritizers = {});

}  // namespace loopwise
