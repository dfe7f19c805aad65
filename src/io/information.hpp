// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Repairs information matrices of files, which are rounded or not semi-definite. Private to io.
#pragma once

#include <loopwise/core/se3.hpp>

namespace loopwise {

/// How far a symmetric matrix is from an information matrix.
enum class InformationFlaw {
  kSound,       ///< It is semi-definite.
  kRounded,     ///< Indefinite by no more than the rounding to six digits.
  kIndefinite,  ///< Indefinite beyond that, or with a negative diagonal.
};

/// A matrix that check_information() accepts, and the flaw that was repaired.
struct SoundInformation {
  Matrix6d matrix;
  InformationFlaw flaw = InformationFlaw::kSound;
};

/// The nearest semi-definite matrix of a symmetric, finite one: negative eigenvalues are raised to 0. For a
/// rounded matrix these are the eigenvalues after scaling to a unit diagonal, so that metres and radians
/// count alike.
[[nodiscard]] SoundInformation nearest_information(const Matrix6d& information);

/// Ad(T)ᵀ Ω Ad(T). Repairs the indefiniteness that rounding causes in information of low rank.
[[nodiscard]] Matrix6d moved_information(const Matrix6d& information, const Eigen::Isometry3d& T);

}  // namespace loopwise
