// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Exported symbols of shared libraries. Symbols are hidden by default; LOOPWISE_EXPORT marks those that
/// public headers declare and sources define. Inline code and plain structs need no mark.
#pragma once

/// Marks a function or a class that other libraries and programs link. Empty unless Loopwise is shared
/// (BUILD_SHARED_LIBS); the CMake targets and pkg-config then define LOOPWISE_SHARED. A library that links a
/// static Loopwise does not export its symbols.
#if defined(LOOPWISE_SHARED) && (defined(__GNUC__) || defined(__clang__))
#define LOOPWISE_EXPORT __attribute__((visibility("default")))
#else
#define LOOPWISE_EXPORT
#endif
