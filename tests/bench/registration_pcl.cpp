// SPDX-License-Identifier: BSD-3-Clause
#include "registration_pcl.hpp"

#include <time.h>

#include <cstdlib>

#include <pcl/features/fpfh.h>
#include <pcl/features/normal_3d.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/keypoints/harris_3d.h>
#include <pcl/point_types.h>
#include <pcl/registration/gicp.h>
#include <pcl/registration/ia_ransac.h>
#include <pcl/search/kdtree.h>

namespace loopwise::bench {

using Point = pcl::PointXYZ;
using Cloud = pcl::PointCloud<Point>;
using Normals = pcl::PointCloud<pcl::Normal>;
using Features = pcl::PointCloud<pcl::FPFHSignature33>;
using Tree = pcl::search::KdTree<Point>;
using Gicp = pcl::GeneralizedIterativeClosestPoint<Point, Point>;
using Sac = pcl::SampleConsensusInitialAlignment<Point, Point, pcl::FPFHSignature33>;

struct PclScan::Impl {
  Cloud::Ptr cloud{new Cloud};
  Tree::Ptr tree{new Tree};
  Normals::Ptr normals{new Normals};
  Features::Ptr features{new Features};
  Cloud::Ptr harris{new Cloud};
  Tree::Ptr harris_tree{new Tree};
  Features::Ptr harris_features{new Features};
  pcl::shared_ptr<Gicp::MatricesVector> covariances{new Gicp::MatricesVector};
};

namespace {

template <class Work>
double milliseconds(Work&& work) {
  const double start = thread_seconds();
  work();
  return 1e3 * (thread_seconds() - start);
}

Features::Ptr fpfh(const PclScan::Impl& scan, const pcl::IndicesConstPtr& indices, double radius_m) {
  Features::Ptr out(new Features);
  pcl::FPFHEstimation<Point, pcl::Normal, pcl::FPFHSignature33> estimation;
  estimation.setInputCloud(scan.cloud);
  estimation.setInputNormals(scan.normals);
  if (indices) estimation.setIndices(indices);
  estimation.setSearchMethod(scan.tree);
  estimation.setRadiusSearch(radius_m);
  estimation.compute(*out);
  return out;
}

void run_gicp(Gicp& gicp, const Eigen::Isometry3d& start, PclAlignment& out) {
  out.gicp_ms = milliseconds([&] {
    Cloud ignored;
    gicp.align(ignored, start.matrix().cast<float>());
  });
  out.T_target_source.matrix() = gicp.getFinalTransformation().cast<double>();
}

}  // namespace

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

PclScan::PclScan(const PointCloud& cloud, double voxel_m, double fpfh_radius_m) : impl(new Impl) {
  Cloud::Ptr raw(new Cloud);
  for (const Eigen::Vector3f& p : cloud.points) {
    if (p.allFinite()) raw->push_back({p.x(), p.y(), p.z()});
  }
  voxel_ms = milliseconds([&] {
    pcl::VoxelGrid<Point> grid;
    const auto edge = static_cast<float>(voxel_m);
    grid.setLeafSize(edge, edge, edge);
    grid.setInputCloud(raw);
    grid.filter(*impl->cloud);
  });
  points = impl->cloud->size();
  normals_ms = milliseconds([&] {
    impl->tree->setInputCloud(impl->cloud);
    pcl::NormalEstimation<Point, pcl::Normal> estimation;
    estimation.setInputCloud(impl->cloud);
    estimation.setSearchMethod(impl->tree);
    estimation.setKSearch(10);
    estimation.compute(*impl->normals);
  });
  fpfh_ms = milliseconds([&] { impl->features = fpfh(*impl, nullptr, fpfh_radius_m); });

  pcl::IndicesPtr indices(new pcl::Indices);
  harris_ms = milliseconds([&] {
    pcl::HarrisKeypoint3D<Point, pcl::PointXYZI> harris;
    harris.setMethod(pcl::HarrisKeypoint3D<Point, pcl::PointXYZI>::HARRIS);
    harris.setNonMaxSupression(true);
    harris.setRefine(false);
    harris.setThreshold(5e-9F);
    harris.setRadius(0.1F);
    harris.setNumberOfThreads(1);
    harris.setInputCloud(impl->cloud);
    harris.setNormals(impl->normals);
    pcl::PointCloud<pcl::PointXYZI> responses;
    harris.compute(responses);
    *indices = harris.getKeypointsIndices()->indices;
  });
  for (const pcl::index_t i : *indices) impl->harris->push_back((*impl->cloud)[static_cast<std::size_t>(i)]);
  harris_points = impl->harris->size();
  fpfh_harris_ms = milliseconds([&] { impl->harris_features = fpfh(*impl, indices, fpfh_radius_m); });
  if (harris_points > 0) impl->harris_tree->setInputCloud(impl->harris);

  for (const pcl::Normal& normal : *impl->normals) {
    const Eigen::Vector3d n = normal.getNormalVector3fMap().cast<double>();
    impl->covariances->push_back(Eigen::Matrix3d::Identity() -
                                 (n.allFinite() ? 0.999 : 0.0) * n * n.transpose());
    if (!impl->covariances->back().allFinite()) impl->covariances->back().setIdentity();
  }
}

PclScan::~PclScan() = default;

PclAlignment pcl_align(const PclScan& source, const PclScan& target, bool harris, unsigned seed) {
  PclAlignment out;
  std::srand(seed);  // PCL draws from rand()
  Sac sac;
  sac.setInputSource(harris ? source.impl->harris : source.impl->cloud);
  sac.setSourceFeatures(harris ? source.impl->harris_features : source.impl->features);
  sac.setInputTarget(harris ? target.impl->harris : target.impl->cloud);
  sac.setTargetFeatures(harris ? target.impl->harris_features : target.impl->features);
  sac.setSearchMethodTarget(harris ? target.impl->harris_tree : target.impl->tree, true);
  sac.setMaximumIterations(500);
  sac.setCorrespondenceRandomness(5);
  double fitness = 0.0;
  out.sac_ms = milliseconds([&] {
    Cloud ignored;
    sac.align(ignored);
    fitness = sac.getFitnessScore();
  });
  Eigen::Isometry3d start;
  start.matrix() = sac.getFinalTransformation().cast<double>();
  out.T_target_source = start;
  if (!(fitness < 32.0)) return out;

  Gicp gicp;
  gicp.setInputSource(source.impl->cloud);
  gicp.setInputTarget(target.impl->cloud);
  gicp.setSearchMethodSource(source.impl->tree, true);
  gicp.setSearchMethodTarget(target.impl->tree, true);
  gicp.setSourceCovariances(source.impl->covariances);
  gicp.setTargetCovariances(target.impl->covariances);
  gicp.setMaxCorrespondenceDistance(0.5);
  gicp.setMaximumIterations(200);
  gicp.setMaximumOptimizerIterations(50);
  gicp.setTransformationEpsilon(1e-10);
  gicp.setRotationEpsilon(2e-3);
  run_gicp(gicp, start, out);
  double gate = 0.0;
  out.gicp_ms += milliseconds([&] { gate = gicp.getFitnessScore(); });
  out.accepted = gicp.hasConverged() && gate < 0.9;
  return out;
}

PclAlignment pcl_gicp(const PclScan& source, const PclScan& target, const Eigen::Isometry3d& start,
                      const PclGicpSettings& settings) {
  PclAlignment out;
  Gicp gicp;
  gicp.setInputSource(source.impl->cloud);
  gicp.setInputTarget(target.impl->cloud);
  gicp.setSearchMethodSource(source.impl->tree, true);
  gicp.setSearchMethodTarget(target.impl->tree, true);
  if (!settings.own_covariances) {
    gicp.setSourceCovariances(source.impl->covariances);
    gicp.setTargetCovariances(target.impl->covariances);
  }
  gicp.setMaxCorrespondenceDistance(settings.reach_m);
  gicp.setMaximumIterations(200);
  gicp.setMaximumOptimizerIterations(50);
  gicp.setTransformationEpsilon(settings.translation_epsilon);
  gicp.setRotationEpsilon(settings.rotation_epsilon);
  run_gicp(gicp, start, out);
  out.accepted = gicp.hasConverged();
  return out;
}

}  // namespace loopwise::bench
