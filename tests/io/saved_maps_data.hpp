// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Folders as other SLAM programs save them, number formats and file names included. Made after the programs'
/// savers: sub_map.cpp and global_mapping.cpp of GLIM and point_cloud.cpp of gtsam_points,
/// fast_lio_sam_qn.cpp, mypcl.hpp of HBA, voxelslam.cpp, pipeline.py and local_map_graph.py of KISS-SLAM,
/// PoseGraph.cpp of Open3D.
#pragma once

#include <fstream>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

#include <loopwise/io/cloud.hpp>

#include "cloud_testing.hpp"
#include "raw_sequence_data.hpp"
#include "saver_data.hpp"
#include "testing.hpp"

namespace loopwise::testing {

/// Frames of a drive in submaps of `frames` each; the IMU stands beside the lidar.
struct GlimDrive {
  std::size_t frames = 7;
  Eigen::Isometry3d T_lidar_imu = Eigen::Isometry3d::Identity();
  std::vector<Eigen::Isometry3d> world_lidar, odom_lidar;

  [[nodiscard]] Eigen::Isometry3d world_imu(std::size_t frame) const {
    return world_lidar[frame] * T_lidar_imu;
  }
  /// Where the submap's origin is: the IMU of its frame in the middle.
  [[nodiscard]] Eigen::Isometry3d origin(std::size_t submap) const {
    return world_imu(submap * frames + frames / 2);
  }
};

inline GlimDrive glim_drive(std::size_t submaps) {
  GlimDrive drive;
  drive.T_lidar_imu.translation() << 0.02, -0.01, 0.1;
  drive.T_lidar_imu.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, 0.3));
  drive.world_lidar = car_drive(submaps * drive.frames);
  // Odometry has a frame of its own and goes astray by a little each frame.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() << 3.0, 2.0, 1.0;
  Rng rng(5);
  for (std::size_t i = 0; i < drive.world_lidar.size(); ++i) {
    if (i > 0) {
      pose =
          pose * drive.world_lidar[i - 1].inverse() * drive.world_lidar[i] * random_pose(rng, 0.001, 0.0002);
    }
    drive.odom_lidar.push_back(pose);
  }
  return drive;
}

inline std::string matrix_text(const std::string& label, const Eigen::Isometry3d& T) {
  std::ostringstream out;
  out << label << ": \n" << T.matrix() << "\n";
  return out.str();
}

inline void write_floats(const fs::path& file, const std::vector<Eigen::Vector3f>& points) {
  std::ofstream out(file, std::ios::binary);
  for (const Eigen::Vector3f& p : points) {
    const float values[] = {p.x(), p.y(), p.z()};
    out.write(reinterpret_cast<const char*>(values), sizeof values);
  }
}

inline void write_glim(const fs::path& folder, const GlimDrive& drive) {
  const std::size_t submaps = drive.world_lidar.size() / drive.frames;
  fs::create_directories(folder);
  write_text(folder / "graph.txt",
             "num_submaps: " + std::to_string(submaps) +
                 "\nnum_all_frames: " + std::to_string(drive.world_lidar.size()) +
                 "\nnum_matching_cost_factors: 2\nmatching_cost vgicp 0 1\nmatching_cost vgicp 0 2\n");
  write_text(folder / "graph.bin", "serialised");
  for (std::size_t s = 0; s < submaps; ++s) {
    const fs::path own = folder / six_digits(s);
    fs::create_directories(own);
    const std::size_t first = s * drive.frames, last = first + drive.frames - 1;
    const Eigen::Isometry3d inverse = drive.origin(s).inverse();
    std::string text = "id: " + std::to_string(s) + "\n";
    text += matrix_text("T_world_origin", drive.origin(s));
    text += matrix_text("T_origin_endpoint_L", inverse * drive.world_imu(first));
    text += matrix_text("T_origin_endpoint_R", inverse * drive.world_imu(last));
    text += matrix_text("T_lidar_imu", drive.T_lidar_imu);
    text += "imu_bias: 0.01 0.02 0.03 0 0 0\nframe_id: 1\nnum_frames: " + std::to_string(drive.frames) + "\n";
    for (std::size_t i = first; i <= last; ++i) {
      char stamp[40];
      std::snprintf(stamp, sizeof stamp, "%.9f", 1567410201.25 + 0.1 * static_cast<double>(i));
      text +=
          "frame_" + std::to_string(i - first) + "\nid: " + std::to_string(i) + "\nstamp: " + stamp + "\n";
      text += matrix_text("T_odom_lidar", drive.odom_lidar[i]);
      text += matrix_text("T_world_lidar", drive.world_lidar[i]);
      text += "v_world_imu: 8 0 0\n";
    }
    write_text(own / "data.txt", text);
    write_text(own / "imu_rate.txt", "");
    write_floats(own / "points_compact.bin",
                 random_cloud(20 + s, false, false, static_cast<unsigned>(s)).points);
    write_text(own / "covs_compact.bin", std::string(24 * (20 + s), '\0'));
  }
}

inline void write_fast_lio_sam_qn(const fs::path& folder, const Drive& drive) {
  fs::create_directories(folder / "scans");
  std::ostringstream tum;
  tum << "#timestamp x y z qx qy qz qw\n" << std::fixed << std::setprecision(8);
  for (std::size_t i = 0; i < drive.truth.size(); ++i) {
    const Eigen::Isometry3d& T = drive.truth[i];
    const Eigen::Quaterniond q(T.linear());
    tum << drive.times_s[i] << " " << T.translation().x() << " " << T.translation().y() << " "
        << T.translation().z() << " " << q.x() << " " << q.y() << " " << q.z() << " " << q.w() << "\n";
    write_pcd(folder / "scans" / (six_digits(i) + ".pcd"),
              random_cloud(20 + i, false, true, static_cast<unsigned>(i)), PcdEncoding::kAscii);
  }
  write_text(folder / "poses_tum.txt", tum.str());
  write_text(folder / "poses_kitti.txt", kitti_rows(drive.truth));
  write_pcd(folder / "seq_map.pcd", random_cloud(10, false, true), PcdEncoding::kAscii);
}

/// A line a pose, the scalar of the quaternion first, no line end after the last.
inline void write_hba(const fs::path& folder, const std::vector<Eigen::Isometry3d>& poses) {
  fs::create_directories(folder / "pcd");
  std::ostringstream out;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Quaterniond q(poses[i].linear());
    const Eigen::Vector3d t = poses[i].translation();
    out << t.x() << " " << t.y() << " " << t.z() << " " << q.w() << " " << q.x() << " " << q.y() << " "
        << q.z() << (i + 1 < poses.size() ? "\n" : "");
    write_pcd(folder / "pcd" / (std::to_string(i) + ".pcd"),
              random_cloud(20 + i, false, false, static_cast<unsigned>(i)), PcdEncoding::kBinary);
  }
  write_text(folder / "pose.json", out.str());
}

/// A session of Voxel-SLAM: every sweep.
inline void write_voxel_session(const fs::path& folder, const std::vector<Eigen::Isometry3d>& poses) {
  fs::create_directories(folder);
  std::ostringstream out;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Quaterniond q(poses[i].linear());
    const Eigen::Vector3d t = poses[i].translation();
    out << std::fixed << std::setprecision(6) << 1567410201.25 + 0.1 * static_cast<double>(i) << " "
        << std::setprecision(7) << t.x() << " " << t.y() << " " << t.z() << " " << q.x() << " " << q.y()
        << " " << q.z() << " " << q.w();
    for (int n = 0; n < 18; ++n) out << " " << 0.001 * n;
    out << "\n";
    write_pcd(folder / (std::to_string(i) + ".pcd"),
              random_cloud(20 + i, false, true, static_cast<unsigned>(i)), PcdEncoding::kBinary);
  }
  write_text(folder / "alidarState.txt", out.str());
}

/// KISS-SLAM's results: local maps in world coordinates, a graph with edges from each to the one before.
inline void write_kiss_slam(const fs::path& folder, const std::vector<Eigen::Isometry3d>& poses) {
  const std::string information = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1 ";
  fs::create_directories(folder / "local_maps" / "plys");
  std::string vertices, edges;
  const auto edge = [&](std::size_t from, std::size_t to) {
    edges += "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " " +
             streamed(poses[from].inverse() * poses[to]) + information + "\n";
  };
  for (std::size_t i = 0; i < poses.size(); ++i) {
    vertices += "VERTEX_SE3:QUAT " + std::to_string(i) + " " + streamed(poses[i]) + "\n";
    if (i == 0) vertices += "FIX 0\n";
    if (i > 0) edge(i, i - 1);
    PointCloud cloud = random_cloud(20 + i, true, false, static_cast<unsigned>(i));
    for (Eigen::Vector3f& p : cloud.points) p = poses[i].cast<float>() * p;
    for (Eigen::Vector3f& n : cloud.normals) n = poses[i].linear().cast<float>() * n;
    write_ply(folder / "local_maps" / "plys" / (six_digits(i) + ".ply"), cloud);
  }
  edge(poses.size() - 1, 0);
  write_text(folder / "local_maps" / "local_map_graph.g2o", vertices + edges);
  write_text(folder / "trajectory.g2o", vertices);
  write_text(folder / "07_poses_kitti.txt", kitti_rows(poses));
}

inline std::string json_numbers(const double* values, std::size_t count) {
  std::ostringstream out;
  out.precision(17);
  out << "[";
  for (std::size_t i = 0; i < count; ++i) out << (i > 0 ? ", " : "") << values[i];
  out << "]";
  return out.str();
}

/// A pose graph of Open3D: matrices column by column, T_target_source, rotation first in the information.
inline std::string open3d_text(const std::vector<Eigen::Isometry3d>& poses, const Matrix6d& rotation_first) {
  std::string nodes, edges;
  const auto edge = [&](std::size_t source, std::size_t target, bool uncertain) {
    const Eigen::Matrix4d T = (poses[target].inverse() * poses[source]).matrix();
    edges += std::string(edges.empty() ? "" : ",") +
             "\n{\"class_name\": \"PoseGraphEdge\", \"confidence\": 1.0, " +
             "\"information\": " + json_numbers(rotation_first.data(), 36) +
             ", \"source_node_id\": " + std::to_string(source) +
             ", \"target_node_id\": " + std::to_string(target) +
             ", \"transformation\": " + json_numbers(T.data(), 16) +
             ", \"uncertain\": " + (uncertain ? "true" : "false") +
             ", \"version_major\": 1, \"version_minor\": 0}";
  };
  for (std::size_t i = 0; i < poses.size(); ++i) {
    nodes += std::string(i > 0 ? "," : "") +
             "\n{\"class_name\": \"PoseGraphNode\", \"pose\": " + json_numbers(poses[i].matrix().data(), 16) +
             ", \"version_major\": 1, \"version_minor\": 0}";
    if (i > 0) edge(i - 1, i, false);
  }
  edge(0, poses.size() - 1, true);
  return "{\n\"class_name\": \"PoseGraph\",\n\"edges\": [" + edges + "],\n\"nodes\": [" + nodes +
         "],\n\"version_major\": 1,\n\"version_minor\": 0\n}\n";
}

/// mrg_slam's folder of a team: ids are handed out as nodes come, of the robots in turn; the anchor is the
/// second. Robots start `apart` metres from each other.
inline void write_mrg_slam(const fs::path& folder, const std::vector<std::string>& robots, const Drive& drive,
                           double apart = 3.0) {
  const std::string information = "25 0 0 0 0 0 25 0 0 0 0 25 0 0 0 400 0 0 400 0 400 ";
  fs::create_directories(folder / "g2o");
  fs::create_directories(folder / "edges");
  fs::create_directories(folder / "keyframes");
  std::string vertices = "VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1 \nFIX 1\n", edges;
  const auto pose_of = [&](std::size_t robot, std::size_t frame) {
    return Eigen::Translation3d(0.0, apart * static_cast<double>(robot), 0.0) * drive.odometry[frame];
  };
  const auto id_of = [&](std::size_t robot, std::size_t frame) {
    const std::size_t rank = frame * robots.size() + robot;
    return rank == 0 ? rank : rank + 1;
  };
  const auto edge = [&](std::size_t from, std::size_t to, const Eigen::Isometry3d& T) {
    edges += "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " " + streamed(T) +
             information + "\n";
  };
  edge(1, 0, pose_of(0, 0));
  for (std::size_t i = 0; i < drive.odometry.size(); ++i) {
    for (std::size_t r = 0; r < robots.size(); ++r) {
      const Eigen::Isometry3d T = pose_of(r, i);
      const std::size_t id = id_of(r, i);
      vertices += "VERTEX_SE3:QUAT " + std::to_string(id) + " " + streamed(T) + "\n";
      if (i > 0) edge(id, id_of(r, i - 1), T.inverse() * pose_of(r, i - 1));
      if (i > 0 && r > 0 && i % 5 == 0) edge(id, id_of(0, i), T.inverse() * pose_of(0, i));
      const std::string own = six_digits(i * robots.size() + r);
      std::ostringstream text;
      text << "robot_name " << (robots[r].empty() ? "\"\"" : robots[r]) << "\nreadable_id " << robots[r]
           << "." << i << "\nstamp " << 1567410201 + i << " " << 250000000 << "\nestimate\n"
           << T.matrix() << "\nodom_counter " << i << "\nodom\n"
           << T.matrix() << "\naccum_distance " << 2.5 * static_cast<double>(i) << "\nfirst_keyframe "
           << (i == 0 ? 1 : 0) << "\nstatic_keyframe 0\ng2o_id " << id
           << "\nuuid_str 6c1ee9de-3bd0-4b4c-9a3e-0f0d3cf9e0aa\nslam_uuid_str "
              "e0a76bb8-14ad-4c46-b9a3-3df2e84d16ce\n";
      write_text(folder / "keyframes" / (own + ".txt"), text.str());
      write_pcd(folder / "keyframes" / (own + ".pcd"),
                random_cloud(20 + i, false, true, static_cast<unsigned>(i)), PcdEncoding::kBinary);
    }
  }
  write_text(folder / "g2o" / "graph.g2o", vertices + edges);
  write_text(folder / "g2o" / "special_nodes.csv", "anchor_node 1\nanchor_edge 0\nfloor_node -1\n");
}

}  // namespace loopwise::testing
