// SPDX-License-Identifier: BSD-3-Clause
#include <map>
#include <stdexcept>

#include <nlohmann/json.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

/// Description of a section. Every section must have one.
const std::string& section_text(const std::string& section) {
  static const std::map<std::string, std::string> texts = {
      {"mission", "Reading of missions, and the defaults of data that their files lack."},
      {"joining", "Sources without a common frame: conditions for joining two of them."},
      {"generation",
       "Candidates by proximity. In a file the key `preset` names a preset that the other keys then change: "
       "`lamp_base` (the defaults), `lamp_2022_01`, `lamp_robot` or `paper`."},
      {"appearance", "Candidates by the appearance of places."},
      {"radio", "Candidates by passes of radio beacons."},
      {"engine", "Decisions about the whole mission: seed, guesses, estimates."},
      {"prioritization", "Which prioritisers order the candidates."},
      {"registration", "The registration of candidates."},
      {"cost", "How much mission time the computation takes on the virtual clock."},
      {"features", "Preparation of scans, once for all stages."},
      {"pool", "When candidates expire, and which come last."},
      {"expected", "Prioritisers `expected` and `likely`: candidates drawn by their expected gain."},
      {"observability", "Prioritiser `obs`: scans that constrain a registration best come first."},
      {"graph_information", "Prioritiser `gi`: the set that makes the whole graph most certain comes first."},
      {"closure_model", "The model of a candidate's closure for `gi`."},
      {"annealing", "Simulated annealing of the sets of `gi`."},
      {"greedy", "Greedy choice of the sets of `gi`."},
      {"task", "Scans and guess of a registration."},
      {"fast_registrar", "Registration `fast`, with its tests of closures."},
      {"pcl_registrar", "Registration `pcl`, the reference, with its tests of closures."},
      {"icp_registrar", "Registration `icp`, the way of open SLAM programs, for comparison."},
      {"optimization", "The back end: least squares over poses."},
      {"gnc", "The back end: robust weights of closures."},
      {"replay", "The replay of a mission; most have an option of `loopwise replay` of the same name."},
  };
  const auto found = texts.find(section);
  if (found == texts.end()) throw std::logic_error("section " + section + " has no sentence in config.cpp");
  return found->second;
}

/// Escapes text for a cell of a Markdown table.
std::string cell(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '|' ? std::string("\\|") : std::string(1, c);
  return out;
}

std::string config_markdown(const Config& config) {
  std::string text = R"(# Configuration

Every option of a configuration file, as `loopwise config --markdown` prints them. A file is an object of sections,
`{"generation": {"radius_max_m": 20}}`, given by `--config FILE`; `--set generation.radius_max_m=20` sets one option.
`//` comments are allowed. Omitted keys keep their defaults; an unknown key or a value out of bounds is an error.
`loopwise config` prints all of them as such a file.
)";
  std::string section;
  for (const ConfigEntry& entry : describe_config(config)) {
    const std::size_t dot = entry.name.find('.');
    if (entry.name.substr(0, dot) != section) {
      section = entry.name.substr(0, dot);
      text += "\n## " + section + "\n\n" + section_text(section) +
              "\n\n| option | type | default | bounds | meaning |\n| --- | --- | --- | --- | --- |\n";
    }
    text += "| `" + entry.name.substr(dot + 1) + "` | " + entry.type + " | `" + cell(entry.value) + "` | " +
            cell(entry.bounds) + " | " + cell(entry.doc) + " |\n";
  }
  return text;
}

}  // namespace

void add_config(Command& app, Action& chosen) {
  struct Options {
    CommonOptions common;
    bool describe = false, markdown = false;
  };
  const auto options = std::make_shared<Options>();
  Command* command = app.add_subcommand("config", "Print every option with its default");
  command->footer(
      "Prints a configuration that --config takes: the defaults, changed by --config and --set.\n"
      "  loopwise config > my.json\n"
      "  loopwise config --describe        every option with bounds and meaning");
  Argument* describe =
      command->add_flag("--describe", options->describe, "A table with bounds and meaning instead");
  command->add_flag("--markdown", options->markdown, "The same as a page in Markdown (docs/configuration.md)")
      ->excludes(describe);
  add_common_options(*command, options->common);
  command->callback([options, &chosen] {
    chosen = [options] {
      const Config config = load_config(options->common);
      const Json json = parse_json(config_json(config), "configuration");
      std::string text;
      if (options->markdown) {
        text = config_markdown(config);
      } else if (options->describe) {
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
