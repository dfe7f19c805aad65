// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/output_folder.hpp>

#include "commands.hpp"
#include "data_sources.hpp"

namespace loopwise::training {
namespace {

struct Options {
  CommonOptions common;
  SourceArguments sources;
  std::string output;
  bool resume = false;
};

int run(const Options& options) {
  cli::Console console(options.common.quiet);
  const cli::InterruptGuard interrupt;
  DataOptions data;
  load_section(options.common, "data", data);
  const std::vector<DataSource> sources = sources_of(options.sources);
  static_cast<void>(data_set_entries(sources));  // reports unusable sources before the folder is made
  prepare_output_folder(options.output, options.resume, "; --resume continues interrupted data");
  ThreadPool pool(cli::thread_count(options.common));
  DataSetCounts counts;
  try {
    counts =
        make_data_set(options.output, sources, data, pool, interrupt.token(), console.progress_callback());
  } catch (const std::exception&) {
    if (!interrupt.interrupted()) throw;
    console.warn("interrupted: finished missions are kept, --resume continues");
    return cli::kInterrupted;
  }
  const Json json = {{"folder", options.output}, {"missions", counts.missions}, {"kept", counts.kept},
                     {"graphs", counts.graphs},  {"sets", counts.sets},         {"options", to_json(data)}};
  cli::print_results(options.common, json,
                     std::to_string(counts.missions) + " missions, " + std::to_string(counts.graphs) +
                         " graphs, " + std::to_string(counts.sets) + " sets solved exactly, in " +
                         options.output + "\n");
  return cli::kDone;
}

}  // namespace

void add_data(cli::Command& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  cli::Command* command =
      app.add_subcommand("data", "Make data: missions, graphs of them, sets solved exactly");
  command->footer(
      "Without missions, simulates some: each world with each seed, lengths in turn. Those of "
      "--other-lengths "
      "are\nfor the test alone.\n"
      "  loopwise-train data -o data\n"
      "  loopwise-train data mission1 mission2 mission3 -o data\n"
      "Options of --set and --config: section data, fields candidates, max_set, random_sets, annealing_runs, "
      "seed.");
  command->add_option("missions", options->sources.missions, "Mission folders, session folders or g2o files")
      ->type_name("MISSION");
  command
      ->add_option("--other-size", options->sources.other_size,
                   "A mission for the test alone; may be repeated")
      ->type_name("MISSION")
      ->expected(1)
      ->take_all();
  command->add_option("-o,--output", options->output, "Folder for the data: a new one, or empty")
      ->required()
      ->type_name("DIR")
      ->check(cli::not_standard_output());
  command->add_option("--worlds", options->sources.worlds, "Worlds to simulate (default all)")
      ->type_name("LIST");
  command->add_option("--seeds", options->sources.seeds, "Missions of each world (default 12)")
      ->type_name("N")
      ->check(cli::in_range(0, 100000));
  command
      ->add_option("--first-seed", options->sources.first_seed,
                   "Seed of the first mission of each world (default 1)")
      ->type_name("S")
      ->check(cli::not_negative());
  command
      ->add_option("--lengths", options->sources.lengths, "Path length of the team, m (default 300,500,800)")
      ->type_name("M,...")
      ->delimiter(',');
  command
      ->add_option("--other-lengths", options->sources.other_lengths,
                   "Lengths of missions that are for the test alone (default 1600)")
      ->type_name("M,...")
      ->delimiter(',');
  command
      ->add_option("--other-seeds", options->sources.other_seeds, "Missions of each such length (default 2)")
      ->type_name("N")
      ->check(cli::in_range(0, 100000));
  command->add_flag("--resume", options->resume, "Continue interrupted data");
  cli::finish_command(*command, options, run, chosen);
}

}  // namespace loopwise::training
