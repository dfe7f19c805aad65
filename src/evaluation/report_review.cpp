// SPDX-License-Identifier: BSD-3-Clause
#include "report_review.hpp"

#include <algorithm>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/json_values.hpp>

#include "../core/constants.hpp"
#include "report_arrays.hpp"

namespace loopwise {
namespace {

constexpr std::int64_t kScanPoints = 600;

/// A closure and its displacement by the estimate.
struct Item {
  ReviewedClosure closure;
  double off_m = 0.0, off_rad = 0.0;
};

/// Displacement of the ends of a 10 m lever: one number for translation and rotation.
double disagreement(const Item& item) {
  constexpr double kLever_m = 10.0;
  return item.off_m + kLever_m * item.off_rad;
}

Json matrix_json(const Eigen::Isometry3d& T) {
  return row_major_json(T.matrix().topRows<3>());
}

Json scan_json(const PointCloud& cloud, std::uint64_t seed) {
  const std::vector<std::size_t> chosen = drawn(cloud.size(), kScanPoints, seed);
  Eigen::Vector3f low = Eigen::Vector3f::Constant(std::numeric_limits<float>::infinity()), high = -low;
  for (const std::size_t i : chosen) {
    low = low.cwiseMin(cloud.points[i]);
    high = high.cwiseMax(cloud.points[i]);
  }
  const Eigen::Vector3f step = (high - low).cwiseMax(1e-3F) / 65535.0F;
  std::vector<std::uint16_t> points;
  points.reserve(3 * chosen.size());
  for (const std::size_t i : chosen) {
    for (int axis = 0; axis < 3; ++axis) {
      const float q = std::round((cloud.points[i][axis] - low[axis]) / step[axis]);
      points.push_back(static_cast<std::uint16_t>(std::clamp(q, 0.0F, 65535.0F)));
    }
  }
  return {
      {"low", {low[0], low[1], low[2]}}, {"step", {step[0], step[1], step[2]}}, {"points", base64(points)}};
}

/// Scans of the nodes, each read once.
class Scans {
 public:
  Scans(const ReviewedRun& run, std::uint64_t seed) : run_(run), seed_(seed) {}

  /// \returns whether the node has a scan with points
  bool add(Key key) {
    const std::string name = std::to_string(run_.place.at(key));
    if (json_.contains(name)) return true;
    try {
      const std::shared_ptr<const PointCloud> cloud =
          run_.mission.scans->has(key) ? run_.mission.scans->load(key) : nullptr;
      if (!cloud || cloud->empty()) return false;
      json_[name] = scan_json(*cloud, combine_seeds(seed_, key));
    } catch (const Error&) {  // the store has counted the problem
      return false;
    }
    return true;
  }

  [[nodiscard]] const Json& json() const { return json_; }

 private:
  const ReviewedRun& run_;
  std::uint64_t seed_;
  Json json_ = Json::object();
};

std::vector<Item> most_doubtful_first(std::vector<ReviewedClosure> closures, const ReviewedRun& run) {
  std::vector<Item> items;
  for (ReviewedClosure& closure : closures) {
    if (run.place.count(closure.from) == 0 || run.place.count(closure.to) == 0) continue;
    if (!closure.T_from_to.matrix().allFinite()) continue;
    Item item{std::move(closure)};
    const Eigen::Isometry3d estimate =
        run.graph.node(item.closure.from).pose.inverse() * run.graph.node(item.closure.to).pose;
    const Eigen::Isometry3d off = item.closure.T_from_to.inverse() * estimate;
    item.off_m = off.translation().norm();
    item.off_rad = se3::rotation_angle(off);
    items.push_back(std::move(item));
  }
  std::stable_sort(items.begin(), items.end(), [](const Item& a, const Item& b) {
    const bool a_kept = a.closure.weight > ClosureClassOptions().gnc_inlier_weight,
               b_kept = b.closure.weight > ClosureClassOptions().gnc_inlier_weight;
    return a_kept != b_kept ? b_kept : disagreement(a) > disagreement(b);
  });
  return items;
}

Json closure_json(const Item& item, const ReviewedRun& run) {
  const ReviewedClosure& closure = item.closure;
  const Eigen::Isometry3d estimate =
      run.graph.node(closure.from).pose.inverse() * run.graph.node(closure.to).pose;
  const auto from = run.odometry.find(closure.from), to = run.odometry.find(closure.to);
  const bool has_odometry = from != run.odometry.end() && to != run.odometry.end();
  return {{"from", run.place.at(closure.from)},
          {"to", run.place.at(closure.to)},
          {"keys", {std::to_string(closure.from), std::to_string(closure.to)}},
          {"weight", number_or_null(closure.weight)},
          {"overlap", number_or_null(closure.overlap)},
          {"time_s", number_or_null(closure.time_s)},
          {"off_m", item.off_m},
          {"off_deg", item.off_rad * kDegreesPerRadian},
          {"odometry", has_odometry ? matrix_json(from->second.inverse() * to->second) : Json(nullptr)},
          {"registration", matrix_json(closure.T_from_to)},
          {"estimate", matrix_json(estimate)}};
}

}  // namespace

Json review_json(std::vector<ReviewedClosure> closures, const ReviewedRun& run,
                 const ReportOptions& options) {
  const std::size_t total = closures.size();
  Scans scans(run, combine_seeds(options.seed, 7));
  Json chosen = Json::array();
  for (const Item& item : most_doubtful_first(std::move(closures), run)) {
    if (chosen.size() == static_cast<std::size_t>(options.review_closures)) break;
    if (!scans.add(item.closure.from) || !scans.add(item.closure.to)) continue;
    chosen.push_back(closure_json(item, run));
  }
  if (chosen.empty()) return nullptr;
  return {{"total", total}, {"closures", chosen}, {"scans", scans.json()}};
}

}  // namespace loopwise
