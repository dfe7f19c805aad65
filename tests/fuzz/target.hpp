// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What fuzz targets share. A target is a function of bytes that hands them to a reader and returns; whatever
/// leaves it is a finding. libFuzzer calls one target a program; in the ordinary test program all of them
/// stand in a list.
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

/// What must hold of everything that was read. \throws std::logic_error, which no reader may throw
inline void expect(bool holds, const char* what) {
  if (!holds) throw std::logic_error(std::string("does not hold: ") + what);
}

/// What came of the calls of attempt(): a target that refuses all of its seeds tries nothing.
struct Attempts {
  std::size_t accepted = 0, refused = 0;
};
inline Attempts attempts;

/// What the call returns, or nothing if it throws one of the library's own errors: those are documented, and
/// must say something. Other exceptions pass.
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

/// For checks that take much longer than what they check: the fuzzer makes them of one input in `count`, for
/// it tries more inputs in that time; the ordinary tests make them of all.
[[nodiscard]] inline bool one_in([[maybe_unused]] std::size_t count,
                                 [[maybe_unused]] std::string_view bytes) {
#ifdef LOOPWISE_LIBFUZZER
  return std::hash<std::string_view>()(bytes) % count == 0;
#else
  return true;
#endif
}

/// Takes the first byte off, as a number below `count`; 0 if there is none.
[[nodiscard]] std::size_t take_choice(std::string_view& bytes, std::size_t count);

/// A folder in memory where there is one (/dev/shm), of this process alone; it goes at its end.
[[nodiscard]] const std::filesystem::path& scratch();

/// Replaces a file, without care: nobody else looks at the folder.
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
