// SPDX-License-Identifier: BSD-3-Clause
// Parts that the completions of several shells share.
#include "reference_writers.hpp"

namespace loopwise::cli {
namespace {

/// Patterns of a shell `case`: "a" | "b".
std::string patterns(const std::vector<std::string>& alternatives) {
  std::string out;
  for (const std::string& one : alternatives) out += (out.empty() ? "\"" : " | \"") + one + "\"";
  return out;
}

}  // namespace

void each_command(const CommandPage& page, const std::function<void(const CommandPage&)>& visit) {
  visit(page);
  for (const CommandPage& command : page.commands) each_command(command, visit);
}

std::string command_patterns(const CommandPage& root) {
  std::vector<std::string> paths;
  each_command(root, [&](const CommandPage& page) {
    if (page.path.size() > 1) paths.push_back(page.joined(" "));
  });
  return patterns(paths);
}

std::string value_patterns(const CommandPage& page, const OptionPage& option) {
  std::vector<std::string> places;
  for (const std::string& name : option.names) places.push_back(page.joined(" ") + " " + name);
  return patterns(places);
}

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

}  // namespace loopwise::cli
