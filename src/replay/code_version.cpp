// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/code_version.hpp>

#include <Eigen/Core>

#include "loopwise_code_version.hpp"  // made by cmake/code_version.cmake

namespace loopwise {
namespace {

#define LOOPWISE_TEXT(x) #x
#define LOOPWISE_TEXT_OF(x) LOOPWISE_TEXT(x)

/// Properties of the build that may change floating-point results.
std::string build() {
  std::string text = " " __VERSION__ " Eigen " LOOPWISE_TEXT_OF(EIGEN_WORLD_VERSION) "." LOOPWISE_TEXT_OF(
      EIGEN_MAJOR_VERSION) "." LOOPWISE_TEXT_OF(EIGEN_MINOR_VERSION);
#ifdef __OPTIMIZE__
  text += " optimized";
#endif
#ifdef __FMA__
  text += " fma";
#endif
#ifdef __AVX__
  text += " avx";
#endif
  return text;
}

}  // namespace

std::string registration_code_version() {
  return LOOPWISE_REGISTRATION_CODE + build();
}

std::string replay_code_version() {
  return LOOPWISE_REPLAY_CODE + build();
}

}  // namespace loopwise
