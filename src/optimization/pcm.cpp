// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/optimization/pcm.hpp>

#include <algorithm>
#include <cstdint>
#include <map>
#include <numeric>

#include <Eigen/Dense>

#include <loopwise/core/bit_matrix.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "odometry_forest.hpp"

namespace loopwise {
namespace {

/// A closure with its ends in a fixed order, so that two closures of a group compare end by end.
struct Candidate {
  std::size_t edge;
  std::size_t from, to;
  Eigen::Isometry3d Z;  // T_from_to
  Matrix6d covariance;  // of Z, with the error on its right
  Matrix6d reversed;    // of Z⁻¹, with the error on its right
};

Matrix6d carried(const Eigen::Isometry3d& T, const Matrix6d& covariance) {
  const Matrix6d ad = se3::adjoint(T);
  return ad * covariance * ad.transpose();
}

/// d² of the loop Z_a (T_ja⁻¹ T_jb) Z_b⁻¹ (T_ib⁻¹ T_ia), which is the identity without noise.
double loop_error(const detail::OdometryForest& forest, const Candidate& a, const Candidate& b) {
  const auto there = forest.between(a.to, b.to), back = forest.between(b.from, a.from);
  const Eigen::Isometry3d last = forest.pose(b.from).inverse() * forest.pose(a.from);
  const Eigen::Isometry3d from_b = b.Z.inverse() * last;
  const Eigen::Isometry3d from_path = forest.pose(a.to).inverse() * forest.pose(b.to) * from_b;
  const Vector6d r = se3::log(a.Z * from_path);
  // The error of every factor is transformed to the right end of the loop.
  const Matrix6d S = carried(from_path.inverse(), a.covariance) +
                     carried(from_b.inverse() * forest.pose(b.to).inverse(), *there) +
                     carried(last.inverse(), b.reversed) + carried(forest.pose(a.from).inverse(), *back);
  return r.dot(S.ldlt().solve(r));
}

/// A large clique: it is grown from every vertex in turn, always by the remaining vertex of highest degree
/// (Pattabiraman et al., WAW 2013). Vertices are in descending order of degree, so this vertex is the lowest
/// remaining bit.
std::vector<std::size_t> large_clique(const BitMatrix& agrees, const std::vector<std::size_t>& degree) {
  std::vector<std::size_t> best, clique;
  std::vector<std::uint64_t> left(agrees.words());
  for (std::size_t start = 0; start < degree.size(); ++start) {
    if (degree[start] + 1 <= best.size()) break;
    clique.assign(1, start);
    std::copy_n(agrees.row(start), agrees.words(), left.begin());
    for (std::size_t word = 0; word < left.size();) {
      if (left[word] == 0) {
        ++word;
        continue;
      }
      std::size_t bit = 0;
      while ((left[word] >> bit & 1U) == 0) ++bit;
      const std::size_t vertex = 64 * word + bit;
      clique.push_back(vertex);
      const std::uint64_t* row = agrees.row(vertex);
      for (std::size_t k = word; k < left.size(); ++k) left[k] &= row[k];
    }
    if (clique.size() > best.size()) best = clique;
  }
  return best;
}

}  // namespace

PcmResult pairwise_consistent(const PoseGraph& graph, const PcmOptions& options) {
  validate(options);
  PcmResult result;
  result.kept.assign(graph.edges().size(), true);
  const detail::OdometryForest forest(graph);
  const double threshold = chi_squared_quantile(options.inlier_probability, graph.degrees_of_freedom());

  std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<Candidate>> groups;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    if (known_inlier(edge)) continue;
    const auto covariance = detail::covariance_of(edge.information);
    if (!covariance) {
      throw InputError("edge " + key_name(edge.from) + " to " + key_name(edge.to) +
                       ": information is singular, so its consistency with others cannot be measured");
    }
    const auto [from, to] = graph.ends(e);
    Candidate c{e, from, to, edge.T_from_to, *covariance, carried(edge.T_from_to, *covariance)};
    const auto rank = [&](std::size_t node) { return std::pair(forest.root(node), node); };
    if (rank(to) < rank(from)) {
      std::swap(c.from, c.to);
      std::swap(c.covariance, c.reversed);
      c.Z = c.Z.inverse();
    }
    groups[{forest.root(c.from), forest.root(c.to)}].push_back(std::move(c));
  }
  for (const auto& [roots, group] : groups) {
    const std::size_t n = group.size();
    if (n > options.max_group) {
      throw InputError(std::to_string(n) + " closures to compare pair by pair, more than max_group = " +
                       std::to_string(options.max_group));
    }
    std::vector<std::pair<std::size_t, std::size_t>> agreeing;
    std::vector<std::size_t> degree(n, 0);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = i + 1; j < n; ++j) {
        if (loop_error(forest, group[i], group[j]) > threshold) continue;
        agreeing.emplace_back(i, j);
        ++degree[i];
        ++degree[j];
      }
    }
    std::vector<std::size_t> order(n), rank(n);
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return degree[a] > degree[b]; });
    BitMatrix agrees(n);
    std::vector<std::size_t> sorted_degree(n);
    for (std::size_t k = 0; k < n; ++k) {
      rank[order[k]] = k;
      sorted_degree[k] = degree[order[k]];
    }
    for (const auto& [i, j] : agreeing) {
      agrees.set(rank[i], rank[j]);
      agrees.set(rank[j], rank[i]);
    }
    for (const Candidate& c : group) result.kept[c.edge] = false;
    for (const std::size_t k : large_clique(agrees, sorted_degree)) result.kept[group[order[k]].edge] = true;
  }
  for (std::size_t e = 0; e < result.kept.size(); ++e) {
    if (!known_inlier(graph.edges()[e])) ++(result.kept[e] ? result.inliers : result.outliers);
  }
  return result;
}

}  // namespace loopwise
