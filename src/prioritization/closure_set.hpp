// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>

#include "closure_factor.hpp"

namespace loopwise::detail {

/// Hypothetical closures of candidates at the graph's estimate. \throws UnknownKeyError naming a candidate's
/// missing node; InputError on a candidate from a node to itself or an information factor out of [0, 1].
class ClosureTerms {
 public:
  ClosureTerms(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
               const ClosureModel& model);

  [[nodiscard]] std::size_t size() const { return terms_.size(); }
  [[nodiscard]] const ClosureTerm& operator[](std::size_t candidate) const { return terms_[candidate]; }
  /// Whether the candidate does not contribute to H: it connects components (see
  /// GraphComponents::connecting()), or its acceptance is impossible.
  [[nodiscard]] bool inert(std::size_t candidate) const {
    return connecting_[candidate] || terms_[candidate].scale <= 0.0;
  }
  [[nodiscard]] bool connecting(std::size_t candidate) const { return connecting_[candidate]; }

 private:
  std::vector<ClosureTerm> terms_;
  std::vector<bool> connecting_;
};

/// The information matrix of a model, and the matrix W that whitens residuals: WᵀW = information. \throws
/// InputError unless the covariance is finite, symmetric and positive definite.
struct Whitening {
  explicit Whitening(const Matrix6d& covariance);
  Matrix6d information;
  Matrix6d root;
};

/// Diagonal blocks of JΣJᵀ and JΣPᵀPΣJᵀ of one candidate, whitened so that its own covariance is I.
struct GainBlocks {
  Matrix6d S = Matrix6d::Zero();
  Matrix6d M = Matrix6d::Zero();
  /// Decrease of the trace if the closure is added.
  [[nodiscard]] double gain() const;
};

/// A graph, its candidates, and the factor of H with the current set of candidates.
class ClosureSet {
 public:
  ClosureSet(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
             const ClosureModelOptions& options, const ClosureModel& model);

  const ClosureTerms terms;
  const Whitening whitening;
  CandidateSet set;

  /// The factor with the current set.
  [[nodiscard]] const ClosureFactor& factor();
  /// The factor with other closures than the current set; the next factor() restores that of the current set.
  [[nodiscard]] const ClosureFactor& factor_with(const std::vector<std::size_t>& members);
  void changed() { fresh_ = false; }
  [[nodiscard]] std::size_t factorizations() const { return factorizations_; }

  /// √scale · W
  [[nodiscard]] Matrix6d whitener(std::size_t candidate) const {
    return std::sqrt(terms[candidate].scale) * whitening.root;
  }

 private:
  ClosureFactor factor_;
  bool fresh_ = false;
  std::size_t factorizations_ = 0;
};

/// XᵀPᵀPX of row-major columns with a given width: sums over the counted rows of all free nodes.
template <int Width>
[[nodiscard]] Eigen::Matrix<double, Width, Width, Eigen::RowMajor> counted_gram(const std::vector<double>& x,
                                                                                TraceKind kind);

}  // namespace loopwise::detail
