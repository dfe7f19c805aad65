// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What shared libraries of Loopwise show. They are compiled with hidden symbols; what public headers declare
/// and sources define carries LOOPWISE_EXPORT. Inline code and plain structs need no mark.
#pragma once

/// Stands before a function or a class that other libraries and programs link. Empty unless Loopwise is
/// shared (BUILD_SHARED_LIBS), which the CMake targets and pkg-config say by LOOPWISE_SHARED: a library that
/// takes in a static Loopwise does not show its symbols.
#if defined(LOOPWISE_SHARED) && (defined(__GNUC__) || defined(__clang__))
#define LOOPWISE_EXPORT __attribute__((visibility("default")))
#else
#define LOOPWISE_EXPORT
#endif
