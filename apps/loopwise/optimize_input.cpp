// SPDX-License-Identifier: BSD-3-Clause
#include "optimize_input.hpp"

#include <utility>

#include <loopwise/core/closure_decision.hpp>
#include <loopwise/core/priors.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/decisions.hpp>
#include <loopwise/io/graph_source.hpp>

namespace loopwise::cli {
namespace {

void decide(PoseGraph& graph, const std::string& path, Console& console) {
  const std::vector<ClosureDecision> decisions = read_decisions(path);
  const AppliedDecisions applied = apply_decisions(graph, decisions);
  console.note("decisions: " + counted(applied.removed, "closure") + " left out, " +
               counted(applied.trusted, "closure") + " trusted");
  Problems problems;
  for (const ClosureDecision& decision : applied.without_match) {
    problems.add("decision on a pair without a closure",
                 path + ": " + key_name(decision.from) + " - " + key_name(decision.to));
  }
  console.warn(problems);
}

}  // namespace

void add_graph_options(Command& command, OptimizeInput& input) {
  add_odometry_option(command, input.reading.odometry);
  add_decisions_option(command, input.decisions);
  command.add_option("--robots", input.reading.robots, "Robots by ranges of ids or by characters")
      ->type_name("0-624,625-1249");
  command
      .add_option(
          "--prior", input.priors,
          "Anchor a node at its pose (sigmas 1e-4 m and rad); may be repeated; default: the file's, or the "
          "first node of each component")
      ->type_name("KEY[:M[:RAD]]")
      ->expected(1)
      ->take_all();
}

Config configured(const OptimizeInput& input) {
  Config defaults;
  defaults.replay.back_end.optimization = OptimizerOptions();
  defaults.replay.back_end.gnc = GncOptions();
  Config config = load_config(input.common, defaults);
  config.replay.back_end.optimization.threads = thread_count(input.common);
  if (!input.initialization.empty()) {
    config.replay.back_end.optimization.initialization =
        parse_enum<Initialization>("--initialization", input.initialization);
  }
  if (input.inlier_probability > 0.0 && !input.gnc)
    throw OptionError("--inlier-probability needs --gnc: without it, all closures stay");
  if (input.inlier_probability > 0.0)
    config.replay.back_end.gnc.inlier_probability = input.inlier_probability;
  apply(input.reading, config);
  validate_config(config);
  return config;
}

PoseGraph graph_of(const OptimizeInput& input, const MissionOptions& options, Console& console,
                   const StopToken& stop) {
  SourceGraph source = read_graph(input.input, options, console.progress_callback(), stop);
  console.warn(source.problems);
  if (!input.decisions.empty()) decide(source.graph, input.decisions, console);
  return std::move(source.graph);
}

void add_priors(PoseGraph& graph, const std::vector<std::string>& priors, Console& console) {
  for (const std::string& text : priors) graph.add_prior(parse_prior("--prior", text, graph));
  if (!graph.priors().empty()) return;
  const std::size_t components = anchor_components(graph);
  console.note(
      "no prior given: sigma 1e-4 on the first node" +
      (components == 1 ? std::string() : " of each of " + std::to_string(components) + " components"));
}

}  // namespace loopwise::cli
