// SPDX-License-Identifier: BSD-3-Clause
#include "action.hpp"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <new>

#include <loopwise/core/error.hpp>

namespace loopwise::cli {
namespace {

// Global, because the process's handlers take no arguments.
std::atomic<bool> memory_ran_out{false};
std::atomic<const char*> program_name{"loopwise"};

/// Terminate handler. Destructors of the JSON library, and noexcept functions that walk folders, allocate
/// memory. If that fails, they call this handler, and no catch block is reached.
[[noreturn]] void end_at_once() {
  if (memory_ran_out) {
    std::fprintf(stderr, "%s: out of memory\n", program_name.load());
    std::_Exit(kFailed);
  }
  try {
    if (const std::exception_ptr error = std::current_exception()) std::rethrow_exception(error);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", program_name.load(), error.what());
  } catch (...) {
  }
  std::abort();
}

}  // namespace

int run_action(const Action& action, const std::string& program) {
  const auto complain = [&program](const std::exception& error) {
    std::cerr << program << ": " << error.what() << "\n";
  };
  try {
    return action();
  } catch (const OptionError& error) {
    complain(error);
    return kBadUsage;
  } catch (const InputError& error) {
    complain(error);
    return kBadInput;
  } catch (const IoError& error) {
    complain(error);
    return kBadInput;
  } catch (const StoppedError& error) {
    complain(error);
    return kInterrupted;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", program.c_str());  // allocates no memory
    return kFailed;
  } catch (const std::exception& error) {
    complain(error);
    return kFailed;
  }
}

int run_main(const char* name, int (*program)(int argc, char** argv), int argc, char** argv) noexcept {
  program_name = name;
  std::set_terminate(end_at_once);
  std::set_new_handler([] {
    memory_ran_out = true;
    throw std::bad_alloc();
  });
  // run_action() handles the exceptions of a command; this handles exceptions before it.
  try {
    return program(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "%s: out of memory\n", name);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", name, error.what());
  }
  return kFailed;
}

}  // namespace loopwise::cli
