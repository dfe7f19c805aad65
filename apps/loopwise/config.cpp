// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include "command.hpp"

namespace loopwise::cli {

void add_config(CLI::App& app, Action& chosen) {
  struct Options {
    CommonOptions common;
    bool describe = false;
  };
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("config", "Print every option with its default");
  command->footer(
      "Prints a configuration that --config takes: the defaults, changed by --config and --set.\n"
      "  loopwise config > my.json\n"
      "  loopwise config --describe        every option with bounds and meaning");
  command->add_flag("--describe", options->describe, "A table with bounds and meaning instead");
  add_common_options(*command, options->common);
  command->callback([options, &chosen] {
    chosen = [options] {
      const Config config = load_config(options->common);
      const Json json = parse_json(config_json(config), "configuration");
      std::string text;
      if (options->describe) {
        for (const ConfigEntry& entry : describe_config(config)) {
          text += entry.name + " = " + entry.value +
                  (entry.bounds.empty() ? "" : "   (" + entry.bounds + ")") + "\n    " + entry.doc + "\n";
        }
      } else {
        text = json.dump(2) + "\n";
      }
      print_results(options->common, json, text);
      return kDone;
    };
  });
}

}  // namespace loopwise::cli
