// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Shared code of fuzz targets. A target is a function that passes bytes to a reader and returns; an
/// exception that leaves it is a finding. libFuzzer runs one target per program; the ordinary test program
/// has a list of all of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/error.hpp>

namespace loopwise::fuzz {

using Function = void (*)(std::string_view bytes);

struct Target {
  std::string name;
  Function run;
};

/// Those of this program, by name.
[[nodiscard]] const std::vector<Target>& targets();

struct Registered {
  Registered(const char* name, Function run);
};

/// Checks an invariant of the data that were read. \throws std::logic_error, which no reader may throw
inline void expect(bool holds, const char* what) {
  if (!holds) throw std::logic_error(std::string("does not hold: ") + what);
}

/// Counts the results of attempt(): a target that refuses all of its seeds tests nothing.
struct Attempts {
  std::size_t accepted = 0, refused = 0;
};
inline Attempts attempts;

/// The return value of the call, or nothing if it throws one of the library's own errors: those are
/// documented, and must have a message. Other exceptions pass through.
template <class Call>
auto attempt(Call&& call) -> std::optional<std::decay_t<decltype(call())>> {
  try {
    std::optional<std::decay_t<decltype(call())>> result = call();
    ++attempts.accepted;
    return result;
  } catch (const Error& error) {
    ++attempts.refused;
    expect(!std::string_view(error.what()).empty(), "an error has a message");
    return std::nullopt;
  }
}

/// For checks that take much longer than the reader. The fuzzer makes them for one input in `count`, so that
/// it tries more inputs in the same time; the ordinary tests make them for all inputs.
[[nodiscard]] inline bool one_in([[maybe_unused]] std::size_t count,
                                 [[maybe_unused]] std::string_view bytes) {
#ifdef LOOPWISE_LIBFUZZER
  return std::hash<std::string_view>()(bytes) % count == 0;
#else
  return true;
#endif
}

/// Takes the first byte off, as a number below `count`; 0 without bytes.
[[nodiscard]] std::size_t take_choice(std::string_view& bytes, std::size_t count);

/// A folder of this process, in memory if possible (/dev/shm); it is deleted at the end of the process.
[[nodiscard]] const std::filesystem::path& scratch();

/// Replaces a file, but not atomically: no other process reads the folder.
void put_file(const std::filesystem::path& path, std::string_view bytes);

template <class Derived>
[[nodiscard]] bool finite(const Eigen::DenseBase<Derived>& matrix) {
  return matrix.derived().allFinite();
}

}  // namespace loopwise::fuzz

#ifdef LOOPWISE_LIBFUZZER
#define LOOPWISE_FUZZ_ENTRY(name)                                                      \
  extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {  \
    loopwise_fuzz_##name(std::string_view(reinterpret_cast<const char*>(data), size)); \
    return 0;                                                                          \
  }
#else
#define LOOPWISE_FUZZ_ENTRY(name) \
  static const ::loopwise::fuzz::Registered loopwise_registered_##name(#name, loopwise_fuzz_##name);
#endif

/// Begins a target: LOOPWISE_FUZZ_TARGET(g2o, bytes) { ... }
#define LOOPWISE_FUZZ_TARGET(name, bytes)                   \
  static void loopwise_fuzz_##name(std::string_view bytes); \
  LOOPWISE_FUZZ_ENTRY(name)                                 \
  static void loopwise_fuzz_##name(std::string_view bytes)
