// SPDX-License-Identifier: BSD-3-Clause
#include "reference_writers.hpp"

namespace loopwise::cli {

std::string fish_completion(const CommandPage& root) {
  const std::string name = root.path[0];
  std::string out = "# fish completion for " + name + ", made by the program itself\n";
  const auto quoted = [](const std::string& text) { return single_quoted(text, "\\'"); };
  each_command(root, [&](const CommandPage& page) {
    std::string seen;
    for (std::size_t i = 1; i < page.path.size(); ++i) {
      seen += (i == 1 ? "" : "; and ") + ("__fish_seen_subcommand_from " + page.path[i]);
    }
    std::vector<std::string> below;
    for (const CommandPage& command : page.commands) below.push_back(command.path.back());
    std::string here = seen;
    if (!below.empty()) {
      here += (seen.empty() ? "not __fish_seen_subcommand_from " : "; and not __fish_seen_subcommand_from ") +
              join(below, " ");
    }
    const std::string begin = "complete -c " + name + " -n " + quoted(here);
    for (const CommandPage& command : page.commands) {
      out += begin + " -f -a " + command.path.back() + " -d " + quoted(command.text) + "\n";
    }
    if (page.commands.empty() && !page.plain_words().empty()) {
      out += begin + " -f -a " + quoted(join(page.plain_words(), " ")) + "\n";
    }
    for (const OptionPage& option : page.options) {
      out += begin;
      for (const std::string& own : option.names) {
        out += own.compare(0, 2, "--") == 0 ? " -l " + own.substr(2) : " -s " + own.substr(1);
      }
      if (!option.value.empty()) {
        const ValueKind kind = option.value_kind();
        out += kind == ValueKind::kFile ? " -r" : " -x";
        if (kind == ValueKind::kWords) out += " -a " + quoted(join(option.words, " "));
      }
      out += " -d " + quoted(option.text) + "\n";
    }
  });
  return out;
}

}  // namespace loopwise::cli
