// SPDX-License-Identifier: BSD-3-Clause
#include "reference_writers.hpp"

namespace loopwise::cli {
namespace {

/// "name:text" for zsh's _describe.
std::string zsh_item(const std::string& name, const std::string& text) {
  std::string plain;
  for (const char c : name) plain += c == ':' ? std::string("\\:") : std::string(1, c);
  return single_quoted(plain + ":" + text, "'\\''");
}

}  // namespace

std::string zsh_completion(const CommandPage& root) {
  const std::string name = root.path[0];
  std::string options, values;
  each_command(root, [&](const CommandPage& page) {
    options += "  \"" + page.joined(" ") + "\")\n    options=(\n";
    for (const OptionPage& option : page.options) {
      for (const std::string& own : option.names) options += "      " + zsh_item(own, option.text) + "\n";
      if (option.value.empty()) continue;
      const ValueKind kind = option.value_kind();
      values += "  " + value_patterns(page, option) + ")\n";
      if (kind == ValueKind::kWords) {
        const bool open = option.words.front().back() == '=';
        values +=
            std::string("    compadd ") + (open ? "-S '' " : "") + "-- " + join(option.words, " ") + "\n";
      } else if (kind == ValueKind::kFile) {
        values += "    _files\n";
      }
      values += "    return ;;\n";
    }
    options += "    )\n    words_here=(\n";
    for (const CommandPage& command : page.commands) {
      options += "      " + zsh_item(command.path.back(), command.text) + "\n";
    }
    if (page.commands.empty()) {
      for (const std::string& word : page.plain_words()) options += "      " + zsh_item(word, word) + "\n";
    }
    options += "    ) ;;\n";
  });
  return "#compdef " + name +
         "\n# Made by the program itself.\n"
         "local command=" +
         name +
         " i\n"
         "local -a options words_here\n"
         "for ((i = 2; i < CURRENT; ++i)); do\n"
         "  case \"$command $words[i]\" in\n"
         "  " +
         command_patterns(root) +
         ") command+=\" $words[i]\" ;;\n"
         "  esac\n"
         "done\n"
         "case \"$command $words[CURRENT-1]\" in\n" +
         values +
         "esac\n"
         "case \"$command\" in\n" +
         options +
         "esac\n"
         "if [[ $words[CURRENT] == -* ]]; then\n"
         "  _describe -o option options\n"
         "elif (( $#words_here )); then\n"
         "  _describe command words_here\n"
         "else\n"
         "  _files\n"
         "fi\n";
}

}  // namespace loopwise::cli
