// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_planar.hpp"

#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <optional>
#include <vector>

#include <loopwise/core/planar.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "innovation.hpp"
#include "odometry_forest.hpp"

namespace loopwise::bench {
namespace {

namespace fs = std::filesystem;

/// A closure is right if the true positions of its ends agree with it to this distance. Headings are not
/// compared, because those of satellite positions are poor.
constexpr double kRight_m = 3.0;
/// Bounds of how far closures are off, for the counts in detail.
constexpr double kBounds_m[] = {1.0, 3.0, 10.0, std::numeric_limits<double>::infinity()};
/// Of turns over a stretch of path before and after a pose.
constexpr double kStretch_m = 2.0;
/// Gaps of the truth beyond this distance are not interpolated.
constexpr double kLargestStep_m = 3.0;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// A path with the length and the turn from its start, by pose.
struct Path {
  std::vector<Eigen::Isometry3d> poses;
  std::vector<double> length, turn;

  explicit Path(std::vector<Eigen::Isometry3d> of) : poses(std::move(of)), length{0.0}, turn{0.0} {
    for (std::size_t i = 1; i < poses.size(); ++i) {
      const Eigen::Isometry3d step = poses[i - 1].inverse() * poses[i];
      length.push_back(length.back() + step.translation().norm());
      turn.push_back(turn.back() + planar::heading(step));
    }
  }

  [[nodiscard]] double turn_at(double metres) const {
    const auto after = std::upper_bound(length.begin(), length.end(), metres);
    if (after == length.begin()) return turn.front();
    if (after == length.end()) return turn.back();
    const auto i = static_cast<std::size_t>(after - length.begin());
    const double share = (metres - length[i - 1]) / (length[i] - length[i - 1]);
    return turn[i - 1] + share * (turn[i] - turn[i - 1]);
  }

  /// Turns on the stretches before and after each pose.
  [[nodiscard]] std::vector<Eigen::Vector2d> turns() const {
    std::vector<Eigen::Vector2d> out;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      out.emplace_back(turn[i] - turn_at(length[i] - kStretch_m), turn_at(length[i] + kStretch_m) - turn[i]);
    }
    return out;
  }
};

/// Which node of a path each pose of another path of the same drive belongs to: time warping by the turns
/// along the paths, in a band about equal shares of them. \returns nodes by pose of the truth; nothing where
/// turns differ by more than noise
std::optional<std::vector<double>> nodes_by_turns(const Path& path, const Path& truth) {
  constexpr double kBand = 0.1, kSlip = 0.02, kLargestMean = 0.1;
  const std::size_t n = path.poses.size(), m = truth.poses.size();
  const auto a = path.turns(), b = truth.turns();
  const auto cost = [&](std::size_t i, std::size_t j) { return std::min(1.0, (a[i] - b[j]).squaredNorm()); };
  enum Step : char { kBoth, kPath, kTruth };
  std::vector<Step> came(n * m, kBoth);
  constexpr double kFar = std::numeric_limits<double>::infinity();
  std::vector<double> last(m, kFar), now(m, kFar);
  for (std::size_t i = 0; i < n; ++i, std::swap(last, now)) {
    std::fill(now.begin(), now.end(), kFar);
    const double share = static_cast<double>(i) / static_cast<double>(n);
    const double first = std::max(0.0, share - kBand) * static_cast<double>(m);
    const double end = std::min(1.0, share + kBand) * static_cast<double>(m);
    for (auto j = static_cast<std::size_t>(first); j < static_cast<std::size_t>(end); ++j) {
      const double c = cost(i, j);
      const double along = i > 0 ? path.length[i] - path.length[i - 1] : 0.0;
      const double of_truth = j > 0 ? truth.length[j] - truth.length[j - 1] : 0.0;
      double& best = now[j];
      if (i == 0 && j == 0) best = 0.0;
      const auto consider = [&](double value, Step step) {
        if (!(value < best)) return;
        best = value;
        came[i * m + j] = step;
      };
      if (i > 0 && j > 0)
        consider(last[j - 1] + c * std::max(along, of_truth) + kSlip * std::abs(along - of_truth), kBoth);
      if (i > 0) consider(last[j] + (c + kSlip) * along, kPath);
      if (j > 0) consider(now[j - 1] + (c + kSlip) * of_truth, kTruth);
    }
  }
  std::vector<double> nodes(m, 0.0);
  double sum = 0.0;
  std::size_t count = 0;
  for (std::size_t i = n - 1, j = m - 1; i > 0 || j > 0; ++count) {
    nodes[j] = static_cast<double>(i);
    sum += cost(i, j);
    const Step step = came[i * m + j];
    if (i == 0 || (step != kPath && j > 0)) {
      --j;
      if (i > 0 && step == kBoth) --i;
    } else {
      --i;
    }
  }
  if (sum > kLargestMean * static_cast<double>(count)) return std::nullopt;
  return nodes;
}

double median(std::vector<double> values) {
  if (values.empty()) return kNaN;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Both may have been sampled at regular times: then a line is surer than turns are.
void straighten(std::vector<double>& nodes) {
  constexpr double kFew = 10.0;
  const std::size_t half = nodes.size() / 2;
  std::vector<double> slopes, offsets, residuals;
  for (std::size_t i = 0; i + half < nodes.size(); ++i)
    slopes.push_back((nodes[i + half] - nodes[i]) / static_cast<double>(half));
  const double slope = median(slopes);
  for (std::size_t i = 0; i < nodes.size(); ++i) offsets.push_back(nodes[i] - slope * static_cast<double>(i));
  const double offset = median(offsets);
  for (const double o : offsets) residuals.push_back(std::abs(o - offset));
  if (median(residuals) > kFew) return;
  std::printf("  truth at regular times: node %.3f i %+.1f\n", slope, offset);
  for (std::size_t i = 0; i < nodes.size(); ++i) nodes[i] = slope * static_cast<double>(i) + offset;
}

/// By node, where truth is near.
using Truth = std::vector<std::optional<Eigen::Isometry3d>>;

Truth interpolated(const std::vector<double>& nodes, const Path& truth, std::size_t count) {
  Truth out(count);
  for (std::size_t j = 1; j < nodes.size(); ++j) {
    const Eigen::Isometry3d step = truth.poses[j - 1].inverse() * truth.poses[j];
    if (step.translation().norm() > kLargestStep_m) continue;
    const double from = nodes[j - 1], to = nodes[j];
    for (double node = std::ceil(std::max(from, 0.0)); node <= to && node < static_cast<double>(count);
         ++node) {
      const double share = to > from ? (node - from) / (to - from) : 0.0;
      out[static_cast<std::size_t>(node)] =
          truth.poses[j - 1] * planar::pose(share * step.translation().x(), share * step.translation().y(),
                                            share * planar::heading(step));
    }
  }
  return out;
}

/// The truth of a drive: the file in the folder whose path has the same length and turns.
Truth find_truth(const PoseGraph& graph, const std::vector<Eigen::Isometry3d>& odometry,
                 const std::vector<fs::path>& files) {
  const Path path(odometry);
  for (const fs::path& file : files) {
    if (file.stem().string().find("_GT") == std::string::npos) continue;
    const Path truth(read_g2o(file).graph.poses());
    const double ratio = truth.length.back() / path.length.back();
    if (!(ratio > 0.9 && ratio < 1.1)) continue;
    auto nodes = nodes_by_turns(path, truth);
    if (!nodes) continue;
    std::printf("  truth %s, %zu poses\n", file.stem().c_str(), truth.poses.size());
    straighten(*nodes);
    return interpolated(*nodes, truth, graph.nodes().size());
  }
  return Truth(graph.nodes().size());
}

/// Root mean square of the distances after the best motion in the plane.
double absolute_error(const std::vector<Eigen::Isometry3d>& poses, const Truth& truth) {
  Eigen::Vector2d mean_p = Eigen::Vector2d::Zero(), mean_q = mean_p;
  double count = 0.0;
  const auto each = [&](auto&& body) {
    for (std::size_t i = 0; i < poses.size(); ++i) {
      if (truth[i])
        body(Eigen::Vector2d(poses[i].translation().head<2>()),
             Eigen::Vector2d(truth[i]->translation().head<2>()));
    }
  };
  each([&](const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
    mean_p += p;
    mean_q += q;
    ++count;
  });
  if (count == 0.0) return kNaN;
  mean_p /= count;
  mean_q /= count;
  double cosine = 0.0, sine = 0.0, sum = 0.0;
  each([&](const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
    const Eigen::Vector2d a = p - mean_p, b = q - mean_q;
    cosine += a.dot(b);
    sine += a.x() * b.y() - a.y() * b.x();
  });
  const Eigen::Rotation2Dd R(std::atan2(sine, cosine));
  each([&](const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
    sum += (R * (p - mean_p) - (q - mean_q)).squaredNorm();
  });
  return std::sqrt(sum / count);
}

double seconds_now() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double squared_residual(const PoseGraph& graph, std::size_t e, const std::vector<Eigen::Isometry3d>& poses) {
  const Vector6d r = edge_residual(graph.edges()[e], poses[graph.ends(e).from], poses[graph.ends(e).to]);
  return r.dot(graph.edges()[e].information * r);
}

/// How far each closure is off by the truth (by edge), m; NaN for odometry and where truth is missing.
std::vector<double> errors_of(const PoseGraph& graph, const Truth& truth) {
  std::vector<double> out(graph.edges().size(), kNaN);
  for (std::size_t e = 0; e < out.size(); ++e) {
    const auto [from, to] = graph.ends(e);
    if (known_inlier(graph.edges()[e]) || !truth[from] || !truth[to]) continue;
    const Eigen::Isometry3d T = truth[from]->inverse() * *truth[to];
    out[e] = (T.translation() - graph.edges()[e].T_from_to.translation()).norm();
  }
  return out;
}

/// The optimum with the closures that `keep(edge)` holds for.
template <class Keep>
std::vector<Eigen::Isometry3d> optimum_of(PoseGraph graph, Keep&& keep) {
  for (std::size_t e = 0; e < graph.edges().size(); ++e)
    graph.set_weight(e, known_inlier(graph.edges()[e]) || keep(e) ? 1.0 : 0.0);
  return optimize(graph).poses;
}

/// Of the closures that are off by so much: how many are kept, their residuals at the result, and how far
/// odometry alone is from them.
void show_closures(const PoseGraph& graph, const std::vector<double>& off, const GncResult& gnc) {
  const std::vector<double> d2 = detail::innovations(graph, detail::OdometryForest(graph));
  std::size_t kept_right = 0, kept = 0, right = 0;
  double above = 0.0;
  for (const double bound : kBounds_m) {
    std::vector<double> of_odometry, residuals;
    std::size_t kept_here = 0;
    for (std::size_t e = 0; e < off.size(); ++e) {
      if (!(off[e] >= above && off[e] < bound)) continue;
      kept_here += gnc.weights[e] > 0.5 ? 1 : 0;
      of_odometry.push_back(d2[e]);
      residuals.push_back(squared_residual(graph, e, gnc.optimization.poses));
    }
    if (!residuals.empty())
      std::printf("  off by %2.0f to %3.0f m: kept %3zu of %3zu; median r² %.3g, d² over odometry %.3g\n",
                  above, bound, kept_here, residuals.size(), median(residuals), median(of_odometry));
    kept += kept_here;
    if (bound <= kRight_m) {
      kept_right += kept_here;
      right += residuals.size();
    }
    above = bound;
  }
  if (kept > 0 && right > 0) {
    std::printf("  precision %.3f, recall %.3f of the kept, c² = %.1f\n",
                static_cast<double>(kept_right) / static_cast<double>(kept),
                static_cast<double>(kept_right) / static_cast<double>(right),
                chi_squared_quantile(GncOptions().inlier_probability, graph.degrees_of_freedom()));
  }
}

void show(const fs::path& file, const std::vector<fs::path>& files) {
  G2oFile read = read_g2o(file);
  PoseGraph& graph = read.graph;
  const auto closures = static_cast<std::size_t>(std::count_if(
      graph.edges().begin(), graph.edges().end(), [](const Edge& e) { return !known_inlier(e); }));
  if (!graph.planar() || closures == 0) return;
  if (graph.priors().empty()) {
    const Node& first = graph.nodes().front();
    graph.add_prior({first.key, first.pose, 1e8 * Matrix6d::Identity()});
  }
  const std::vector<Eigen::Isometry3d> odometry = initial_poses(graph, Initialization::kOdometry);
  std::printf("%s\n", file.stem().c_str());
  for (const Problem& problem : read.problems.all()) std::printf("  %s\n", to_string(problem).c_str());
  const Truth truth = find_truth(graph, odometry, files);
  const std::vector<double> off = errors_of(graph, truth);

  double start = seconds_now();
  const std::vector<Eigen::Isometry3d> all = optimum_of(graph, [](std::size_t) { return true; });
  const double all_s = seconds_now() - start;
  start = seconds_now();
  const GncResult gnc = optimize_gnc(graph);
  const double gnc_s = seconds_now() - start;
  std::printf(
      "  poses %zu, edges %zu, closures %zu: kept %zu, left out %zu; %.2f s, all believed %.2f s; start %s, "
      "%s\n",
      graph.nodes().size(), graph.edges().size(), closures, gnc.inliers, gnc.outliers, gnc_s, all_s,
      enum_name(gnc.start).c_str(), gnc.optimization.converged ? "converged" : "not converged");
  if (std::none_of(truth.begin(), truth.end(), [](const auto& pose) { return pose.has_value(); })) return;
  const auto right = optimum_of(graph, [&](std::size_t e) { return off[e] <= kRight_m; });
  std::printf("  ATE m: odometry %.2f, all closures %.2f, GNC %.2f, right closures %.2f\n",
              absolute_error(odometry, truth), absolute_error(all, truth),
              absolute_error(gnc.optimization.poses, truth), absolute_error(right, truth));
  show_closures(graph, off, gnc);
  std::fflush(stdout);
}

}  // namespace

void compare_planar(const std::string& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() == ".g2o") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) show(file, files);
}

}  // namespace loopwise::bench
