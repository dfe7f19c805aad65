// SPDX-License-Identifier: BSD-3-Clause
// Manual pages in roff.
#include <algorithm>
#include <cctype>
#include <sstream>

#include <loopwise/core/version.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "reference_writers.hpp"

namespace loopwise::cli {
namespace {

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

}  // namespace

void write_manuals(const CommandPage& root, const std::filesystem::path& folder) {
  std::vector<std::string> names{root.path[0]};
  for (const CommandPage& command : root.commands) names.push_back(command.joined("-"));
  write_file(folder / (names[0] + ".1"), manual(root, names));
  for (const CommandPage& command : root.commands) {
    write_file(folder / (command.joined("-") + ".1"), manual(command, names));
  }
}

}  // namespace loopwise::cli
