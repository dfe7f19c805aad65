// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include "reference_writers.hpp"

namespace loopwise::cli {

std::string bash_completion(const CommandPage& root) {
  const std::string name = root.path[0];
  std::string function = "_" + name;
  std::replace(function.begin(), function.end(), '-', '_');
  std::string options, values;
  each_command(root, [&](const CommandPage& page) {
    std::vector<std::string> names;
    for (const OptionPage& option : page.options) {
      names.insert(names.end(), option.names.begin(), option.names.end());
      if (option.value.empty()) continue;
      const ValueKind kind = option.value_kind();
      values += "    " + value_patterns(page, option) + ")\n";
      if (kind == ValueKind::kWords) {
        if (option.words.front().back() == '=') values += "      compopt -o nospace\n";
        values += "      mapfile -t COMPREPLY < <(compgen -W \"" + join(option.words, " ") +
                  "\" -- \"$current\")\n";
      } else if (kind == ValueKind::kFile) {
        values += "      compopt -o default\n";
      }
      values += "      return ;;\n";
    }
    options += "    \"" + page.joined(" ") + "\")\n      options=\"" + join(names, " ") +
               "\"\n      words=\"" + join(page.plain_words(), " ") + "\" ;;\n";
  });
  return "# bash completion for " + name + ", made by the program itself\n" + function +
         "() {\n"
         "  local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD - 1]}\n"
         "  local command=" +
         name +
         " options= words= i\n"
         "  COMPREPLY=()\n"
         "  for ((i = 1; i < COMP_CWORD; ++i)); do\n"
         "    case \"$command ${COMP_WORDS[i]}\" in\n"
         "    " +
         command_patterns(root) +
         ") command+=\" ${COMP_WORDS[i]}\" ;;\n"
         "    esac\n"
         "  done\n"
         "  case \"$command $previous\" in\n" +
         values +
         "  esac\n"
         "  case \"$command\" in\n" +
         options +
         "  esac\n"
         "  if [[ $current == -* ]]; then\n"
         "    mapfile -t COMPREPLY < <(compgen -W \"$options\" -- \"$current\")\n"
         "  elif [[ -n $words ]]; then\n"
         "    mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n"
         "  else\n"
         "    compopt -o default\n"
         "  fi\n"
         "}\n"
         "complete -F " +
         function + " " + name + "\n";
}

}  // namespace loopwise::cli
