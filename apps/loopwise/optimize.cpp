// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cctype>
#include <charconv>
#include <fstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/decisions.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/certificate.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "command.hpp"
#include "optimize_text.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::string input;
  std::string output;
  bool gnc = false;
  bool certify = false;
  bool verbose = false;
  double inlier_probability = 0.0;  // 0: as configured
  std::string initialization;
  std::string odometry;
  std::string decisions;
  std::string robots;
  std::vector<std::string> priors;
  std::string weights;
  std::string marginals;
};

double positive_number(const std::string& text, const std::string& what) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !(value > 0.0) || !std::isfinite(value)) {
    throw OptionError(what + ": \"" + text + "\" is not a positive number");
  }
  return value;
}

/// Parses KEY[:sigma_m[:sigma_rad]] as a prior at the node's pose.
PriorFactor parse_prior(const std::string& text, const PoseGraph& graph) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t colon = text.find(':'); colon != std::string::npos; colon = text.find(':', begin)) {
    parts.push_back(text.substr(begin, colon - begin));
    begin = colon + 1;
  }
  parts.push_back(text.substr(begin));
  if (parts.size() > 3) throw OptionError("--prior " + text + ": expected KEY[:sigma_m[:sigma_rad]]");
  PriorFactor prior;
  try {
    prior.key = parse_key(parts[0]);
  } catch (const InputError& error) {
    throw OptionError("--prior " + text + ": " + error.what());
  }
  if (!graph.contains(prior.key)) throw OptionError("--prior " + text + ": the graph has no such node");
  const double sigma_m = parts.size() > 1 ? positive_number(parts[1], "--prior") : 1e-4;
  const double sigma_rad = parts.size() > 2 ? positive_number(parts[2], "--prior") : 1e-4;
  prior.pose = graph.node(prior.key).pose;
  prior.information.setZero();
  prior.information.diagonal() << Eigen::Vector3d::Constant(1.0 / (sigma_m * sigma_m)),
      Eigen::Vector3d::Constant(1.0 / (sigma_rad * sigma_rad));
  return prior;
}

/// Adds the priors of the command line. If there are no others, adds one at the first node of each component.
void add_priors(PoseGraph& graph, const Options& options, Console& console) {
  for (const std::string& text : options.priors) graph.add_prior(parse_prior(text, graph));
  if (!graph.priors().empty()) return;
  const std::vector<std::size_t> component = connected_components(graph);
  std::size_t next = 0;
  for (std::size_t i = 0; i < component.size(); ++i) {
    if (component[i] != next) continue;
    ++next;
    graph.add_prior(parse_prior(std::to_string(graph.nodes()[i].key), graph));
  }
  console.note("no prior given: sigma 1e-4 on the first node" +
               (next == 1 ? std::string() : " of each of " + std::to_string(next) + " components"));
}

/// Joins the results of an optimisation and its continuation to one.
void go_on(OptimizationResult last, OptimizationResult& result) {
  last.cost_initial = result.cost_initial;
  last.gradient_initial = result.gradient_initial;
  last.initialization = result.initialization;
  last.iterations += result.iterations;
  last.factorizations += result.factorizations;
  last.trace.insert(last.trace.begin(), result.trace.begin(), result.trace.end());
  result = std::move(last);
}

/// Certifies the optimum, and continues from lower poses if the search finds any.
std::string certify_result(const OptimizerOptions& optimizer, bool robust, const StopToken& stop,
                           PoseGraph& graph, OptimizationResult& result, Json& json) {
  const CertifiedEstimate estimate = optimize_certified(graph, optimizer, {}, stop);
  if (estimate.improved) {
    graph.set_poses(estimate.poses);
    go_on(estimate.optimization, result);
  }
  json["certificate"] = certificate_json(estimate);
  return certificate_text(estimate, robust);
}

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

Config config_of(const Options& options) {
  Config defaults;
  defaults.replay.back_end.optimization =
      OptimizerOptions();  // not those of a growing graph: a file has no earlier estimate
  defaults.replay.back_end.gnc = GncOptions();
  Config config = load_config(options.common, defaults);
  config.replay.back_end.optimization.threads = thread_count(options.common);
  if (!options.initialization.empty()) {
    config.replay.back_end.optimization.initialization =
        parse_enum<Initialization>("--initialization", options.initialization);
  }
  if (options.inlier_probability > 0.0)
    config.replay.back_end.gnc.inlier_probability = options.inlier_probability;
  if (!options.robots.empty()) config.mission.robots = options.robots;
  set_odometry(options.odometry, config);
  validate_config(config);
  return config;
}

/// Reads the graph of a file, a run or a recording, with the kinds of its edges.
PoseGraph read_graph(const Options& options, Config& config, Console& console, const StopToken& stop) {
  const std::filesystem::path of_run = graph_of_run(options.input);
  if (of_run.empty() && is_recording(options.input)) {
    Mission mission = read_mission(options.input, config.mission, console.progress_callback(), stop);
    console.warn(mission.problems);
    return std::move(mission.graph);  // its edges have their kinds
  }
  // If the odometry of a run is not between neighbouring keys, a list of it is stored next to the graph.
  if (const auto list = of_run.parent_path() / "odometry.csv";
      !of_run.empty() && config.mission.odometry.empty() && std::filesystem::exists(list))
    config.mission.odometry = list.string();
  G2oFile file = read_g2o(of_run.empty() ? std::filesystem::path(options.input) : of_run);
  if (config.mission.strict) require_unaltered(file.problems);
  console.warn(file.problems);
  const std::string& robots = config.mission.robots;
  console.warn(classify_edges(file.graph,
                              robots.empty() ? Robots::from_keys(file.graph.keys()) : parse_robots(robots),
                              config.mission, file.without_information));
  return std::move(file.graph);
}

/// Optimises robustly; `weights` receives the weights of the edges.
OptimizationResult run_gnc(const PoseGraph& graph, const Config& config, const StopToken& stop,
                           std::vector<double>& weights, Json& json, std::string& text) {
  GncResult gnc = optimize_gnc(graph, config.replay.back_end.optimization, config.replay.back_end.gnc, stop);
  weights = gnc.weights;
  json["gnc"] = {{"outer_iterations", gnc.outer_iterations},
                 {"inliers", gnc.inliers},
                 {"outliers", gnc.outliers},
                 {"start", enum_name(gnc.start)},
                 {"truncated_cost", gnc.truncated_cost}};
  for (const OdometryScale& odometry : gnc.odometry_scales) {
    json["gnc"]["odometry_scales"].push_back({{"first", odometry.first}, {"scale", odometry.scale}});
  }
  text += "closures     " + std::to_string(gnc.inliers) + " inliers, " + std::to_string(gnc.outliers) +
          " outliers, " + std::to_string(gnc.outer_iterations) + " outer iterations, start " +
          enum_name(gnc.start) + "\n";
  text += odometry_text(gnc);
  return std::move(gnc.optimization);
}

std::string report_marginals(const std::string& path, const PoseGraph& graph,
                             const OptimizerOptions& optimizer, Json& json) {
  const Marginals covariances = marginals(graph, optimizer);
  write_marginals(path, graph, covariances);
  json["marginals"] = {{"trace_translation", covariances.trace_translation},
                       {"trace_full", covariances.trace_full}};
  char line[96];
  std::snprintf(line, sizeof line, "marginals    trace %.9g m^2 (translation), %.9g (full)\n",
                covariances.trace_translation, covariances.trace_full);
  return line;
}

int run(const Options& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  const InterruptGuard interrupt;
  Config config = config_of(options);
  PoseGraph graph = read_graph(options, config, console, interrupt.token());
  if (!options.decisions.empty()) decide(graph, options.decisions, console);
  PoseGraph written = graph;  // without the command line's priors, which are not measurements
  add_priors(graph, options, console);
  Times at;
  at.reading = watch.seconds();

  Json json = Json::object();
  const OptimizerOptions& optimizer = config.replay.back_end.optimization;
  std::vector<double> weights(graph.edges().size(), 1.0);
  std::string text;
  OptimizationResult result = options.gnc ? run_gnc(graph, config, interrupt.token(), weights, json, text)
                                          : optimize(graph, optimizer, interrupt.token());
  graph.set_poses(result.poses);
  for (std::size_t e = 0; e < weights.size(); ++e) graph.set_weight(e, weights[e]);
  at.optimized = watch.seconds();
  if (options.certify) text += certify_result(optimizer, options.gnc, interrupt.token(), graph, result, json);
  at.certified = watch.seconds();
  if (!options.marginals.empty()) text += report_marginals(options.marginals, graph, optimizer, json);
  at.marginals = watch.seconds();
  if (!options.output.empty()) {
    written.set_poses(result.poses);
    write_g2o(options.output, written);
  }
  if (!options.weights.empty()) write_weights(options.weights, graph, weights);

  Json head = head_json(graph, result, at, watch.seconds());
  head.update(json);
  print_results(options.common, head,
                (options.verbose ? trace_table(result) + "\n" : "") +
                    head_text(graph, result, at.optimized - at.reading) + text);
  if (interrupt.interrupted()) return kInterrupted;
  if (!result.converged) console.warn("not converged: " + result.message);
  return kDone;
}

}  // namespace

void add_optimize(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("optimize", "Optimise a pose graph, robustly if asked");
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
      ->check(CLI::Range(1e-6, 1.0 - 1e-12));
  command
      ->add_option("--initialization", options->initialization,
                   "First estimate: auto (the cheapest), file, odometry or chordal")
      ->type_name("WORD");
  add_odometry_option(*command, options->odometry);
  add_decisions_option(*command, options->decisions);
  command->add_option("--robots", options->robots, "Robots by ranges of ids or by characters")
      ->type_name("0-624,625-1249");
  command
      ->add_option(
          "--prior", options->priors,
          "Anchor a node at its pose (sigmas 1e-4 m and rad); may be repeated; default: the file's, or the "
          "first node of each component")
      ->type_name("KEY[:M[:RAD]]")
      ->expected(1)
      ->take_all();
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
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
