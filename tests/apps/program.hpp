// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Runs the built `loopwise` as a user's script does.
#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>

#include "testing.hpp"

namespace loopwise::testing {

struct ProgramRun {
  int status = -1;  ///< Exit status; 128 + the signal if one ended it.
  std::string out;
  std::string err;
};

/// The program at work. Its standard output and error go to files, so that neither can block it.
class Program {
 public:
  explicit Program(const std::vector<std::string>& arguments) {
    std::vector<std::string> words{LOOPWISE_PROGRAM};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    const std::string out = (folder_ / "out").string(), err = (folder_ / "err").string();
    process_ = fork();
    if (process_ != 0) return;
    constexpr int kReplace = O_CREAT | O_WRONLY | O_TRUNC;
    dup2(open(out.c_str(), kReplace, 0600), STDOUT_FILENO);
    dup2(open(err.c_str(), kReplace, 0600), STDERR_FILENO);
    execv(argv[0], argv.data());
    _exit(127);
  }
  ~Program() {
    if (process_ <= 0) return;
    ::kill(process_, SIGKILL);
    waitpid(process_, nullptr, 0);
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void interrupt() const { send(SIGINT); }
  void kill() const { send(SIGKILL); }

  [[nodiscard]] bool running() {
    if (process_ <= 0) return false;
    if (waitpid(process_, &wait_status_, WNOHANG) == 0) return true;
    process_ = 0;
    return false;
  }

  [[nodiscard]] ProgramRun finish() {
    if (process_ > 0) waitpid(process_, &wait_status_, 0);
    process_ = 0;
    ProgramRun run;
    run.status = WIFEXITED(wait_status_) ? WEXITSTATUS(wait_status_) : 128 + WTERMSIG(wait_status_);
    run.out = read_text(folder_ / "out");
    run.err = read_text(folder_ / "err");
    return run;
  }

 private:
  void send(int signal) const {
    if (process_ > 0) ::kill(process_, signal);  // 0, once it has ended, would mean our own process group
  }

  TemporaryFolder folder_;
  pid_t process_ = -1;
  int wait_status_ = 0;
};

[[nodiscard]] inline ProgramRun run_program(const std::vector<std::string>& arguments) {
  return Program(arguments).finish();
}

/// Runs a command with --json - and demands that standard output is JSON and nothing else.
inline Json json_of(std::vector<std::string> arguments) {
  arguments.insert(arguments.end(), {"--json", "-"});
  const ProgramRun run = run_program(arguments);
  INFO(run.err);
  REQUIRE(run.status == 0);
  return parse_json(run.out, "standard output");
}

}  // namespace loopwise::testing
