// SPDX-License-Identifier: BSD-3-Clause
#include "consistency.hpp"

#include <algorithm>
#include <numeric>

#include <Eigen/Dense>

#include <loopwise/core/se3.hpp>

namespace loopwise::joining {
namespace {

Matrix6d carried(const Eigen::Isometry3d& T, const Matrix6d& covariance) {
  const Matrix6d ad = se3::adjoint(T);
  return ad * covariance * ad.transpose();
}

}  // namespace

void ClosureSet::add(const PairClosure& closure) {
  for (std::size_t i = 0; i < closures_.size(); ++i) {
    agrees_[i].push_back(loop_error(closures_[i], closure) <= threshold_ ? 1 : 0);
  }
  std::vector<char> row;
  row.reserve(closures_.size() + 1);
  for (const std::vector<char>& other : agrees_) row.push_back(other.back());
  row.push_back(1);
  closures_.push_back(closure);
  agrees_.push_back(std::move(row));
}

double ClosureSet::loop_error(const PairClosure& x, const PairClosure& y) const {
  const Eigen::Isometry3d T_ya_xa = paths_[y.a].pose.inverse() * paths_[x.a].pose;
  const Eigen::Isometry3d T_xb_yb = paths_[x.b].pose.inverse() * paths_[y.b].pose;
  const Vector6d r = se3::log(x.closure.T_from_to.inverse() * T_xb_yb * y.closure.T_from_to * T_ya_xa);
  const Matrix6d S = x.closure.covariance + carried(T_ya_xa.inverse(), y.closure.covariance) +
                     paths_.between(x.a, y.a).covariance() + paths_.between(x.b, y.b).covariance();
  return r.dot(S.ldlt().solve(r));
}

double ClosureSet::agreement(std::size_t i, const std::vector<std::size_t>& group) const {
  if (group.empty()) return 0.0;
  const auto count = std::count_if(group.begin(), group.end(), [&](std::size_t j) { return agree(i, j); });
  return static_cast<double>(count) / static_cast<double>(group.size());
}

std::vector<std::size_t> ClosureSet::largest_group(const std::vector<std::size_t>& among) const {
  // Greedy as large_clique() of optimization/pcm.cpp: adds the remaining closures in falling order of
  // agreement.
  std::vector<std::size_t> order = among, degree(size(), 0);
  for (const std::size_t i : among) {
    for (const std::size_t j : among) degree[i] += agree(i, j) ? 1 : 0;
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t i, std::size_t j) { return degree[i] > degree[j]; });
  std::vector<std::size_t> best, group;
  for (const std::size_t start : order) {
    if (degree[start] <= best.size()) break;
    group.assign(1, start);
    for (const std::size_t i : order) {
      const bool fits =
          i != start && std::all_of(group.begin(), group.end(), [&](std::size_t j) { return agree(i, j); });
      if (fits) group.push_back(i);
    }
    if (group.size() > best.size()) best = group;
  }
  std::sort(best.begin(), best.end());
  return best;
}

std::size_t ClosureSet::places(const std::vector<std::size_t>& group, double place_m) const {
  std::vector<std::size_t> distinct;
  const auto apart = [&](std::size_t x, std::size_t y) {
    return (paths_[x].pose.translation() - paths_[y].pose.translation()).norm() > place_m;
  };
  for (const std::size_t i : group) {
    const bool is_new = std::all_of(distinct.begin(), distinct.end(), [&](std::size_t j) {
      return apart(closures_[i].a, closures_[j].a) && apart(closures_[i].b, closures_[j].b);
    });
    if (is_new) distinct.push_back(i);
  }
  return distinct.size();
}

Eigen::Isometry3d ClosureSet::frame(std::size_t i) const {
  const PairClosure& c = closures_[i];
  return paths_[c.a].pose * c.closure.T_from_to.inverse() * paths_[c.b].pose.inverse();
}

Matrix6d ClosureSet::fused_covariance(const std::vector<std::size_t>& group) const {
  const PairClosure& middle = closures_[group[group.size() / 2]];
  Matrix6d information = Matrix6d::Zero();
  for (const std::size_t i : group) {
    const PairClosure& c = closures_[i];
    const Eigen::Isometry3d T_middle_here = paths_[middle.a].pose.inverse() * paths_[c.a].pose;
    const Matrix6d here = carried(T_middle_here, c.closure.covariance) +
                          paths_.between(middle.a, c.a).covariance() +
                          paths_.between(middle.b, c.b).covariance();
    information += here.inverse();
  }
  return information.inverse();
}

}  // namespace loopwise::joining
