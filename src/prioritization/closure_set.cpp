// SPDX-License-Identifier: BSD-3-Clause
#include "closure_set.hpp"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <loopwise/core/error.hpp>

namespace loopwise {

void CandidateSet::clear() {
  for (const std::size_t member : members_) place_[member] = kAbsent;
  members_.clear();
}

void CandidateSet::assign(const std::vector<std::size_t>& members) {
  clear();
  for (const std::size_t member : members) {
    if (member >= place_.size() || contains(member)) {
      throw InputError("candidate " + std::to_string(member) + " of " + std::to_string(place_.size()) +
                       (member < place_.size() ? " is in the set twice" : " does not exist"));
    }
    add(member);
  }
}

std::vector<Eigen::Vector3d> candidate_midpoints(const PoseGraph& graph,
                                                 const std::vector<LoopCandidate>& candidates) {
  std::vector<Eigen::Vector3d> out;
  out.reserve(candidates.size());
  for (const LoopCandidate& c : candidates) {
    out.push_back(0.5 * (graph.node(c.from).pose.translation() + graph.node(c.to).pose.translation()));
  }
  return out;
}

ClosureModel closure_model(const ClosureModelOptions& options) {
  validate(options);
  Vector6d variance;
  variance << Eigen::Vector3d::Constant(options.sigma_m * options.sigma_m),
      Eigen::Vector3d::Constant(options.sigma_rad * options.sigma_rad);
  return {variance.asDiagonal(), {}};
}

namespace detail {

ClosureTerms::ClosureTerms(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                           const ClosureModel& model) {
  if (!model.information_factors.empty() && model.information_factors.size() != candidates.size()) {
    throw InputError("information_factors has " + std::to_string(model.information_factors.size()) +
                     " values, expected " + std::to_string(candidates.size()) + " or none");
  }
  const GraphComponents parts(graph);
  terms_.reserve(candidates.size());
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    const LoopCandidate& candidate = candidates[i];
    const std::size_t from = graph.index_of(candidate.from), to = graph.index_of(candidate.to);
    if (from == to) throw InputError("candidate of " + key_name(candidate.from) + " with itself");
    ClosureTerm term;
    term.from = static_cast<std::uint32_t>(from);
    term.to = static_cast<std::uint32_t>(to);
    term.scale = model.information_factors.empty() ? 1.0 : model.information_factors[i];
    if (!(term.scale >= 0.0 && term.scale <= 1.0)) {
      throw InputError("information factor of candidate " + std::to_string(i) + " is not in [0, 1]");
    }
    term.adjoint = se3::adjoint(graph.nodes()[to].pose.inverse() * graph.nodes()[from].pose);
    terms_.push_back(term);
    connecting_.push_back(parts.connecting(from, to));
  }
}

Whitening::Whitening(const Matrix6d& covariance) {
  if (!covariance.allFinite()) throw InputError("the covariance of a closure is not finite");
  const Eigen::LLT<Matrix6d> cholesky(covariance);
  if (cholesky.info() != Eigen::Success || check_information(covariance) != nullptr) {
    throw InputError("the covariance of a closure is not symmetric and positive definite");
  }
  root = cholesky.matrixL().solve(Matrix6d::Identity());
  information = root.transpose() * root;
  if (!information.allFinite()) throw InputError("the covariance of a closure is singular");
}

double GainBlocks::gain() const {
  const Eigen::LLT<Matrix6d> cholesky(Matrix6d::Identity() + S);
  return cholesky.solve(M).trace();
}

ClosureSet::ClosureSet(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                       const ClosureModelOptions& options, const ClosureModel& model)
    : terms(graph, candidates, model), whitening(model.covariance), set(candidates.size()), factor_(graph) {
  validate(options);
}

const ClosureFactor& ClosureSet::factor_with(const std::vector<std::size_t>& members) {
  std::vector<const ClosureTerm*> closures;
  closures.reserve(members.size());
  for (const std::size_t member : members) {
    if (!terms.inert(member)) closures.push_back(&terms[member]);
  }
  fresh_ = false;
  factor_.factorize(closures, whitening.information);
  ++factorizations_;
  return factor_;
}

const ClosureFactor& ClosureSet::factor() {
  if (!fresh_) {
    (void)factor_with(set.members());
    fresh_ = true;
  }
  return factor_;
}

template <int Width>
Eigen::Matrix<double, Width, Width, Eigen::RowMajor> counted_gram(const std::vector<double>& x,
                                                                  TraceKind kind) {
  Eigen::Matrix<double, Width, Width, Eigen::RowMajor> out;
  dense_kernels(Rounding::kPortable)
      .gram(x.data(), x.size() / (6 * Width), kind == TraceKind::kFull ? 6 : 3, Width, out.data());
  return out;
}

template Eigen::Matrix<double, 6, 6, Eigen::RowMajor> counted_gram<6>(const std::vector<double>&, TraceKind);
template Eigen::Matrix<double, 12, 12, Eigen::RowMajor> counted_gram<12>(const std::vector<double>&,
                                                                         TraceKind);

}  // namespace detail
}  // namespace loopwise
