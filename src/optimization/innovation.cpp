// SPDX-License-Identifier: BSD-3-Clause
#include "innovation.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <tuple>
#include <utility>

#include <Eigen/Dense>

#include <loopwise/core/planar.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>

namespace loopwise::detail {
namespace {

double steps_between(std::uint32_t a, std::uint32_t b) {
  return std::abs(static_cast<double>(a) - b);
}

/// Mean variance over the free directions of the graph's poses.
double mean_variance(const PoseGraph& graph, const Matrix6d& m) {
  return (graph.planar() ? planar::trace(m) : m.trace()) / graph.degrees_of_freedom();
}

}  // namespace

Matrix6d on_the_right(const Matrix6d& between, const Eigen::Isometry3d& T) {
  const Matrix6d ad = se3::adjoint(T.inverse());
  return ad * between * ad.transpose();
}

double squared_innovation(const Matrix6d& information, const Matrix6d& prediction, const Vector6d& r) {
  // S⁻¹ = (I + ΩP)⁻¹Ω holds for a semi-definite Ω too.
  const Matrix6d m = Matrix6d::Identity() + information * prediction;
  return r.dot(m.partialPivLu().solve(information * r));
}

std::vector<double> innovations(const PoseGraph& graph, const OdometryForest& forest) {
  std::vector<double> out(graph.edges().size(), kNotKnown);
  for (std::size_t e = 0; e < out.size(); ++e) {
    const Edge& edge = graph.edges()[e];
    if (known_inlier(edge)) continue;
    const auto [from, to] = graph.ends(e);
    out[e] = innovation(graph, forest, e, edge_residual(edge, forest.pose(from), forest.pose(to)));
  }
  return out;
}

double innovation(const PoseGraph& graph, const OdometryForest& forest, std::size_t edge,
                  const Vector6d& residual) {
  const auto [from, to] = graph.ends(edge);
  const auto path = forest.between(from, to);
  if (!path) return kNotKnown;
  return squared_innovation(graph.edges()[edge].information, on_the_right(*path, forest.pose(to)), residual);
}

void NeighbourInnovations::set_kept(const std::vector<std::size_t>& edges) {
  kept_.clear();
  for (const std::size_t e : edges) {
    const auto covariance = covariance_of(graph_.edges()[e].information);
    if (!covariance) continue;
    const double variance = mean_variance(graph_, *covariance);
    const auto [from, to] = graph_.ends(e);
    const auto edge = static_cast<std::uint32_t>(e);
    const std::uint32_t roots[2] = {forest_.root(from), forest_.root(to)};
    const std::uint32_t places[2] = {forest_.place(from), forest_.place(to)};
    kept_.push_back({roots[0], roots[1], places[0], places[1], edge, false, variance});
    kept_.push_back({roots[1], roots[0], places[1], places[0], edge, true, variance});
  }
  std::sort(kept_.begin(), kept_.end(), [](const Kept& a, const Kept& b) {
    return std::tie(a.root, a.other_root, a.place, a.other_place, a.edge, a.reversed) <
           std::tie(b.root, b.other_root, b.place, b.other_place, b.edge, b.reversed);
  });
}

/// The kept closure with the fewest steps of odometry at both ends. It must have a lower variance
/// than the limit, and fewer steps than the direct path between the ends. The search is bounded,
/// because distant closures give little information.
const NeighbourInnovations::Kept* NeighbourInnovations::nearest(std::size_t from, std::size_t to,
                                                                double variance_limit) const {
  constexpr int kMostVisited = 10000;  // to either side
  const std::uint32_t root = forest_.root(from), other_root = forest_.root(to);
  const std::uint32_t place = forest_.place(from), other_place = forest_.place(to);
  const auto here = std::lower_bound(
      kept_.begin(), kept_.end(), std::tie(root, other_root, place),
      [](const Kept& k, const auto& at) { return std::tie(k.root, k.other_root, k.place) < at; });
  const Kept* best = nullptr;
  double fewest =
      root == other_root ? steps_between(place, other_place) : std::numeric_limits<double>::infinity();
  int seen = 0;
  // \returns whether the next one may be nearer.
  const auto consider = [&](const Kept& k) {
    if (k.root != root || k.other_root != other_root || ++seen > kMostVisited) return false;
    const double at_this_end = steps_between(k.place, place);
    const double all = at_this_end + steps_between(k.other_place, other_place);
    if (all < fewest && k.variance < variance_limit) {
      fewest = all;
      best = &k;
    }
    return at_this_end < fewest;
  };
  for (auto k = here; k != kept_.end() && consider(*k);) ++k;
  seen = 0;
  for (auto k = here; k != kept_.begin() && consider(*std::prev(k));) --k;
  return best;
}

/// T_from_to = A B C: along odometry, across the kept closure, along odometry. Every error is transformed to
/// the right of the product. \pre the closures join the same trees, as nearest() ensures
Matrix6d NeighbourInnovations::covariance_across(const Kept& kept, std::size_t from, std::size_t to) const {
  const Edge& edge = graph_.edges()[kept.edge];
  auto [near_from, near_to] = graph_.ends(kept.edge);
  Matrix6d across = *covariance_of(edge.information);
  Eigen::Isometry3d B = edge.T_from_to;
  if (kept.reversed) {
    std::swap(near_from, near_to);
    across = on_the_right(across, B.inverse());
    B = edge.T_from_to.inverse();
  }
  const auto there = forest_.between(from, near_from), on = forest_.between(near_to, to);
  const Eigen::Isometry3d C = forest_.pose(near_to).inverse() * forest_.pose(to);
  return on_the_right(*there, forest_.pose(near_from) * B * C) + on_the_right(across, C) +
         on_the_right(*on, forest_.pose(to));
}

NeighbourInnovations::Innovation NeighbourInnovations::operator()(std::size_t e,
                                                                  const Vector6d& residual) const {
  const auto [from, to] = graph_.ends(e);
  const auto chain = forest_.between(from, to);
  if (!chain) return {};
  const Matrix6d direct = on_the_right(*chain, forest_.pose(to));
  const Kept* kept = nearest(from, to, mean_variance(graph_, direct));
  if (kept == nullptr) return {};
  const Matrix6d across = covariance_across(*kept, from, to);
  const Matrix6d& information = graph_.edges()[e].information;
  const double variance = mean_variance(graph_, information * across);
  if (!(variance < mean_variance(graph_, information * direct))) return {};
  const double d2 = squared_innovation(information, across, residual);
  // Far from the origin, rounding may make a difference of covariances invalid.
  return d2 >= 0.0 && variance >= 0.0 ? Innovation{d2, variance} : Innovation{};
}

}  // namespace loopwise::detail
