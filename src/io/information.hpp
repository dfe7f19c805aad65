// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Information matrices as files hold them: rounded, or not semi-definite at all. Private to io.
#pragma once

#include <loopwise/core/se3.hpp>

namespace loopwise {

/// How far a symmetric matrix is from being an information matrix.
enum class InformationFlaw {
  kSound,       ///< It is semi-definite.
  kRounded,     ///< Indefinite by no more than six printed digits explain.
  kIndefinite,  ///< Indefinite beyond that, or of a negative diagonal.
};

/// A matrix that check_information() accepts, and what it took to get there.
struct SoundInformation {
  Matrix6d matrix;
  InformationFlaw flaw = InformationFlaw::kSound;
};

/// The symmetric, finite matrix with its negative eigenvalues raised to 0, which is the nearest semi-definite
/// one; of a rounded matrix those of its form with a unit diagonal, in which metres and radians count alike.
[[nodiscard]] SoundInformation nearest_information(const Matrix6d& information);

/// Ad(T)ᵀ Ω Ad(T), without the indefiniteness that rounding leaves in information of low rank.
[[nodiscard]] Matrix6d moved_information(const Matrix6d& information, const Eigen::Isometry3d& T);

}  // namespace loopwise
