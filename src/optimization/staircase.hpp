// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <loopwise/core/stop_token.hpp>
#include <loopwise/optimization/certificate.hpp>

#include "chordal_problem.hpp"

namespace loopwise::detail {

/// The result for one component.
struct DualOutcome {
  CertificateStatus status = CertificateStatus::kUndecided;
  CriticalPoint critical;  ///< Reached from the start.
  LiftedPoses best;        ///< Of the lowest cost found, 3 rows.
  double best_cost = 0.0;
  double lower_bound = 0.0;
  bool negligible = false;        ///< The critical cost is zero up to rounding.
  bool lost_in_rounding = false;  ///< The rounding error of the bound is larger than the requested gap.
  double min_eigenvalue = 0.0;
  double eigenvalue_tolerance = 0.0;
  bool relaxation_solved = false;  ///< lower_bound is the optimum of the relaxation, up to the relative gap.
  int rank = 3;
  int steps = 0;
};

/// Descends from poses and tests the dual certificate there. If the test fails, climbs the Riemannian
/// staircase (Boumal, NIPS 2016): it solves relaxations of growing rank, each entered along the eigenvector
/// of the negative eigenvalue, until one is certified, and projects each solution back to poses.
[[nodiscard]] DualOutcome certify_component(const ChordalProblem& problem, const LiftedPoses& start,
                                            const CertificateOptions& options, const StopToken& stop);

}  // namespace loopwise::detail
