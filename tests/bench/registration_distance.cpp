// SPDX-License-Identifier: BSD-3-Clause
#include "registration_distance.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/registration/fast_registrar.hpp>

#include "registration_pcl.hpp"

namespace loopwise::bench {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180.0;
constexpr double kBinM = 10.0;
constexpr std::size_t kBins = 4;
constexpr double kVoxelM = 0.5, kFpfhRadiusM = 2.0;  // of PCL
/// Keys of the turned scans. A key of the recording never has this bit, which is the sign of a character.
constexpr Key kTurned = Key{1} << 63;

using Pair = std::pair<Key, Key>;  // source, target
using Poses = std::map<Key, Eigen::Isometry3d>;

/// Pairs of key frames by their distance, shuffled.
std::vector<std::vector<Pair>> pairs_by_distance(const Poses& poses, std::uint64_t count) {
  std::vector<std::vector<Pair>> bins(kBins);
  for (auto a = poses.begin(); a != poses.end(); ++a) {
    for (auto b = poses.begin(); b != a; ++b) {
      const double d = (a->second.translation() - b->second.translation()).norm();
      if (d < kBinM * kBins) bins[static_cast<std::size_t>(d / kBinM)].emplace_back(a->first, b->first);
    }
  }
  Rng rng(1);
  for (std::vector<Pair>& bin : bins) {
    for (std::size_t i = 0; i < std::min<std::size_t>(bin.size(), count); ++i)
      std::swap(
          bin[i],
          bin[i + static_cast<std::size_t>(rng.uniform(0.0, 1.0) * static_cast<double>(bin.size() - i))]);
    if (bin.size() > count) bin.resize(count);
  }
  return bins;
}

/// The yaw by which the scan of a key is turned as a source.
Eigen::Isometry3d turn_of(Key key) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.rotate(Eigen::AngleAxisd(Rng(key).uniform(-3.14, 3.14), Eigen::Vector3d::UnitZ()));
  return T;
}

std::shared_ptr<const PointCloud> turned(const PointCloud& cloud, const Eigen::Isometry3d& T) {
  auto out = std::make_shared<PointCloud>();
  for (const Eigen::Vector3f& p : cloud.points) out->points.push_back((T * p.cast<double>()).cast<float>());
  return out;
}

/// Results of one implementation in a row.
struct Row {
  std::size_t pairs = 0, found = 0, accepted = 0, within = 0, close = 0;
  std::vector<double> accepted_ms, rejected_ms;

  void add(const std::optional<Eigen::Isometry3d>& T, const Eigen::Isometry3d& truth, bool is_accepted,
           double ms) {
    ++pairs;
    (is_accepted ? accepted_ms : rejected_ms).push_back(ms);
    if (!T) return;
    const Eigen::Isometry3d d = truth.inverse() * *T;
    const double m = d.translation().norm(), degrees = se3::rotation_angle(d) / kDegree;
    const bool right = m < 2.0 && degrees < 5.0;
    found += right ? 1 : 0;
    if (!is_accepted) return;
    ++accepted;
    within += right ? 1 : 0;
    close += m < 0.3 && degrees < 1.0 ? 1 : 0;
  }

  void print(const char* name, double from_m) const {
    const auto share = [&](std::size_t n) {
      return pairs == 0 ? std::nan("") : 100.0 * static_cast<double>(n) / static_cast<double>(pairs);
    };
    const auto median = [](std::vector<double> v) {
      if (v.empty()) return std::nan("");
      std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2), v.end());
      return v[v.size() / 2];
    };
    std::printf("%-5s %2.0f-%2.0f m %6zu %7.1f %9.1f %9.1f %9.1f %6zu %9.2f %9.2f\n", name, from_m,
                from_m + kBinM, pairs, share(found), share(accepted), share(within), share(close),
                accepted - within, median(accepted_ms), median(rejected_ms));
    std::fflush(stdout);
  }
};

}  // namespace

void distance(const std::filesystem::path& folder, std::uint64_t count, std::uint64_t pcl_every) {
  const Mission mission = read_mission(folder);
  Poses poses;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.scans->has(node.key)) continue;
    const auto truth = mission.ground_truth.find(node.key);
    if (!mission.ground_truth.empty() && truth == mission.ground_truth.end()) continue;
    poses.emplace(node.key, truth == mission.ground_truth.end() ? node.pose : truth->second);
  }
  std::printf("%s: %zu key frames with a scan and a pose, %s\n", folder.filename().c_str(), poses.size(),
              mission.ground_truth.empty() ? "the recording's own" : "the truth");
  const ScanLoader load = mission.scans->loader();
  const ScanLoader turning = [&](Key key) -> std::shared_ptr<const PointCloud> {
    const auto cloud = load(key & ~kTurned);
    return cloud && (key & kTurned) != 0 ? turned(*cloud, turn_of(key & ~kTurned)) : cloud;
  };
  const FastRegistrar registrar(std::make_shared<FeatureCache>(turning));
  std::printf("%-5s %7s %6s %7s %9s %9s %9s %6s %9s %9s\n", "", "", "pairs", "found %", "verified",
              "2 m, 5 deg", "0.3 m, 1", "wrong", "ms", "ms reject");
  const auto bins = pairs_by_distance(poses, count);
  for (std::size_t bin = 0; bin < kBins; ++bin) {
    Row fast, pcl;
    std::uint64_t number = 0;
    for (const auto& [source, target] : bins[bin]) {
      const Eigen::Isometry3d truth =
          poses.at(target).inverse() * poses.at(source) * turn_of(source).inverse();
      const RegistrationTask task = pair_task(source | kTurned, target, number);
      registrar.prepare(source | kTurned);
      registrar.prepare(target);
      const double start = thread_seconds();
      const RegistrationResult result = registrar.compute(task);
      const double ms = 1e3 * (thread_seconds() - start);
      fast.add(result.T_from_to ? std::optional(result.T_from_to->inverse()) : std::nullopt, truth,
               result.verified(), ms);
      if (pcl_every == 0 || number++ % pcl_every != 0) continue;
      const PclScan from(*turning(source | kTurned), kVoxelM, kFpfhRadiusM),
          to(*turning(target), kVoxelM, kFpfhRadiusM);
      const PclAlignment peer = pcl_align(from, to, true, static_cast<unsigned>(number));
      pcl.add(peer.T_target_source, truth, peer.accepted, peer.ms());
    }
    const double from_m = kBinM * static_cast<double>(bin);
    fast.print("fast", from_m);
    if (pcl_every > 0) pcl.print("PCL", from_m);
  }
}

}  // namespace loopwise::bench
