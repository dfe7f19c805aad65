// SPDX-License-Identifier: BSD-3-Clause
#include "reference.hpp"

#include <algorithm>
#include <cctype>
#include <sstream>

#include <loopwise/core/error.hpp>
#include <loopwise/core/version.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise::cli {
namespace {

/// The documentation of an option or positional argument.
struct OptionPage {
  std::vector<std::string> names;  // "-o", "--output"; only its name for a positional
  std::string value;               // "DIR"; empty for a flag
  std::string text;                // including bounds
  bool required = false;
  bool repeated = false;
  std::vector<std::string> words;
};

/// The documentation of a command and its subcommands.
struct CommandPage {
  std::vector<std::string> path;  // "loopwise", "study", "ablation"
  std::string text;
  std::string notes;
  std::vector<OptionPage> positionals, options;
  std::vector<CommandPage> commands;

  [[nodiscard]] std::string joined(const std::string& by) const { return CLI::detail::join(path, by); }
};

/// Splits CLI11's type name: "N:INT in [0 - 4096]" is a name and bounds, "KEY[:M]" is only a name.
std::pair<std::string, std::string> name_and_bounds(const std::string& type) {
  int depth = 0;
  for (std::size_t i = 0; i < type.size(); ++i) {
    if (type[i] == '[') ++depth;
    if (type[i] == ']') --depth;
    if (type[i] == ':' && depth == 0) return {type.substr(0, i), type.substr(i + 1)};
  }
  return {type, ""};
}

std::string sentence(std::string text) {
  if (!text.empty() && text.back() != '.') text += '.';
  return text;
}

/// Whether a value with this type name may be a file or folder, by the names in use.
bool may_be_file(const std::string& value) {
  static const std::vector<std::string> no_files = {
      "B", "LIST", "M", "MB", "M_PER_M RAD_PER_M", "N", "NAME", "P", "R", "RAD", "S", "VALUE", "WORD"};
  return value.find_first_of("[=") == std::string::npos &&
         std::find(no_files.begin(), no_files.end(), value) == no_files.end();
}

OptionPage option_page(const CLI::Option& option, const ValueWords& words) {
  OptionPage page;
  if (option.get_positional()) {
    page.names.push_back(option.get_name(true));
  } else {
    for (const std::string& name : option.get_snames()) page.names.push_back("-" + name);
    for (const std::string& name : option.get_lnames()) page.names.push_back("--" + name);
  }
  page.required = option.get_required();
  page.text = sentence(option.get_description());
  if (option.get_items_expected_max() != 0) {  // not a flag
    const auto [name, bounds] = name_and_bounds(option.get_type_name());
    page.value = name.empty() ? "VALUE" : name;
    page.repeated = option.get_expected_max() >= CLI::detail::expected_max_vector_size;
    if (!bounds.empty()) page.text += " Value: " + sentence(bounds);
    if (!option.get_default_str().empty()) page.text += " Default: " + sentence(option.get_default_str());
  }
  // The value of --guess is a word for one command and a file for another.
  if (option.get_positional() || !may_be_file(page.value)) {
    for (const std::string& name : page.names) {
      const auto found = words.find(name);
      if (found != words.end()) page.words = found->second;
    }
  }
  return page;
}

CommandPage command_page(const CLI::App& app, const ValueWords& words, std::vector<std::string> path) {
  CommandPage page;
  path.push_back(app.get_name());
  page.path = std::move(path);
  page.text = app.get_description();
  // Commands without their own note inherit that of their parent.
  if (app.get_parent() == nullptr || app.get_footer() != app.get_parent()->get_footer()) {
    page.notes = app.get_footer();
  }
  for (const CLI::Option* option : app.get_options()) {
    if (option->get_group().empty()) continue;
    (option->get_positional() ? page.positionals : page.options).push_back(option_page(*option, words));
  }
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (!command->get_group().empty()) page.commands.push_back(command_page(*command, words, page.path));
  }
  return page;
}

// Manual pages -------------------------------------------------------------------------------------------

/// Escapes text for man: '-' is printed as typed, and no line begins a request.
std::string roff(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else {
      out += c;
    }
  }
  if (!out.empty() && (out[0] == '.' || out[0] == '\'')) out.insert(0, "\\&");
  return out;
}

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return text;
}

/// Formats paragraphs; indented lines are kept as they are.
std::string roff_notes(const std::string& notes) {
  std::istringstream lines(notes);
  std::string out, line;
  bool example = false;
  const auto set_example = [&](bool wanted) {
    if (wanted != example) out += wanted ? ".PP\n.nf\n.RS\n" : ".RE\n.fi\n.PP\n";
    example = wanted;
  };
  while (std::getline(lines, line)) {
    const std::size_t begin = line.find_first_not_of(' ');
    if (begin == std::string::npos) {
      set_example(false);
      out += ".PP\n";
    } else {
      set_example(begin > 0);
      out += roff(line.substr(std::min<std::size_t>(begin, 2))) + "\n";
    }
  }
  set_example(false);
  return out;
}

std::string roff_option(const OptionPage& option, bool positional) {
  std::string out = ".TP\n";
  for (const std::string& name : option.names) {
    if (&name != &option.names.front()) out += ", ";
    out += (positional ? "\\fI" : "\\fB") + roff(name) + "\\fR";
  }
  if (!option.value.empty() && !positional) out += " \\fI" + roff(option.value) + "\\fR";
  if (option.repeated) out += " ...";
  out += "\n" + roff(option.text);
  if (option.required && !positional) out += " Must be given.";
  return out + "\n";
}

std::string roff_synopsis(const CommandPage& page) {
  std::string out = "\\fB" + roff(page.joined(" ")) + "\\fR [\\fIOPTIONS\\fR]";
  if (!page.commands.empty()) out += " \\fICOMMAND\\fR ...";
  for (const OptionPage& positional : page.positionals) {
    std::string name = "\\fI" + roff(positional.names[0]) + "\\fR";
    if (positional.repeated) name += " ...";
    out += positional.required ? " " + name : " [" + name + "]";
  }
  return out + "\n";
}

std::string roff_options(const CommandPage& page) {
  std::string out;
  for (const OptionPage& option : page.positionals) out += roff_option(option, true);
  for (const OptionPage& option : page.options) out += roff_option(option, false);
  return out;
}

std::string manual(const CommandPage& page, const std::vector<std::string>& see_also) {
  const std::string name = page.joined("-");
  std::string out = ".\\\" Made by the program itself.\n.TH \"" + upper(roff(name)) + "\" 1 \"\" \"" +
                    page.path[0] + " " + std::string(version()) + "\" \"Loopwise manual\"\n.nh\n.ad l\n";
  std::string text = page.text;
  std::replace(text.begin(), text.end(), '\n', ' ');
  out += ".SH NAME\n" + roff(name) + " \\- " + roff(text) + "\n.SH SYNOPSIS\n" + roff_synopsis(page);
  if (!page.notes.empty()) out += ".SH DESCRIPTION\n" + roff_notes(page.notes);
  if (!page.commands.empty()) {
    out += ".SH COMMANDS\n";
    for (const CommandPage& command : page.commands) {
      if (page.path.size() == 1) {
        out += ".TP\n\\fB" + roff(command.joined("-")) + "\\fR(1)\n" + roff(command.text) + "\n";
      } else {
        out += ".SS " + roff(command.joined(" ")) + "\n" + roff(command.text) + "\n.PP\n" +
               roff_synopsis(command) + ".PP\n" + roff_notes(command.notes) + roff_options(command);
      }
    }
  }
  out += ".SH OPTIONS\n" + roff_options(page);
  out +=
      ".SH EXIT STATUS\n.TP\n0\ndone\n.TP\n1\nanything not named here\n.TP\n2\nbad usage: an unknown option, "
      "a value "
      "out of bounds, an output folder that is not empty\n.TP\n3\nbad input: a file that is absent or "
      "broken\n.TP\n130\n"
      "interrupted\n";
  std::string others;
  for (const std::string& other : see_also) {
    if (other != name) others += (others.empty() ? ".BR " : " (1),\n.BR ") + roff(other);
  }
  if (!others.empty()) out += ".SH SEE ALSO\n" + others + " (1)\n";
  return out;
}

void write_manuals(const CommandPage& root, const std::filesystem::path& folder) {
  std::vector<std::string> names{root.path[0]};
  for (const CommandPage& command : root.commands) names.push_back(command.joined("-"));
  write_file(folder / (names[0] + ".1"), manual(root, names));
  for (const CommandPage& command : root.commands) {
    write_file(folder / (command.joined("-") + ".1"), manual(command, names));
  }
}

// Completion ---------------------------------------------------------------------------------------------

void each_command(const CommandPage& page, const std::function<void(const CommandPage&)>& visit) {
  visit(page);
  for (const CommandPage& command : page.commands) each_command(command, visit);
}

/// The kind of a value: a word of a list, a file or folder, or another value.
enum class ValueKind { kWords, kFile, kOther };

ValueKind value_kind(const OptionPage& option) {
  if (!option.words.empty()) return ValueKind::kWords;
  return may_be_file(option.value) ? ValueKind::kFile : ValueKind::kOther;
}

/// Patterns of a shell `case`: "a" | "b".
std::string patterns(const std::vector<std::string>& alternatives) {
  std::string out;
  for (const std::string& one : alternatives) out += (out.empty() ? "\"" : " | \"") + one + "\"";
  return out;
}

std::string command_patterns(const CommandPage& root) {
  std::vector<std::string> paths;
  each_command(root, [&](const CommandPage& page) {
    if (page.path.size() > 1) paths.push_back(page.joined(" "));
  });
  return patterns(paths);
}

/// The command followed by each name of an option, as patterns for `case "$command $previous"`.
std::string value_patterns(const CommandPage& page, const OptionPage& option) {
  std::vector<std::string> places;
  for (const std::string& name : option.names) places.push_back(page.joined(" ") + " " + name);
  return patterns(places);
}

/// Words for arguments without a name: subcommands, or the values of the first positional.
std::vector<std::string> plain_words(const CommandPage& page) {
  std::vector<std::string> words;
  for (const CommandPage& command : page.commands) words.push_back(command.path.back());
  if (words.empty() && !page.positionals.empty()) words = page.positionals[0].words;
  return words;
}

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
      const ValueKind kind = value_kind(option);
      values += "    " + value_patterns(page, option) + ")\n";
      if (kind == ValueKind::kWords) {
        if (option.words.front().back() == '=') values += "      compopt -o nospace\n";
        values += "      mapfile -t COMPREPLY < <(compgen -W \"" + CLI::detail::join(option.words, " ") +
                  "\" -- \"$current\")\n";
      } else if (kind == ValueKind::kFile) {
        values += "      compopt -o default\n";
      }
      values += "      return ;;\n";
    }
    options += "    \"" + page.joined(" ") + "\")\n      options=\"" + CLI::detail::join(names, " ") +
               "\"\n      words=\"" + CLI::detail::join(plain_words(page), " ") + "\" ;;\n";
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

/// Text in single quotes; `escape` replaces a quote in it.
std::string single_quoted(const std::string& text, const std::string& escape) {
  std::string out = "'";
  for (const char c : text) {
    if (c == '\'') {
      out += escape;
    } else {
      out += c == '\n' ? ' ' : c;
    }
  }
  return out + "'";
}

/// "name:text" for zsh's _describe.
std::string zsh_item(const std::string& name, const std::string& text) {
  std::string plain;
  for (const char c : name) plain += c == ':' ? std::string("\\:") : std::string(1, c);
  return single_quoted(plain + ":" + text, "'\\''");
}

std::string zsh_completion(const CommandPage& root) {
  const std::string name = root.path[0];
  std::string options, values;
  each_command(root, [&](const CommandPage& page) {
    options += "  \"" + page.joined(" ") + "\")\n    options=(\n";
    for (const OptionPage& option : page.options) {
      for (const std::string& own : option.names) options += "      " + zsh_item(own, option.text) + "\n";
      if (option.value.empty()) continue;
      const ValueKind kind = value_kind(option);
      values += "  " + value_patterns(page, option) + ")\n";
      if (kind == ValueKind::kWords) {
        const bool open = option.words.front().back() == '=';
        values += std::string("    compadd ") + (open ? "-S '' " : "") + "-- " +
                  CLI::detail::join(option.words, " ") + "\n";
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
      for (const std::string& word : plain_words(page)) options += "      " + zsh_item(word, word) + "\n";
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
              CLI::detail::join(below, " ");
    }
    const std::string begin = "complete -c " + name + " -n " + quoted(here);
    for (const CommandPage& command : page.commands) {
      out += begin + " -f -a " + command.path.back() + " -d " + quoted(command.text) + "\n";
    }
    if (page.commands.empty() && !plain_words(page).empty()) {
      out += begin + " -f -a " + quoted(CLI::detail::join(plain_words(page), " ")) + "\n";
    }
    for (const OptionPage& option : page.options) {
      out += begin;
      for (const std::string& own : option.names) {
        out += own.compare(0, 2, "--") == 0 ? " -l " + own.substr(2) : " -s " + own.substr(1);
      }
      if (!option.value.empty()) {
        const ValueKind kind = value_kind(option);
        out += kind == ValueKind::kFile ? " -r" : " -x";
        if (kind == ValueKind::kWords) out += " -a " + quoted(CLI::detail::join(option.words, " "));
      }
      out += " -d " + quoted(option.text) + "\n";
    }
  });
  return out;
}

}  // namespace

void write_reference(const CLI::App& app, const ValueWords& words, const std::filesystem::path& folder) {
  const CommandPage root = command_page(app, words, {});
  const std::string name = root.path[0];
  const std::filesystem::path manuals = folder / "man" / "man1",
                              bash = folder / "bash-completion" / "completions",
                              zsh = folder / "zsh" / "site-functions",
                              fish = folder / "fish" / "vendor_completions.d";
  for (const std::filesystem::path& place : {manuals, bash, zsh, fish}) {
    std::error_code failure;
    std::filesystem::create_directories(place, failure);
    if (failure) throw IoError(place.string(), failure.message());
  }
  write_manuals(root, manuals);
  write_file(bash / name, bash_completion(root));
  write_file(zsh / ("_" + name), zsh_completion(root));
  write_file(fish / (name + ".fish"), fish_completion(root));
}

void add_reference(CLI::App& app, Action& chosen, const ValueWords& words) {
  const auto folder = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("reference", "Write manual pages and completion for shells");
  command->group("");  // for the build, not for users
  command->add_option("folder", *folder, "Tree as of /usr/share")->type_name("DIR")->required();
  command->callback([folder, words, &app, &chosen] {
    chosen = [folder, words, &app] {
      write_reference(app, words, *folder);
      return kDone;
    };
  });
}

}  // namespace loopwise::cli
