// SPDX-License-Identifier: BSD-3-Clause
#include "common_options.hpp"

#include <charconv>
#include <cstdint>
#include <iostream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise::cli {

void add_common_options(Command& command, CommonOptions& options) {
  command.add_option("--json", options.json, "Write the results as JSON to FILE (- for standard output)")
      ->type_name("FILE");
  command.add_option("--config", options.config, "Read options from a JSON file (see 'loopwise config')")
      ->type_name("FILE");
  command
      .add_option("--set", options.set,
                  "Set one option, for example --set generation.radius_max_m=20; may be repeated")
      ->type_name("SECTION.FIELD=VALUE")
      ->expected(1)
      ->take_all();
  command
      .add_option("--threads", options.threads, "Threads; 0 takes all processors. Never changes the results")
      ->type_name("N")
      ->check(in_range(0, 4096));
  command.add_flag("--strict", options.strict,
                   "Input is an error if a measurement would be repaired, guessed or left out");
  command.add_flag("--quiet", options.quiet, "No progress and no notes; warnings and errors remain");
}

Check not_negative() {
  return Check([](const std::string& text) -> std::string {
    std::uint64_t value = 0;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    if (!text.empty() && text.front() == '-') return text + " is negative, must be >= 0";
    if (parsed.ec == std::errc::result_out_of_range) return text + " exceeds 64 bits";
    return {};
  });
}

Check not_standard_output() {
  return Check([](const std::string& path) -> std::string {
    if (path != "-") return {};
    return "\"-\" is standard output, which gets the results: give a file name (./- for a file of that "
           "name; --json - prints the results as JSON)";
  });
}

Config load_config(const CommonOptions& options, const Config& defaults) {
  Config config = defaults;
  if (!options.config.empty()) read_config(options.config, config);
  for (const std::string& assignment : options.set) set_config_option(assignment, config);
  for (const std::string& assignment : options.reading) set_config_option(assignment, config);
  if (options.strict) config.mission.strict = true;
  validate_config(config);
  return config;
}

int thread_count(const CommonOptions& options) {
  return resolve_threads(options.threads);
}

void print_results(const CommonOptions& options, const Json& json, const std::string& text) {
  // The text is made only if it is requested, because it may be long.
  print_json_text(options, options.json.empty() ? std::string() : json_text(json, 2) + "\n", text);
}

void print_json_text(const CommonOptions& options, const std::string& json, const std::string& text) {
  const bool to_output = options.json == "-";
  if (!options.json.empty() && !to_output) write_file(options.json, json);
  std::cout << (to_output ? json : text) << std::flush;
  if (!std::cout) throw IoError("standard output", "cannot be written");
}

}  // namespace loopwise::cli
