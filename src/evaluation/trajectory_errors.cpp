// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/trajectory_errors.hpp>

#include <algorithm>
#include <cmath>

#include <Eigen/SVD>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "../core/constants.hpp"

namespace loopwise {
namespace {

/// A node that is in both trajectories.
struct Pair {
  Key key;
  Eigen::Isometry3d estimate;
  Eigen::Isometry3d truth;
};

void check_pose(const char* which, Key key, const Eigen::Isometry3d& pose) {
  const std::string name =
      std::string(which) + ": the pose of key " + std::to_string(key) + " (" + key_name(key) + ")";
  if (!pose.matrix().allFinite()) throw InputError(name + " is not finite");
  // Accepts poses of text files with few digits; rejects scaled or mirrored ones.
  if (se3::rotation_defect(pose.linear()) > 1e-3) throw InputError(name + " has no rotation");
}

std::vector<Pair> common_poses(const PosesByKey& estimate, const PosesByKey& truth) {
  std::vector<Pair> pairs;
  for (const auto& [key, pose] : estimate) {
    const auto other = truth.find(key);
    if (other == truth.end()) continue;
    check_pose("estimate", key, pose);
    check_pose("truth", key, other->second);
    pairs.push_back({key, pose, other->second});
  }
  if (pairs.empty()) {
    throw InputError("the estimate (" + std::to_string(estimate.size()) + " poses) and the truth (" +
                     std::to_string(truth.size()) + " poses) have no key in common");
  }
  return pairs;
}

/// The rotation R that maximises tr(R M), M by its singular values in descending order.
Eigen::Matrix3d best_rotation(const Eigen::JacobiSVD<Eigen::Matrix3d>& svd) {
  Eigen::Vector3d signs(1.0, 1.0, 1.0);
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0.0) signs.z() = -1.0;
  return svd.matrixV() * signs.asDiagonal() * svd.matrixU().transpose();
}

AlignmentResult align_pairs(const std::vector<Pair>& pairs, Alignment alignment) {
  AlignmentResult out;
  if (alignment == Alignment::kNone) return out;
  if (alignment == Alignment::kFirst) {
    out.T_truth_estimate = se3::normalized(pairs.front().truth * pairs.front().estimate.inverse());
    return out;
  }

  Eigen::Vector3d estimate_mean = Eigen::Vector3d::Zero(), truth_mean = Eigen::Vector3d::Zero();
  for (const Pair& pair : pairs) {
    estimate_mean += pair.estimate.translation();
    truth_mean += pair.truth.translation();
  }
  estimate_mean /= static_cast<double>(pairs.size());
  truth_mean /= static_cast<double>(pairs.size());

  Eigen::Matrix3d positions = Eigen::Matrix3d::Zero();     // Σ x yᵀ, centred
  Eigen::Matrix3d orientations = Eigen::Matrix3d::Zero();  // Σ R_X R_Yᵀ
  double x2 = 0.0, y2 = 0.0;
  for (const Pair& pair : pairs) {
    const Eigen::Vector3d x = pair.estimate.translation() - estimate_mean;
    const Eigen::Vector3d y = pair.truth.translation() - truth_mean;
    positions += x * y.transpose();
    x2 += x.squaredNorm();
    y2 += y.squaredNorm();
    orientations += pair.estimate.linear() * pair.truth.linear().transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(positions, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d spread = svd.singularValues();

  // Below this share, the spread across a line is rounding. On a line 100 m long, a few millimetres across
  // already determine a plane.
  constexpr double kLineBelow = 1e-9;
  constexpr double kPointBelow = 1e-12;
  const double scale = estimate_mean.squaredNorm() + truth_mean.squaredNorm();
  // Errors larger than the width of the path do not determine the rotation about it: best_rotation() would
  // fit noise.
  const auto is_line_within_errors = [&] {
    const double residual = x2 + y2 - 2.0 * (best_rotation(svd) * positions).trace();
    return spread[1] + spread[2] < residual;
  };
  Eigen::Matrix3d R;
  if (spread[0] <= kPointBelow * std::sqrt(x2 * y2) || x2 <= kPointBelow * kPointBelow * scale ||
      y2 <= kPointBelow * kPointBelow * scale) {
    out.support = AlignmentSupport::kPoint;
    R = best_rotation(
        Eigen::JacobiSVD<Eigen::Matrix3d>(orientations, Eigen::ComputeFullU | Eigen::ComputeFullV));
  } else if (spread[1] <= kLineBelow * spread[0] || is_line_within_errors()) {
    out.support = AlignmentSupport::kLine;
    // Turn one line onto the other, then about it by the angle a that maximises
    // tr(Exp(a·u) M) = cos a · (tr M − uᵀMu) + sin a · tr([u]× M) + uᵀMu, with M = R₀ Σ R_X R_Yᵀ.
    const Eigen::Vector3d u = svd.matrixV().col(0);
    const Eigen::Matrix3d onto =
        Eigen::Quaterniond::FromTwoVectors(svd.matrixU().col(0), u).toRotationMatrix();
    const Eigen::Matrix3d M = onto * orientations;
    const double angle = std::atan2((se3::skew(u) * M).trace(), M.trace() - u.dot(M * u));
    R = se3::so3_exp(angle * u) * onto;
  } else {
    R = best_rotation(svd);
  }
  out.T_truth_estimate.linear() = R;
  out.T_truth_estimate.translation() = truth_mean - R * estimate_mean;
  return out;
}

/// Errors and path lengths of pairs of nodes on one robot's path, in order.
struct RelativeSamples {
  std::vector<double> translation_m, rotation_rad, length_m;

  void add(const Pair& i, const Pair& j, double length) {
    const Eigen::Isometry3d error = (j.truth.inverse() * i.truth) * (i.estimate.inverse() * j.estimate);
    translation_m.push_back(error.translation().norm());
    rotation_rad.push_back(se3::rotation_angle(error));
    length_m.push_back(length);
  }
  void add(const RelativeSamples& others) {
    translation_m.insert(translation_m.end(), others.translation_m.begin(), others.translation_m.end());
    rotation_rad.insert(rotation_rad.end(), others.rotation_rad.begin(), others.rotation_rad.end());
    length_m.insert(length_m.end(), others.length_m.begin(), others.length_m.end());
  }
};

/// Mean of errors[k] / lengths[k] over the lengths ≥ shortest; NaN without any.
double mean_ratio(const std::vector<double>& errors, const std::vector<double>& lengths, double shortest) {
  double sum = 0.0;
  std::size_t count = 0;
  for (std::size_t k = 0; k < errors.size(); ++k) {
    if (lengths[k] < shortest) continue;
    sum += errors[k] / lengths[k];
    ++count;
  }
  return count == 0 ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(count);
}

RelativeErrors summarize(const RelativeSamples& samples, double distance_m, double min_path_m) {
  RelativeErrors out;
  out.distance_m = distance_m;
  out.translation_m = statistics(samples.translation_m);
  out.rotation_rad = statistics(samples.rotation_rad);
  out.translation_percent = 100.0 * mean_ratio(samples.translation_m, samples.length_m, min_path_m);
  out.rotation_deg_per_m = kDegreesPerRadian * mean_ratio(samples.rotation_rad, samples.length_m, min_path_m);
  return out;
}

}  // namespace

EnumNames<Alignment> enum_names(Alignment) {
  return {{Alignment::kNone, "none"}, {Alignment::kFirst, "first"}, {Alignment::kSe3, "se3"}};
}

EnumNames<AlignmentSupport> enum_names(AlignmentSupport) {
  return {{AlignmentSupport::kPositions, "positions"},
          {AlignmentSupport::kLine, "line"},
          {AlignmentSupport::kPoint, "point"}};
}

PosesByKey poses_by_key(const PoseGraph& graph) {
  PosesByKey poses;
  for (const Node& node : graph.nodes()) poses.emplace(node.key, node.pose);
  return poses;
}

AlignmentResult align(const PosesByKey& estimate, const PosesByKey& truth, Alignment alignment) {
  return align_pairs(common_poses(estimate, truth), alignment);
}

Statistics statistics(std::vector<double> errors) {
  Statistics out;
  out.count = errors.size();
  if (errors.empty()) return out;
  double sum = 0.0, squares = 0.0;
  for (const double error : errors) {
    sum += error;
    squares += error * error;
  }
  const double n = static_cast<double>(errors.size());
  out.mean = sum / n;
  out.rmse = std::sqrt(squares / n);
  std::sort(errors.begin(), errors.end());
  const std::size_t middle = errors.size() / 2;
  out.median = errors.size() % 2 == 1 ? errors[middle] : 0.5 * (errors[middle - 1] + errors[middle]);
  out.max = errors.back();
  return out;
}

TrajectoryErrors evaluate_trajectory(const PosesByKey& estimate, const PosesByKey& truth, Alignment alignment,
                                     const Robots& robots, const TrajectoryEvaluationOptions& options) {
  validate(options);
  const std::vector<Pair> pairs = common_poses(estimate, truth);

  TrajectoryErrors out;
  out.alignment = alignment;
  out.applied = align_pairs(pairs, alignment);
  out.poses = pairs.size();
  out.only_in_estimate = estimate.size() - pairs.size();
  out.only_in_truth = truth.size() - pairs.size();

  std::vector<double> ate_m, ate_rad;
  std::vector<Key> keys;
  for (const Pair& pair : pairs) {
    const Eigen::Isometry3d error = pair.truth.inverse() * out.applied.T_truth_estimate * pair.estimate;
    ate_m.push_back(error.translation().norm());
    ate_rad.push_back(se3::rotation_angle(error));
    keys.push_back(pair.key);
  }
  out.ate_m = statistics(ate_m);
  out.ate_rad = statistics(ate_rad);

  // Keys are in order and so are the robots' ranges: each robot's nodes are one run of pairs.
  const Robots team = robots.empty() ? Robots::from_keys(keys) : robots;
  RelativeSamples all_steps;
  std::vector<RelativeSamples> by_distance(options.distances_m.size());
  for (std::size_t first = 0; first < pairs.size();) {
    const std::size_t robot = team.of(keys[first]);
    std::size_t end = first + 1;
    while (end < pairs.size() && team.of(keys[end]) == robot) ++end;

    RobotErrors errors;
    errors.name = team[robot].name;
    errors.poses = end - first;
    RelativeSamples steps;
    std::vector<double> path{0.0};  // s_k from the robot's first node
    for (std::size_t k = first + 1; k < end; ++k) {
      const auto step = [](const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
        return (b.translation() - a.translation()).norm();
      };
      const double length = step(pairs[k - 1].truth, pairs[k].truth);
      path.push_back(path.back() + length);
      errors.path_length_estimate_m += step(pairs[k - 1].estimate, pairs[k].estimate);
      steps.add(pairs[k - 1], pairs[k], length);
    }
    errors.path_length_m = path.back();

    const auto slice = [&](const std::vector<double>& all) {
      return std::vector<double>(all.begin() + static_cast<std::ptrdiff_t>(first),
                                 all.begin() + static_cast<std::ptrdiff_t>(end));
    };
    errors.ate_m = statistics(slice(ate_m));
    errors.ate_rad = statistics(slice(ate_rad));
    errors.step = summarize(steps, 0.0, options.min_path_m);
    errors.translation_percent = 100.0 * mean_ratio(slice(ate_m), path, options.min_path_m);
    errors.rotation_deg_per_m = kDegreesPerRadian * mean_ratio(slice(ate_rad), path, options.min_path_m);
    out.robots.push_back(errors);

    all_steps.add(steps);
    for (std::size_t d = 0; d < by_distance.size(); ++d) {
      std::size_t j = 0;
      for (std::size_t i = 0; i < path.size(); ++i) {
        while (j < path.size() && path[j] - path[i] < options.distances_m[d]) ++j;
        if (j == path.size()) break;
        by_distance[d].add(pairs[first + i], pairs[first + j], path[j] - path[i]);
      }
    }
    first = end;
  }
  out.step = summarize(all_steps, 0.0, options.min_path_m);
  for (std::size_t d = 0; d < by_distance.size(); ++d) {
    out.by_distance.push_back(summarize(by_distance[d], options.distances_m[d], options.min_path_m));
  }
  return out;
}

}  // namespace loopwise
