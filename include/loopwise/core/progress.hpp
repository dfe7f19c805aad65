// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <string>

namespace loopwise {

/// Progress of long work. The library never prints: it calls back, and the caller decides what to show.
struct Progress {
  std::string stage;      ///< "registering", "reading", ...
  std::size_t done = 0;   ///< Units finished.
  std::size_t total = 0;  ///< Units expected; 0 if not known. May grow.
  std::string detail;     ///< Short figures of the stage, for example "12 accepted, 40 rejected".
};

/// May be empty. Called from one thread at a time.
using ProgressCallback = std::function<void(const Progress&)>;

}  // namespace loopwise
