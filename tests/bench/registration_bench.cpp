// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// FastRegistrar beside PCL's own stages, pair by pair in one run and one thread.
///   loopwise_registration_bench kitti DATA/kitti_pair [STARTS]
///     one pair of overlapping scans from random starts
///   loopwise_registration_bench session DATA/kaist03 [PCL_EVERY]
///     all pairs of a session; PCL on every n-th
///   loopwise_registration_bench foreign DATA
///     scans of two places: to be rejected
///   loopwise_registration_bench gicp DATA/kitti_pair [STARTS [VOXEL_M]]
///     the refinement alone, voxels of 0.25 m, also beside small_gicp if that is installed
///   loopwise_registration_bench distance FOLDER [PAIRS [PCL_EVERY]]
///     pairs of any folder of scans with poses, by their distance
///   loopwise_registration_bench symmetric all|KIND [COUNT [SEED]]
///     FastRegistrar alone in generated rooms that repeat
/// PCL: 0.5 m voxels, normals of 10 neighbours, FPFH of 2 m over all points or Harris key points, whichever
/// is faster on the pair, 500 hypotheses, GICP. What belongs to a scan is computed before the pair is timed.
/// Times are processor time of the thread: a busy machine shows less.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/robust_centre.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/trajectory.hpp>
#include <loopwise/registration/fast_registrar.hpp>

#include "gicp.hpp"
#include "normal_bins.hpp"
#include "registration_distance.hpp"
#include "registration_pcl.hpp"
#include "registration_small_gicp.hpp"
#include "registration_symmetric.hpp"

namespace loopwise::bench {
namespace {

namespace fs = std::filesystem;

constexpr double kDegree = 3.14159265358979323846 / 180.0;
constexpr double kVoxel = 0.5, kFpfhRadius = 2.0;

using Scans = std::map<Key, std::shared_ptr<const PointCloud>>;

ScanLoader loader(const Scans& scans) {
  return [&scans](Key key) { return scans.at(key); };
}

std::shared_ptr<const PointCloud> moved(const PointCloud& cloud, const Eigen::Isometry3d& T) {
  auto out = std::make_shared<PointCloud>();
  for (const Eigen::Vector3f& p : cloud.points) out->points.push_back((T * p.cast<double>()).cast<float>());
  return out;
}

double median(std::vector<double> values) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}
double largest(const std::vector<double>& values) {
  return values.empty() ? std::nan("") : *std::max_element(values.begin(), values.end());
}

struct Error {
  double m, deg;
};
Error error_of(const Eigen::Isometry3d& found, const Eigen::Isometry3d& truth) {
  const Eigen::Isometry3d d = truth.inverse() * found;
  return {d.translation().norm(), se3::rotation_angle(d) / kDegree};
}

/// Figures of one implementation over pairs.
struct Column {
  std::vector<double> ms, first_ms, second_ms, m, deg;
  std::size_t pairs = 0, right = 0, accepted = 0;
  void add(double first, double second) {
    ++pairs;
    first_ms.push_back(first);
    second_ms.push_back(second);
    ms.push_back(first + second);
  }
  void judge(bool was_accepted, const Error& e, double max_m, double max_deg) {
    if (!was_accepted) return;
    ++accepted;
    m.push_back(e.m);
    deg.push_back(e.deg);
    if (e.m < max_m && e.deg < max_deg) ++right;
  }
  void print(const char* name) const {
    std::printf("%-14s %5zu %9zu %6zu %9.2f %9.2f %9.2f %8.3f %7.3f %7.2f %6.2f\n", name, pairs, accepted,
                right, median(ms), median(first_ms), median(second_ms), median(m), largest(m), median(deg),
                largest(deg));
  }
};

void print_header() {
  std::printf("%-14s %5s %9s %6s %9s %9s %9s %8s %7s %7s %6s\n", "", "pairs", "accepted", "right", "ms",
              "global", "refine", "m", "max", "deg", "max");
}

void print_ratio(const std::vector<double>& ours, const std::vector<double>& pcl, const char* what) {
  std::vector<double> ratio;
  for (std::size_t i = 0; i < std::min(ours.size(), pcl.size()); ++i) ratio.push_back(ours[i] / pcl[i]);
  const double r = median(ratio);
  std::printf("%s: median of the pairs' ratios 1/%.1f, of the sums 1/%.1f\n", what, 1.0 / r, [&] {
    double a = 0, b = 0;
    for (std::size_t i = 0; i < ratio.size(); ++i) a += ours[i], b += pcl[i];
    return b / a;
  }());
}

/// Our registration of the pair, timed with prepared scans: the best of three runs, because it is short.
RegistrationResult ours(const Registrar& registrar, const RegistrationTask& task, Column& column) {
  RegistrationResult result = registrar.compute(task);
  double best = 1e300, global = 0.0, refine = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double start = thread_seconds();
    result = registrar.compute(task);
    const double ms = 1e3 * (thread_seconds() - start);
    if (ms >= best) continue;
    best = ms;
    refine = std::min(1e3 * result.refine_s, ms);
    global = ms - refine;
  }
  column.add(global, refine);
  return result;
}

/// PCL with the key points that are faster on this pair.
PclAlignment peer(const PclScan& source, const PclScan& target, unsigned seed, Column& column) {
  PclAlignment best = pcl_align(source, target, true, seed);
  // All points cost more on each of the 500 hypotheses: no need to try unless they are few.
  if (source.points < 2 * source.harris_points + 50) {
    const PclAlignment all = pcl_align(source, target, false, seed);
    if (all.ms() < best.ms()) best = all;
  }
  column.add(best.sac_ms, best.gicp_ms);
  return best;
}

/// Seconds for the data of one scan.
struct Preparation {
  std::vector<double> pcl_voxel, pcl_normals, pcl_fpfh, pcl_fpfh_harris, pcl_harris, ours;
  void add(const PclScan& scan, const std::shared_ptr<const PointCloud>& cloud) {
    pcl_voxel.push_back(scan.voxel_ms);
    pcl_normals.push_back(scan.normals_ms);
    pcl_fpfh.push_back(scan.fpfh_ms);
    pcl_fpfh_harris.push_back(scan.fpfh_harris_ms);
    pcl_harris.push_back(scan.harris_ms);
    double best = 1e300;
    for (int i = 0; i < 3; ++i) {
      const double start = thread_seconds();
      const auto features = std::make_shared<FeatureCache>([&](Key) { return cloud; });
      FastRegistrar(features).prepare(0);
      best = std::min(best, 1e3 * (thread_seconds() - start));
    }
    ours.push_back(best);
  }
  void print() const {
    std::vector<double> least;
    for (std::size_t i = 0; i < ours.size(); ++i) {
      least.push_back(pcl_normals[i] + std::min(pcl_fpfh[i], pcl_harris[i] + pcl_fpfh_harris[i]));
    }
    std::printf(
        "preparation of a scan, ms: PCL voxels %.1f, normals %.1f, FPFH %.1f (Harris %.1f, FPFH there "
        "%.1f); ours, voxels to descriptors %.1f\n",
        median(pcl_voxel), median(pcl_normals), median(pcl_fpfh), median(pcl_harris), median(pcl_fpfh_harris),
        median(ours));
    print_ratio(ours, least, "preparation against PCL's normals and FPFH");
  }
};

Eigen::Isometry3d random_start(Rng& rng) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.rotate(Eigen::AngleAxisd(rng.uniform(-3.14, 3.14), Eigen::Vector3d::UnitZ()));
  T.translation() << rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-1, 1);
  return T;
}

struct KittiPair {
  std::shared_ptr<const PointCloud> source, target;
  Eigen::Isometry3d T_target_source;
};
KittiPair read_pair(const fs::path& folder) {
  KittiPair pair;
  pair.source = std::make_shared<PointCloud>(read_cloud(folder / "source.ply").cloud);
  pair.target = std::make_shared<PointCloud>(read_cloud(folder / "target.ply").cloud);
  std::ifstream file(folder / "T_target_source.txt");
  pair.T_target_source.setIdentity();
  for (int i = 0; i < 16; ++i) file >> pair.T_target_source.matrix()(i / 4, i % 4);
  return pair;
}

void kitti(const fs::path& folder, std::uint64_t starts) {
  const KittiPair pair = read_pair(folder);
  const PclScan target(*pair.target, kVoxel, kFpfhRadius);
  Column fast, pcl;
  Preparation preparation;
  for (std::uint64_t seed = 0; seed < starts; ++seed) {
    Rng rng(seed);
    const Eigen::Isometry3d T_moved_source = random_start(rng);
    const Scans scans{{0, pair.target}, {1, moved(*pair.source, T_moved_source)}};
    const Eigen::Isometry3d truth = pair.T_target_source * T_moved_source.inverse();
    const PclScan source(*scans.at(1), kVoxel, kFpfhRadius);
    preparation.add(source, scans.at(1));
    const FastRegistrar registrar(std::make_shared<FeatureCache>(loader(scans)));
    const RegistrationResult result = ours(registrar, pair_task(1, 0, seed), fast);
    if (result.T_from_to) {
      fast.judge(result.verified(), error_of(result.T_from_to->inverse(), truth), 0.2, 0.5);
    }
    const PclAlignment peers = peer(source, target, static_cast<unsigned>(seed + 1), pcl);
    pcl.judge(peers.accepted, error_of(peers.T_target_source, truth), 0.2, 0.5);
  }
  print_header();
  fast.print("fast");
  pcl.print("PCL");
  print_ratio(fast.ms, pcl.ms, "a pair that succeeds");
  preparation.print();
}

Scans read_session(const fs::path& folder, std::size_t count) {
  Scans scans;
  for (std::size_t i = 0; i < count; ++i) {
    std::ostringstream name;
    name << std::setw(6) << std::setfill('0') << i << ".pcd";
    scans[i] = std::make_shared<PointCloud>(read_cloud(folder / "Scans" / name.str()).cloud);
  }
  return scans;
}

void session(const fs::path& folder, std::size_t pcl_every) {
  const std::vector<Eigen::Isometry3d> poses = read_kitti(folder / "optimized_poses.txt");
  const Scans scans = read_session(folder, poses.size());
  const FastRegistrar registrar(std::make_shared<FeatureCache>(loader(scans)));
  std::vector<std::unique_ptr<PclScan>> pcl_scans;
  Preparation preparation;
  for (const auto& [key, scan] : scans) {
    if (pcl_every == 0) break;
    pcl_scans.push_back(std::make_unique<PclScan>(*scan, kVoxel, kFpfhRadius));
    preparation.add(*pcl_scans.back(), scan);
  }
  Column fast, fast_beside, pcl;
  std::size_t number = 0;
  for (Key from = 1; from < poses.size(); ++from) {
    for (Key to = 0; to < from; ++to, ++number) {
      const Eigen::Isometry3d truth = poses[to].inverse() * poses[from];
      const RegistrationResult result = ours(registrar, pair_task(from, to, number), fast);
      if (result.T_from_to) {
        fast.judge(result.verified(), error_of(result.T_from_to->inverse(), truth), 0.4, 1.2);
      }
      if (!result.verified()) std::printf("%lu-%lu: %s\n", from, to, result.message.c_str());
      if (pcl_every == 0 || number % pcl_every != 0) continue;
      fast_beside.ms.push_back(fast.ms.back());
      const PclAlignment peers =
          peer(*pcl_scans[from], *pcl_scans[to], static_cast<unsigned>(number + 1), pcl);
      pcl.judge(peers.accepted, error_of(peers.T_target_source, truth), 0.4, 1.2);
    }
  }
  print_header();
  fast.print("fast");
  if (pcl_every == 0) return;
  pcl.print("PCL");
  print_ratio(fast_beside.ms, pcl.ms, "a pair");
  preparation.print();
}

void foreign(const fs::path& data) {
  const KittiPair pair = read_pair(data / "kitti_pair");
  Scans scans = read_session(data / "kaist03", 21);
  const Key kitti_source = 1000, kitti_target = 1001;
  scans[kitti_source] = pair.source;
  scans[kitti_target] = pair.target;
  std::map<Key, std::unique_ptr<PclScan>> pcl_scans;
  const FastRegistrar registrar(std::make_shared<FeatureCache>(loader(scans)));
  Column fast, pcl;
  for (Key key = 0; key < 21; key += 2) {
    for (const auto& [from, to] : {std::pair{kitti_source, key}, std::pair{key, kitti_target}}) {
      for (const Key k : {from, to}) {
        auto& scan = pcl_scans[k];
        if (!scan) scan = std::make_unique<PclScan>(*scans[k], kVoxel, kFpfhRadius);
      }
      const RegistrationResult result = ours(registrar, pair_task(from, to, key), fast);
      if (result.verified()) ++fast.accepted;
      const PclAlignment peers = peer(*pcl_scans[from], *pcl_scans[to], static_cast<unsigned>(key + 1), pcl);
      if (peers.accepted) ++pcl.accepted;
    }
  }
  print_header();
  fast.print("fast");
  pcl.print("PCL");
  print_ratio(fast.ms, pcl.ms, "a pair that is rejected");
}

void gicp(const fs::path& folder, std::uint64_t starts, double voxel_m) {
  const KittiPair pair = read_pair(folder);
  FeatureOptions options;
  options.voxel_m = voxel_m;
  const ScanFeatures source = compute_features(*pair.source, options);
  const ScanFeatures target = compute_features(*pair.target, options);
  const auto order = draw_balanced(source.cloud, source.cloud.size());
  const PclScan pcl_source(*pair.source, voxel_m, kFpfhRadius),
      pcl_target(*pair.target, voxel_m, kFpfhRadius);
  Column fast;
  std::map<std::string, Column> peers;
  std::map<std::string, PclGicpSettings> settings;
  for (const double reach : {0.5, 1.0, 2.0}) {
    for (const bool own : {false, true}) {
      PclGicpSettings s;
      s.reach_m = reach;
      s.own_covariances = own;
      settings["PCL " + std::to_string(reach).substr(0, 3) + (own ? " own" : "")] = s;
    }
  }
  const Eigen::Vector3d centre = robust_centre(source.cloud.points);
  const SmallGicpScan small_source(*pair.source, voxel_m), small_target(*pair.target, voxel_m);
  for (std::uint64_t seed = 0; seed < starts; ++seed) {
    Rng rng(seed + 100);
    Eigen::Vector3d shift(rng.normal(), rng.normal(), rng.normal()),
        axis(rng.normal(), rng.normal(), rng.normal());
    Eigen::Isometry3d off = Eigen::Isometry3d::Identity();
    off.linear() = Eigen::AngleAxisd(10.0 * kDegree, axis.normalized()).toRotationMatrix();
    off.translation() = shift.normalized();
    const Eigen::Isometry3d start = pair.T_target_source * off;
    double best = 1e300;
    GicpResult result;
    for (int i = 0; i < 3; ++i) {
      const double begin = thread_seconds();
      FollowedPoints followed(target.tree, order.size());  // each run knows nothing from the others
      result = refine_gicp(source.cloud, centre, order, target.cloud, followed, start,
                           gicp_passes(4.0, 0.5, 1000, 6000));
      best = std::min(best, 1e3 * (thread_seconds() - begin));
    }
    fast.add(0.0, best);
    fast.judge(result.converged, error_of(result.T_target_source, pair.T_target_source), 0.2, 0.5);
    for (const auto& [name, s] : settings) {
      const PclAlignment peer = pcl_gicp(pcl_source, pcl_target, start, s);
      peers[name].add(0.0, peer.gicp_ms);
      peers[name].judge(peer.accepted, error_of(peer.T_target_source, pair.T_target_source), 0.2, 0.5);
    }
    for (const bool voxels : {false, true}) {
      if (!has_small_gicp()) break;
      SmallGicpAlignment best_of_three;
      for (int i = 0; i < 3; ++i) {
        const SmallGicpAlignment run = small_gicp_align(small_source, small_target, start, voxels);
        if (i == 0 || run.ms < best_of_three.ms) best_of_three = run;
      }
      Column& column = peers[voxels ? "small VGICP" : "small GICP"];
      column.add(0.0, best_of_three.ms);
      column.judge(best_of_three.converged, error_of(best_of_three.T_target_source, pair.T_target_source),
                   0.2, 0.5);
    }
  }
  print_header();
  fast.print("fast");
  for (const auto& [name, column] : peers) column.print(name.c_str());
  for (const auto& [name, column] : peers) print_ratio(fast.ms, column.ms, ("against " + name).c_str());
}

}  // namespace
}  // namespace loopwise::bench

int main(int argc, char** argv) {
  using namespace loopwise::bench;
  const auto is = [&](const char* word) { return argc > 2 && std::strcmp(argv[1], word) == 0; };
  const auto number = [&](std::uint64_t otherwise) {
    return argc > 3 ? std::strtoull(argv[3], nullptr, 10) : otherwise;
  };
  if (is("kitti")) return kitti(argv[2], number(20)), 0;
  if (is("session")) return session(argv[2], number(10)), 0;
  if (is("foreign")) return foreign(argv[2]), 0;
  if (is("gicp")) return gicp(argv[2], number(20), argc > 4 ? std::atof(argv[4]) : 0.25), 0;
  if (is("distance"))
    return distance(argv[2], number(100), argc > 4 ? std::strtoull(argv[4], nullptr, 10) : 10), 0;
  if (is("symmetric")) {
    return symmetric(argv[2], number(60), argc > 4 ? std::strtoull(argv[4], nullptr, 10) : 1), 0;
  }
  std::printf(
      "loopwise_registration_bench kitti|session FOLDER [COUNT] | gicp FOLDER [STARTS [VOXEL_M]] | foreign "
      "DATA | distance FOLDER [PAIRS "
      "[PCL_EVERY]] | symmetric all|KIND "
      "[COUNT [SEED]]\n");
  return 2;
}
