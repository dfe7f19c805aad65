// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/certificate.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <optional>
#include <utility>

#include <Eigen/Dense>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/core/se3.hpp>

#include "chordal_problem.hpp"
#include "dual_matrix.hpp"
#include "linalg/blas_threads.hpp"
#include "staircase.hpp"

namespace loopwise {

EnumNames<CertificateStatus> enum_names(CertificateStatus) {
  return {{CertificateStatus::kCertified, "certified"},
          {CertificateStatus::kImprovable, "improvable"},
          {CertificateStatus::kUndecided, "undecided"},
          {CertificateStatus::kUnsupported, "unsupported"}};
}

namespace {

using detail::ChordalProblem;
using detail::ChordalTerm;
using detail::LiftedPoses;

/// A connected component of a graph. Pose 0 of its problem is fixed: it is the frame of the priors if there
/// are several, otherwise the node of the only prior, or the first node.
struct Component {
  std::vector<std::size_t> nodes;  // of poses 0, 1, …, or of 1, 2, … if pose 0 is the frame of the priors
  std::vector<std::size_t> priors;         // if there are several
  std::vector<std::size_t> edges;          // of non-zero weight
  std::optional<Eigen::Isometry3d> frame;  // of the priors
  std::size_t first_pose() const { return frame ? 1 : 0; }
};

std::vector<Component> components_of(const PoseGraph& graph) {
  DisjointSets sets(graph.nodes().size());
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    if (graph.edges()[e].weight > 0.0) sets.join(graph.ends(e).from, graph.ends(e).to);
  }
  std::vector<Component> by_root(graph.nodes().size());
  for (std::size_t i = 0; i < graph.nodes().size(); ++i) by_root[sets.root(i)].nodes.push_back(i);
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    if (graph.edges()[e].weight > 0.0) by_root[sets.root(graph.ends(e).from)].edges.push_back(e);
  }
  for (std::size_t k = 0; k < graph.priors().size(); ++k)
    by_root[sets.root(graph.index_of(graph.priors()[k].key))].priors.push_back(k);
  std::vector<Component> out;
  for (Component& c : by_root) {
    if (c.priors.size() > 1) {
      c.frame = graph.priors()[c.priors.front()].pose;
    } else if (c.priors.size() == 1) {
      // Moving the whole component satisfies a single prior without cost: it only selects the fixed node.
      const std::size_t node = graph.index_of(graph.priors()[c.priors.front()].key);
      std::swap(*std::find(c.nodes.begin(), c.nodes.end(), node), c.nodes.front());
      c.priors.clear();
    }
    if (!c.edges.empty() || c.frame) out.push_back(std::move(c));
  }
  return out;
}

/// n / tr(Ω⁻¹) for n coordinates: the isotropic information with the same mean variance. 0 if some direction
/// has no information; `lost` is then set if another direction has some.
template <int n>
double isotropic(const Eigen::Matrix<double, n, n>& information, bool& lost) {
  constexpr double kSingular = 1e-12;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, n, n>> eigen(information, Eigen::EigenvaluesOnly);
  const auto& values = eigen.eigenvalues();
  if (values[0] > kSingular * values[n - 1]) return n / values.cwiseInverse().sum();
  lost = lost || values[n - 1] > 0.0;
  return 0.0;
}

/// Terms of a graph's factors. A planar graph counts the information within the plane.
class Terms {
 public:
  explicit Terms(bool planar) : planar_(planar) {}

  void add(std::size_t from, std::size_t to, const Eigen::Isometry3d& measured, const Matrix6d& information,
           double weight) {
    bool lost = false;
    ChordalTerm term;
    term.from = static_cast<std::uint32_t>(from);
    term.to = static_cast<std::uint32_t>(to);
    term.measured = se3::normalized(measured).matrix();
    if (planar_) {
      term.tau = weight * isotropic<2>(information.topLeftCorner<2, 2>(), lost);
      term.kappa = 0.5 * weight * information(5, 5);
    } else {
      term.tau = weight * isotropic<3>(information.topLeftCorner<3, 3>(), lost);
      term.kappa = 0.5 * weight * isotropic<3>(information.bottomRightCorner<3, 3>(), lost);
    }
    if (lost) ++reduced_;
    terms_.push_back(term);
  }
  [[nodiscard]] std::size_t reduced() const { return reduced_; }
  [[nodiscard]] std::vector<ChordalTerm> take() { return std::move(terms_); }

 private:
  bool planar_;
  std::vector<ChordalTerm> terms_;
  std::size_t reduced_ = 0;
};

ChordalProblem problem_of(const PoseGraph& graph, const Component& c, std::size_t& reduced) {
  std::vector<std::size_t> pose(graph.nodes().size());
  for (std::size_t i = 0; i < c.nodes.size(); ++i) pose[c.nodes[i]] = i + c.first_pose();
  Terms terms(graph.planar());
  for (const std::size_t e : c.edges) {
    const Edge& edge = graph.edges()[e];
    terms.add(pose[graph.ends(e).from], pose[graph.ends(e).to], edge.T_from_to, edge.information,
              edge.weight);
  }
  for (const std::size_t k : c.priors) {
    const PriorFactor& prior = graph.priors()[k];
    terms.add(0, pose[graph.index_of(prior.key)], c.frame->inverse() * prior.pose, prior.information, 1.0);
  }
  reduced = terms.reduced();
  return ChordalProblem(c.nodes.size() + c.first_pose(), terms.take());
}

/// Frame in which a component's poses are computed. It is near them, so that poses far from the origin keep
/// their digits.
Eigen::Isometry3d frame_of(const PoseGraph& graph, const Component& c) {
  return c.frame ? *c.frame : se3::normalized(graph.nodes()[c.nodes.front()].pose);
}

LiftedPoses lifted_poses(const PoseGraph& graph, const Component& c) {
  const Eigen::Isometry3d back = frame_of(graph, c).inverse();
  LiftedPoses X(3, 4 * static_cast<Eigen::Index>(c.nodes.size() + c.first_pose()));
  X.leftCols<4>() = Eigen::Matrix<double, 3, 4>::Identity();
  for (std::size_t i = 0; i < c.nodes.size(); ++i) {
    const Eigen::Isometry3d local = back * se3::normalized(graph.nodes()[c.nodes[i]].pose);
    X.middleCols<4>(4 * static_cast<Eigen::Index>(i + c.first_pose())) = local.matrix().topRows<3>();
  }
  return X;
}

/// The same poses with pose 0 at the identity. Poses of a planar graph are projected to the plane: rounding,
/// or the search for lower poses, may have moved them out of it.
LiftedPoses local_poses(const LiftedPoses& X, bool planar) {
  const auto pose = [&](Eigen::Index at) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.matrix().topRows<3>() = X.middleCols<4>(at);
    return T;
  };
  LiftedPoses out(3, X.cols());
  const Eigen::Isometry3d back = pose(0).inverse();
  for (Eigen::Index at = 0; at < X.cols(); at += 4) {
    const Eigen::Isometry3d T = back * pose(at);
    out.middleCols<4>(at) = (planar ? planar::flattened(T) : T).matrix().topRows<3>();
  }
  return out;
}

/// Writes a component's poses, with pose 0 at the frame.
void place(const PoseGraph& graph, const Component& c, const LiftedPoses& X,
           std::vector<Eigen::Isometry3d>& poses) {
  const Eigen::Isometry3d frame = frame_of(graph, c);
  for (std::size_t i = 0; i < c.nodes.size(); ++i) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.matrix().topRows<3>() = X.middleCols<4>(4 * static_cast<Eigen::Index>(i + c.first_pose()));
    const Eigen::Isometry3d placed = se3::normalized(frame * T);
    poses[c.nodes[i]] = graph.planar() ? planar::flattened(placed) : placed;
  }
}

/// Projects the poses of a planar graph to the plane and updates the outcome, because the projected poses may
/// have another cost.
void bring_to_plane(const ChordalProblem& problem, const CertificateOptions& options,
                    detail::DualOutcome& outcome) {
  outcome.critical.X = local_poses(outcome.critical.X, true);
  outcome.critical.cost = problem.cost(outcome.critical.X);
  outcome.best = local_poses(outcome.best, true);
  outcome.best_cost = problem.cost(outcome.best);
  if (outcome.status == CertificateStatus::kImprovable &&
      outcome.best_cost >= (1.0 - options.relative_gap) * outcome.critical.cost) {
    outcome.status = CertificateStatus::kUndecided;  // they had a lower cost only outside the plane
    outcome.relaxation_solved = false;
  }
  if (outcome.status != CertificateStatus::kImprovable) {
    outcome.best = outcome.critical.X;
    outcome.best_cost = outcome.critical.cost;
  }
  outcome.lower_bound = std::min(outcome.lower_bound, outcome.best_cost);
}

/// Accumulates the certificate over components.
class Summary {
 public:
  explicit Summary(const PoseGraph& graph) : graph_(graph) {
    out_.poses = out_.best_poses = graph.poses();
    out_.status = CertificateStatus::kCertified;
    out_.relaxation_solved = true;
  }

  void certify(const Component& c, const CertificateOptions& options, const StopToken& stop) {
    std::size_t reduced = 0;
    const ChordalProblem problem = problem_of(graph_, c, reduced);
    const LiftedPoses start = lifted_poses(graph_, c);
    detail::DualOutcome outcome = detail::certify_component(problem, start, options, stop);
    if (graph_.planar()) bring_to_plane(problem, options, outcome);
    // The parts that are left out of F may decide which poses are optimal.
    if (reduced > 0 && outcome.status == CertificateStatus::kCertified)
      outcome.status = CertificateStatus::kUndecided;
    out_.reduced_factors += reduced;
    out_.cost_at_estimate += problem.cost(start);
    out_.cost += outcome.critical.cost;
    out_.best_cost += outcome.best_cost;
    out_.lower_bound += outcome.lower_bound;
    negligible_ = negligible_ && outcome.negligible;
    lost_in_rounding_ = lost_in_rounding_ || outcome.lost_in_rounding;
    converged_ = converged_ && outcome.critical.converged;
    out_.min_eigenvalue = std::min(out_.min_eigenvalue, outcome.min_eigenvalue);
    out_.eigenvalue_tolerance = std::max(out_.eigenvalue_tolerance, outcome.eigenvalue_tolerance);
    out_.rank = std::max(out_.rank, outcome.rank);
    out_.steps += outcome.steps;
    out_.status = std::max(out_.status, outcome.status,
                           [](CertificateStatus a, CertificateStatus b) { return rank(a) < rank(b); });
    out_.relaxation_solved = out_.relaxation_solved && outcome.relaxation_solved;
    ++out_.components;
    if (outcome.status == CertificateStatus::kCertified) ++out_.certified_components;
    place(graph_, c, local_poses(outcome.critical.X, graph_.planar()), out_.poses);
    place(graph_, c, local_poses(outcome.best, graph_.planar()), out_.best_poses);
    for (const std::size_t node : c.nodes) measure(node);
  }

  Certificate finish() {
    const double n = static_cast<double>(std::max<std::size_t>(nodes_, 1));
    out_.rotation_rms_rad = std::sqrt(out_.rotation_rms_rad / n);
    out_.translation_rms_m = std::sqrt(out_.translation_rms_m / n);
    out_.relative_gap = negligible_ ? 0.0 : (out_.cost - out_.lower_bound) / out_.cost;
    out_.message = message();
    return std::move(out_);
  }

 private:
  /// Order of severity. kImprovable comes last: a lower cost is certain, kUndecided is only a doubt.
  static int rank(CertificateStatus status) {
    return status == CertificateStatus::kCertified ? 0 : status == CertificateStatus::kUndecided ? 1 : 2;
  }

  void measure(std::size_t node) {
    const Eigen::Isometry3d change = graph_.nodes()[node].pose.inverse() * out_.poses[node];
    const double angle = se3::rotation_angle(se3::normalized(change)), distance = change.translation().norm();
    out_.rotation_max_rad = std::max(out_.rotation_max_rad, angle);
    out_.translation_max_m = std::max(out_.translation_max_m, distance);
    out_.rotation_rms_rad += angle * angle;
    out_.translation_rms_m += distance * distance;
    ++nodes_;
  }

  [[nodiscard]] std::string message() const {
    char text[200];
    const std::string reduced =
        out_.reduced_factors == 0
            ? ""
            : "; the translation or rotation of " + std::to_string(out_.reduced_factors) +
                  " factors, without information in some direction, is left out of it";
    if (out_.components == 0) return "no edge, and no priors that could contradict each other";
    switch (out_.status) {
      case CertificateStatus::kCertified:
        std::snprintf(text, sizeof text, "no poses have a lower isotropic chordal cost, up to %.1e of it",
                      out_.relative_gap);
        break;
      case CertificateStatus::kImprovable:
        std::snprintf(text, sizeof text, "a lower minimum was found: isotropic chordal cost %.9g -> %.9g",
                      out_.cost, out_.best_cost);
        break;
      default:
        std::snprintf(text, sizeof text, "the lowest isotropic chordal cost is between %.9g and %.9g",
                      out_.lower_bound, out_.best_cost);
        return std::string(text) + reason() + reduced;
    }
    return text + reduced;
  }

  /// The reason why the status is undecided.
  [[nodiscard]] const char* reason() const {
    if (!converged_) return "; the descent did not converge";
    if (lost_in_rounding_)
      return "; rounding errors prevent a tighter bound: the information of the factors differs too much, or "
             "positions are "
             "too far apart";
    return out_.relaxation_solved && out_.reduced_factors == 0 ? "; the relaxation is not tight" : "";
  }

  const PoseGraph& graph_;
  Certificate out_;
  std::size_t nodes_ = 0;
  bool negligible_ = true;  // true if all components are
  bool lost_in_rounding_ = false;
  bool converged_ = true;
};

/// ½ Σ w rᵀΩr of residuals caused by rounding: 1e-12 of the lengths whose difference they are.
double rounding_cost(const PoseGraph& graph) {
  constexpr double kSquared = 1e-24;
  double sum = 0.0;
  const auto add = [&](const Matrix6d& information, double weight, double squared_length) {
    sum += weight * (information.topLeftCorner<3, 3>().trace() * squared_length +
                     information.bottomRightCorner<3, 3>().trace());
  };
  const auto squared_length = [&](std::size_t node) {
    return graph.nodes()[node].pose.translation().squaredNorm();
  };
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    const auto ends = graph.ends(e);
    add(edge.information, edge.weight,
        squared_length(ends.from) + squared_length(ends.to) + edge.T_from_to.translation().squaredNorm());
  }
  for (const PriorFactor& prior : graph.priors()) {
    add(prior.information, 1.0,
        squared_length(graph.index_of(prior.key)) + prior.pose.translation().squaredNorm());
  }
  return 0.5 * kSquared * sum;
}

}  // namespace

Certificate certify(const PoseGraph& graph, const CertificateOptions& options, const StopToken& stop) {
  validate(options);
  const Stopwatch watch;
  const detail::SingleThreadedBlas guard;
  if (!graph.ranges().empty() || !graph.gravities().empty()) {
    Certificate out;
    out.status = CertificateStatus::kUnsupported;
    out.poses = out.best_poses = graph.poses();
    out.relative_gap = std::numeric_limits<double>::infinity();
    out.message = std::string("the graph has ") + (graph.ranges().empty() ? "gravity" : "ranges") +
                  ", which the relaxation does not cover";
    out.seconds = watch.seconds();
    return out;
  }
  Summary summary(graph);
  for (const Component& c : components_of(graph)) summary.certify(c, options, stop);
  Certificate out = summary.finish();
  out.seconds = watch.seconds();
  return out;
}

OptimizationResult continued(const OptimizationResult& first, OptimizationResult continuation) {
  continuation.cost_initial = first.cost_initial;
  continuation.gradient_initial = first.gradient_initial;
  continuation.initialization = first.initialization;
  continuation.iterations += first.iterations;
  continuation.factorizations += first.factorizations;
  continuation.trace.insert(continuation.trace.begin(), first.trace.begin(), first.trace.end());
  return continuation;
}

CertifiedEstimate optimize_certified(const PoseGraph& graph, const OptimizerOptions& optimizer,
                                     const CertificateOptions& options, const StopToken& stop) {
  // Two costs of one minimum differ by the optimiser's tolerances.
  constexpr double kLower = 1e-8, kSame = 1e-6;
  constexpr int kMostImprovements = 3;
  const double zero = rounding_cost(graph);
  OptimizerOptions from_there = optimizer;
  from_there.initialization = Initialization::kFile;
  CertifiedEstimate out;
  PoseGraph current = graph;
  out.cost = out.cost_before = graph_cost(graph);
  out.certificate = certify(current, options, stop);
  for (int round = 0; round < kMostImprovements; ++round) {
    if (out.certificate.status == CertificateStatus::kUnsupported || stop.stop_requested()) break;
    PoseGraph other = current;
    other.set_poses(out.certificate.best_poses);
    OptimizationResult result = optimize(other, from_there, stop);
    out.same_minimum = result.cost <= (1.0 + kSame) * out.cost + zero;
    if (result.cost >= (1.0 - kLower) * out.cost - zero) break;
    out.cost = result.cost;
    out.improved = true;
    out.lower_minimum = out.lower_minimum || out.certificate.status == CertificateStatus::kImprovable;
    current.set_poses(result.poses);
    out.optimization = std::move(result);
    out.certificate = certify(current, options, stop);
    out.same_minimum = false;  // it was tested for the former poses
  }
  out.poses = current.poses();
  return out;
}

}  // namespace loopwise
