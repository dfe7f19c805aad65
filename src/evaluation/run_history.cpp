// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/run_history.hpp>

#include <loopwise/core/se3.hpp>
#include <loopwise/io/csv.hpp>

namespace loopwise {
namespace {

/// Longest time without a row, s.
constexpr double kInterval = 10.0;

}  // namespace

RunHistory::RunHistory(const Mission& mission, const ClosureClassOptions& options)
    : mission_(mission), options_(options) {
  validate(options_);
}

void RunHistory::add(const ReplayMoment& moment) {
  const double since = rows_.empty() ? kInterval : moment.mission_time_s - rows_.back().mission_time_s;
  if (moment.kind == ReplayMoment::Kind::kKeyFrame && since < kInterval) return;

  for (; judged_ < moment.computed.size(); ++judged_) {
    const RegistrationResult& result = moment.computed[judged_].result;
    if (!result.verified()) continue;
    const auto error = closure_error(*result.closure, mission_.ground_truth);
    verified_.push_back({judged_, error && error->translation_m <= options_.true_inlier_m &&
                                      error->rotation_rad <= options_.true_inlier_rad});
  }

  HistoryRow row;
  row.mission_time_s = moment.mission_time_s;
  row.key_frames = moment.graph.nodes().size();
  row.generated = moment.accounting.generated;
  row.queued = moment.accounting.queued();
  row.computed = moment.computed.size();
  row.verified = verified_.size();
  for (const Verified& closure : verified_) {
    const bool kept = moment.computed[closure.computed].weight > options_.gnc_inlier_weight;
    row.gnc_inliers += kept ? 1 : 0;
    row.true_inliers += closure.right ? 1 : 0;
    row.right_inliers += kept && closure.right ? 1 : 0;
  }

  std::size_t known = 0;
  double estimate_m = 0.0, odometry_m = 0.0;
  // A truth in another frame is of no use for the estimate of a moment.
  for (std::size_t i = 0; i < moment.graph.nodes().size() && !mission_.truth_is_aligned; ++i) {
    const auto truth = mission_.ground_truth.find(moment.graph.nodes()[i].key);
    if (truth == mission_.ground_truth.end()) continue;
    ++known;
    estimate_m += (moment.graph.nodes()[i].pose.translation() - truth->second.translation()).norm();
    odometry_m += (moment.odometry[i].translation() - truth->second.translation()).norm();
  }
  if (known > 0) {
    row.ate_m = estimate_m / static_cast<double>(known);
    row.odometry_ate_m = odometry_m / static_cast<double>(known);
  }
  if (!rows_.empty() && rows_.back().mission_time_s >= moment.mission_time_s) rows_.pop_back();
  rows_.push_back(row);
}

std::string history_csv(const std::vector<HistoryRow>& rows) {
  CsvText csv({"mission_time_s", "key_frames", "generated", "queued", "computed", "verified", "gnc_inliers",
               "true_inliers", "right_inliers", "ate_m", "odometry_ate_m"});
  for (const HistoryRow& row : rows) {
    csv.row(row.mission_time_s, row.key_frames, row.generated, row.queued, row.computed, row.verified,
            row.gnc_inliers, row.true_inliers, row.right_inliers, row.ate_m, row.odometry_ate_m);
  }
  return csv.text();
}

}  // namespace loopwise
