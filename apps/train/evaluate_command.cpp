// SPDX-License-Identifier: BSD-3-Clause
#include <mutex>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/training/judge.hpp>
#include <loopwise/training/weights.hpp>

#include "commands.hpp"

namespace loopwise::training {
namespace {

struct Options {
  CommonOptions common;
  std::string data, markdown;
  std::vector<std::string> weights, names;
  std::uint64_t split_seed = 1;
};

/// Reads the networks. \throws OptionError; InputError if a network was trained on a tested mission
std::vector<Judged> read_networks(const Options& options, const DataSet& data,
                                  const std::vector<std::size_t>& tested) {
  std::vector<Judged> networks;
  for (std::size_t k = 0; k < options.weights.size(); ++k) {
    networks.push_back(read_judged(options.weights[k]));
    if (!options.names.empty()) networks.back().name = options.names[k];
    for (std::size_t other = 0; other < k; ++other) {
      if (networks[other].name == networks.back().name) {
        throw OptionError("two weights files are named " + networks.back().name +
                          "; --name tells them apart");
      }
    }
    const std::string& argument = options.weights[k];
    const std::set<std::string> seen = missions_of_weights(
        networks.back().features == GnnFeatures::kLamp ? argument.substr(0, argument.size() - 5) : argument);
    for (const std::size_t i : tested) {
      if (seen.count(data.entries[i].name) == 0) continue;
      throw InputError(argument + ": was trained with mission " + data.entries[i].name +
                       ", which is to be tested; --split-seed must be that of its training");
    }
  }
  return networks;
}

int run(const Options& options) {
  cli::Console console(options.common.quiet);
  const cli::InterruptGuard interrupt;
  JudgeOptions judging;
  load_section(options.common, "judge", judging);
  if (!options.names.empty() && options.names.size() != options.weights.size()) {
    throw OptionError("--name is given " + std::to_string(options.names.size()) + " times, for " +
                      std::to_string(options.weights.size()) + " weights files");
  }
  const DataSet data = read_data_set(options.data);
  const std::vector<Role> roles = split_by_mission(data.entries, options.split_seed);
  std::vector<std::size_t> tested;
  for (std::size_t i = 0; i < roles.size(); ++i) {
    if (roles[i] == Role::kTest) tested.push_back(i);
  }
  const std::vector<Judged> networks = read_networks(options, data, tested);
  std::vector<std::vector<Judgement>> results(tested.size());
  std::mutex mutex;
  std::size_t done = 0;
  ThreadPool pool(cli::thread_count(options.common));
  try {
    pool.for_each(tested.size(), [&](std::size_t k) {
      if (interrupt.interrupted()) throw Error("interrupted");
      results[k] = judge(data.read(tested[k]).record, networks, judging, interrupt.token());
      const std::lock_guard<std::mutex> lock(mutex);
      console.progress({"missions", ++done, tested.size(), data.entries[tested[k]].name});
    });
  } catch (const std::exception&) {
    if (!interrupt.interrupted()) throw;
    console.warn("interrupted: nothing was kept");
    return cli::kInterrupted;
  }
  std::vector<Judgement> all;
  for (const auto& result : results) all.insert(all.end(), result.begin(), result.end());
  const JudgementTables tables = summarize(all);
  Json graphs = Json::array();
  for (const Judgement& j : all) {
    graphs.push_back({{"mission", j.mission},
                      {"group", j.group},
                      {"other_size", j.other_size},
                      {"stage", j.stage},
                      {"nodes", j.nodes},
                      {"set_size", j.set_size},
                      {"method", j.method},
                      {"log_error", number_or_null(j.log_error)},
                      {"spearman_mixed", number_or_null(j.spearman_mixed)},
                      {"spearman_fixed", number_or_null(j.spearman_fixed)},
                      {"signs", number_or_null(j.signs)},
                      {"chosen", number_or_null(j.chosen)}});
  }
  if (!options.markdown.empty()) write_file(options.markdown, tables.markdown);
  cli::print_results(
      options.common,
      {{"options", to_json(judging)}, {"summary", parse_json(tables.json, "summary")}, {"graphs", graphs}},
      tables.markdown);
  return cli::kDone;
}

}  // namespace

void add_evaluate(cli::Command& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  cli::Command* command =
      app.add_subcommand("evaluate", "Judge networks on the missions of the data that are for the test");
  command->footer(
      "error of log e: median of |log(guessed / exact trace)| over sets of (a). Rank correlation (Spearman) "
      "with the\n"
      "exact trace over random sets (a) of 0 to B closures, (b) of B. (c): share of the swaps of a run of "
      "exact\n"
      "annealing whose sign is right. e of the chosen: exact trace, relative to no closures, of the set "
      "that\n"
      "annealing picks with the method; additive picks the best single gains.\n"
      "  loopwise-train evaluate data run/weights.json data/gnn/paper.json\n"
      "  loopwise-train evaluate data lamp_gnn.json:lamp              with LAMP's features\n"
      "Options of --set and --config: section judge, fields set_sizes, candidates, sets, evaluations, swaps, "
      "seed.");
  command->add_option("data", options->data, "Folder that 'loopwise-train data' made")
      ->required()
      ->type_name("DATA");
  command->add_option("weights", options->weights, "Weights files; without files only the other methods")
      ->type_name("FILE[:lamp]");
  command->add_option("--name", options->names, "Name of a network in the tables; once for each file")
      ->type_name("NAME")
      ->expected(1)
      ->take_all();
  command->add_option("--split-seed", options->split_seed, "Seed of the split by mission (default 1)")
      ->type_name("S")
      ->check(cli::not_negative());
  command->add_option("--markdown", options->markdown, "Write the tables to FILE")
      ->type_name("FILE")
      ->check(cli::not_standard_output());
  cli::finish_command(*command, options, run, chosen);
}

}  // namespace loopwise::training
