// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/graph_tables.hpp>
#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "optimize_input.hpp"
#include "optimize_text.hpp"

namespace loopwise::cli {
namespace {

struct OptimizeCommand : OptimizeInput {
  std::string output, weights, marginals;
  bool certify = false, verbose = false;
};

int run_optimize(const OptimizeCommand& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  const Config config = configured(options);
  PoseGraph graph = graph_of(options, config.mission, console, interrupt.token());
  PoseGraph written = graph;  // without the command line's priors, which are not measurements
  add_priors(graph, options.priors, console);
  Times at;
  at.reading = watch.seconds();

  const OptimizerOptions& optimizer = config.replay.back_end.optimization;
  Json json = Json::object();
  std::string text;
  GncResult gnc;
  gnc.weights.assign(graph.edges().size(), 1.0);
  if (options.gnc) {
    gnc = optimize_gnc(graph, optimizer, config.replay.back_end.gnc, interrupt.token());
    json["gnc"] = gnc_json(gnc);
    text += gnc_text(gnc);
  } else {
    gnc.optimization = optimize(graph, optimizer, interrupt.token());
  }
  OptimizationResult& result = gnc.optimization;
  graph.set_poses(result.poses);
  for (std::size_t e = 0; e < gnc.weights.size(); ++e) graph.set_weight(e, gnc.weights[e]);
  at.optimized = watch.seconds();
  if (options.certify) {
    const CertifiedEstimate estimate = optimize_certified(graph, optimizer, {}, interrupt.token());
    if (estimate.improved) {
      graph.set_poses(estimate.poses);
      result = continued(result, estimate.optimization);
    }
    json["certificate"] = certificate_json(estimate);
    text += certificate_text(estimate, options.gnc);
  }
  at.certified = watch.seconds();
  if (!options.marginals.empty()) {
    const Marginals covariances = marginals(graph, optimizer);
    write_file(options.marginals, covariances_csv(graph, covariances.covariances));
    json["marginals"] = {{"trace_translation", covariances.trace_translation},
                         {"trace_full", covariances.trace_full}};
    text += marginals_text(covariances);
  }
  at.marginals = watch.seconds();
  if (!options.output.empty()) {
    written.set_poses(result.poses);
    write_g2o(options.output, written);
  }
  if (!options.weights.empty()) write_file(options.weights, weights_csv(graph, gnc.weights));

  Json head = head_json(graph, result, at, watch.seconds());
  head.update(json);
  print_results(options.common, head,
                (options.verbose ? trace_table(result) + "\n" : "") +
                    head_text(graph, result, at.optimized - at.reading) + text);
  if (interrupt.interrupted()) {
    console.note("interrupted: the result is that so far");
    return kInterrupted;
  }
  if (!result.converged) console.warn("not converged: " + result.message);
  return kDone;
}

}  // namespace

void add_optimize(Command& app, Action& chosen) {
  const auto options = std::make_shared<OptimizeCommand>();
  Command* command = app.add_subcommand("optimize", "Optimise a pose graph, robustly if asked");
  command->footer(
      "Edges between neighbours of one robot are odometry. Robust optimisation keeps them; where odometry is "
      "worse\n"
      "than stated, it lowers the weight of a robot's odometry as a whole.\n"
      "  loopwise optimize graph.g2o -o out.g2o\n"
      "  loopwise optimize graph.g2o -o out.g2o --gnc --weights weights.csv --robots 0-624,625-1249 \\\n"
      "      --prior 0 --prior 625:1e-4:1e-4");
  command
      ->add_option("input", options->input, "Pose graph: g2o (2D or 3D), a run, or a recording of any kind")
      ->required()
      ->type_name("GRAPH");
  command->add_option("-o,--output", options->output, "Optimised graph, g2o")
      ->type_name("OUT.g2o")
      ->check(not_standard_output());
  command->add_flag("--gnc", options->gnc,
                    "Find and leave out false loop closures (see section gnc of --config)");
  command
      ->add_option("--inlier-probability", options->inlier_probability,
                   "Share of true closures that --gnc keeps, by the chi-squared test (default 0.99)")
      ->type_name("P")
      ->check(in_range(1e-6, 0.999999));
  command
      ->add_option("--initialization", options->initialization,
                   "First estimate: auto (the cheapest), file, odometry or chordal")
      ->type_name("WORD");
  add_graph_options(*command, *options);
  command
      ->add_option(
          "--weights", options->weights,
          "Weight and kind of every edge, CSV in file order; a closure of less than 0.5 is an outlier")
      ->type_name("W.csv")
      ->check(not_standard_output());
  command
      ->add_option("--marginals", options->marginals,
                   "Marginal covariances of all poses, CSV: upper triangle, translation before rotation")
      ->type_name("M.csv")
      ->check(not_standard_output());
  command->add_flag(
      "--certify", options->certify,
      "Test whether the estimate is globally optimal; if not, continue from poses of lower cost");
  command->add_flag("--verbose", options->verbose, "Cost of every step");
  add_key_frame_options(*command, options->common);
  finish_command(*command, options, run_optimize, chosen);
}

}  // namespace loopwise::cli
