// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// Base of all exceptions of Loopwise. what() states the found and the expected value, and the place.
struct LOOPWISE_EXPORT Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// An option outside its documented range, or an unknown one. what(): "generation.rate_m = -2, must be >= 0".
struct LOOPWISE_EXPORT OptionError : Error {
  using Error::Error;
};

/// Input that breaks its format or its invariants: a file, or data from the calling program.
struct LOOPWISE_EXPORT InputError : Error {
  using Error::Error;
};

/// A line of a text file that cannot be read. what(): "run.g2o:41: VERTEX_SE3:QUAT needs 8 values, found 7".
struct LOOPWISE_EXPORT ParseError : InputError {
  /// Puts file and line before the reason.
  ParseError(const std::string& file, std::size_t line, const std::string& why)
      : InputError(file + ":" + std::to_string(line) + ": " + why) {}
};

/// A file or folder that cannot be opened, read or written. what() names the path and the system's reason.
struct LOOPWISE_EXPORT IoError : Error {
  /// Puts the path before the reason.
  IoError(const std::string& path, const std::string& why) : Error(path + ": " + why) {}
};

/// Work ended early because of a stop request.
struct LOOPWISE_EXPORT StoppedError : Error {
  using Error::Error;
};

/// A key that the graph, mission or robot list does not have.
struct LOOPWISE_EXPORT UnknownKeyError : InputError {
  using InputError::InputError;
};

}  // namespace loopwise
