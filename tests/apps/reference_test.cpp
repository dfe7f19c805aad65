// SPDX-License-Identifier: BSD-3-Clause
// Manual pages and completion have the contents of --help, which this test parses as a user reads it.
#include <cstdlib>
#include <sstream>

#include "apps/program.hpp"
#include "testing.hpp"

namespace loopwise::reference_test {
namespace {

using testing::ProgramRun;
using testing::read_text;
using testing::run_program;
using testing::TemporaryFolder;

std::string program_name() {
  return std::filesystem::path(LOOPWISE_PROGRAM).filename().string();
}

std::string joined(const std::vector<std::string>& words, const std::string& by) {
  std::string out;
  for (const std::string& word : words) out += (out.empty() ? "" : by) + word;
  return out;
}

/// A command as `--help` shows it.
struct Shown {
  std::vector<std::string> path;  // below the program
  std::vector<std::string> options;
  std::vector<std::string> commands;
};

Shown shown_by_help(const std::vector<std::string>& path) {
  Shown shown;
  shown.path = path;
  std::vector<std::string> arguments = path;
  arguments.emplace_back("--help");
  const ProgramRun run = run_program(arguments);
  REQUIRE(run.status == 0);
  std::istringstream lines(run.out);
  std::string line, block;
  while (std::getline(lines, line)) {
    if (line.empty()) block.clear();
    if (!line.empty() && line[0] != ' ') block = line;
    std::istringstream words(line);
    std::string word;
    if (line.compare(0, 2, "  ") != 0 || line.compare(0, 3, "   ") == 0 || !(words >> word)) continue;
    if (block == "Options:" && word[0] == '-') {
      std::istringstream names(word);
      for (std::string name; std::getline(names, name, ',');) {
        shown.options.push_back(name.substr(0, name.find('{')));
      }
    } else if (block == "Subcommands:") {
      shown.commands.push_back(word);
    }
  }
  return shown;
}

std::vector<Shown> all_shown(const std::vector<std::string>& path = {}) {
  std::vector<Shown> all{shown_by_help(path)};
  for (const std::string& command : all[0].commands) {
    std::vector<std::string> below = path;
    below.push_back(command);
    for (Shown& shown : all_shown(below)) all.push_back(std::move(shown));
  }
  return all;
}

/// A name as it is written in a manual page.
std::string in_roff(const std::string& name) {
  std::string out;
  for (const char c : name) out += c == '-' ? std::string("\\-") : std::string(1, c);
  return out;
}

/// The text between `begin` and `end`; fails if it is missing.
std::string section(const std::string& text, const std::string& begin, const std::string& end) {
  CAPTURE(begin);
  const std::size_t at = text.find(begin);
  REQUIRE(at != std::string::npos);
  return text.substr(at + begin.size(), text.find(end, at + begin.size()) - at - begin.size());
}

bool has_word(const std::string& text, const std::string& word) {
  std::istringstream words(text);
  for (std::string one; words >> one;) {
    if (one == word) return true;
  }
  return false;
}

struct Reference {
  TemporaryFolder folder;
  std::filesystem::path bash, zsh, fish;

  Reference() {
    const ProgramRun run = run_program({"reference", folder.path().string()});
    INFO(run.err);
    REQUIRE(run.status == 0);
    bash = folder / "bash-completion" / "completions" / program_name();
    zsh = folder / "zsh" / "site-functions" / ("_" + program_name());
    fish = folder / "fish" / "vendor_completions.d" / (program_name() + ".fish");
  }
  /// The page of the command; deeper ones stand in their parent's.
  [[nodiscard]] std::string manual(const std::vector<std::string>& path) const {
    return read_text(folder / "man" / "man1" / (program_name() + (path.empty() ? "" : "-" + path[0]) + ".1"));
  }
};

/// Whether a program of this name can be run.
bool installed(const std::string& name) {
  return std::system(("command -v " + name + " >/dev/null 2>&1").c_str()) == 0;
}

bool succeeds(const std::string& command) {
  const int status = std::system(command.c_str());
  return status != -1 && WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

}  // namespace

TEST_CASE("reference: every command and option is in manual pages and completion", "[reference]") {
  const Reference reference;
  const std::string bash = read_text(reference.bash), zsh = read_text(reference.zsh),
                    fish = read_text(reference.fish);
  const std::vector<Shown> all = all_shown();
  REQUIRE(all.size() >= 4);
  for (const Shown& shown : all) {
    std::vector<std::string> full = shown.path;
    full.insert(full.begin(), program_name());
    const std::string command = joined(full, " ");
    CAPTURE(command);
    const std::string manual = reference.manual(shown.path);
    REQUIRE_THAT(manual, Contains("\\fB" + in_roff(command) + "\\fR"));
    const std::string in_bash = section(bash, "    \"" + command + "\")\n      options=\"", "\"");
    const std::string in_zsh = section(zsh, "  \"" + command + "\")\n    options=(\n", "    )\n");
    REQUIRE_FALSE(shown.options.empty());
    for (const std::string& option : shown.options) {
      CAPTURE(option);
      REQUIRE_THAT(manual, Contains("\\fB" + in_roff(option) + "\\fR"));
      if (option == "--quiet") REQUIRE_THAT(manual, !Contains("\\fB" + in_roff(option) + "\\fR \\fI"));
      REQUIRE(has_word(in_bash, option));
      REQUIRE_THAT(in_zsh, Contains("'" + option + ":"));
      const bool is_long = option.compare(0, 2, "--") == 0;
      REQUIRE_THAT(fish,
                   Contains(is_long ? " -l " + option.substr(2) + " " : " -s " + option.substr(1) + " "));
    }
    for (const std::string& below : shown.commands) {
      CAPTURE(below);
      const std::string block = section(bash, "    \"" + command + "\")\n      options=", ";;");
      REQUIRE(has_word(section(block, "words=\"", "\""), below));
      REQUIRE_THAT(fish, Contains(" -f -a " + below + " -d "));
    }
  }
  // It is for the build alone.
  REQUIRE_THAT(bash, !Contains("reference"));
  REQUIRE_THAT(run_program({"--help"}).out, !Contains("reference"));
}

TEST_CASE("reference: the same command line gives the same files", "[reference]") {
  const Reference one, two;
  REQUIRE(read_text(one.bash) == read_text(two.bash));
  REQUIRE(one.manual({}) == two.manual({}));
}

TEST_CASE("reference: man and the shells accept the files", "[reference]") {
  const Reference reference;
  if (installed("man")) {
    for (const auto& page : std::filesystem::directory_iterator(reference.folder / "man" / "man1")) {
      CAPTURE(page.path().string());
      const std::string errors = (reference.folder / "errors").string();
      REQUIRE(succeeds("LC_ALL=C.UTF-8 MANWIDTH=100 MANROFFOPT=-ww man --warnings=all -l '" +
                       page.path().string() + "' >/dev/null 2>'" + errors + "'"));
      REQUIRE(read_text(errors).empty());
    }
  } else {
    WARN("man is not installed: manual pages are not tried");
  }
  const std::pair<const char*, std::filesystem::path> shells[] = {
      {"bash", reference.bash}, {"zsh", reference.zsh}, {"fish", reference.fish}};
  for (const auto& [shell, file] : shells) {
    CAPTURE(shell);
    if (!installed(shell)) {
      WARN(shell << " is not installed: its completion is not tried");
      continue;
    }
    REQUIRE(succeeds(std::string(shell) + " -n '" + file.string() + "'"));
  }
}

TEST_CASE("reference: completion by bash", "[reference]") {
  if (!installed("bash")) {
    WARN("bash is not installed");
    return;
  }
  const Reference reference;
  const std::string command = all_shown()[1].path[0];  // the first subcommand
  const auto completed = [&](const std::string& words, int current) {
    const std::string out = (reference.folder / "completed").string();
    std::string function = "_" + program_name();
    for (char& c : function) c = c == '-' ? '_' : c;
    // compopt works within a completion alone.
    REQUIRE(succeeds("bash -c '. \"" + reference.bash.string() + "\"; compopt() { :; }; COMP_WORDS=(" +
                     program_name() + " " + words + "); COMP_CWORD=" + std::to_string(current) + "; " +
                     function + "; echo \"${COMPREPLY[*]}\"' >'" + out + "'"));
    return read_text(out);
  };
  REQUIRE(has_word(completed(command.substr(0, 2), 1), command));
  REQUIRE(has_word(completed(command + " --js", 2), "--json"));
  REQUIRE_FALSE(has_word(completed(command + " --threads --js", 3), "--json"));  // a value, not an option
  if (program_name() == "loopwise") {
    REQUIRE(completed("study abl", 2) == "ablation\n");
    REQUIRE(has_word(completed("study ablation --wor", 3), "--workers"));
    REQUIRE(has_word(completed("replay x --method g", 4), "gi"));
    REQUIRE(has_word(completed("info x --set generation.rad", 4), "generation.radius_max_m="));
    REQUIRE(completed("register a.pcd b.pcd --guess e", 5) == "\n");  // a file there, a word for replay
  }
}

}  // namespace loopwise::reference_test
