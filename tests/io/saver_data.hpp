// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Folders as other programs save them, number formats, file names and order of lines included. Made after
/// the programs' savers: laserPosegraphOptimization.cpp of SC-A-LOAM and FAST_LIO_SLAM, mapOptmization.cpp of
/// SC-LIO-SAM, keyframe.cpp and graph_slam.cpp of hdl_graph_slam. What LAMP saves is in lamp_data.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include <loopwise/io/cloud.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::testing {

/// Key frames on a circle of 10 m, and their poses by odometry.
struct Drive {
  std::vector<Eigen::Isometry3d> truth;
  std::vector<Eigen::Isometry3d> odometry;
  std::vector<double> times_s;
};

inline Drive drive(std::size_t count, unsigned seed = 1) {
  Rng rng(seed);
  Drive out;
  for (std::size_t i = 0; i < count; ++i) {
    const double angle = 2.0 * M_PI * static_cast<double>(i) / static_cast<double>(count);
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, angle));
    T.translation() << 10.0 * std::cos(angle), 10.0 * std::sin(angle), 0.1 * rng.normal();
    out.truth.push_back(T);
    out.times_s.push_back(1567410201.25 + 0.7 * static_cast<double>(i));
    Eigen::Isometry3d step = Eigen::Isometry3d::Identity();
    if (i > 0) step = out.truth[i - 1].inverse() * T * random_pose(rng, 0.02, 0.004);
    out.odometry.push_back(i == 0 ? T : out.odometry.back() * step);
  }
  return out;
}

inline std::string six_digits(std::size_t number) {
  const std::string digits = std::to_string(number);
  return std::string(6 - std::min<std::size_t>(6, digits.size()), '0') + digits;
}

/// As std::to_string() writes numbers: six decimals.
inline std::string decimals(const Eigen::Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  std::string out;
  for (const double v :
       {T.translation().x(), T.translation().y(), T.translation().z(), q.x(), q.y(), q.z(), q.w()})
    out += " " + std::to_string(v);
  return out;
}

/// As a stream writes numbers: six digits.
inline std::string kitti_rows(const std::vector<Eigen::Isometry3d>& poses) {
  std::ostringstream out;
  for (const Eigen::Isometry3d& T : poses) {
    for (int i = 0; i < 12; ++i) out << T(i / 4, i % 4) << (i < 11 ? " " : "\n");
  }
  return out.str();
}

inline void write_scans(const fs::path& folder, std::size_t count, std::size_t first = 0) {
  fs::create_directories(folder);
  for (std::size_t i = 0; i < count; ++i) {
    write_pcd(folder / (six_digits(first + i) + ".pcd"),
              random_cloud(20 + i, false, true, static_cast<unsigned>(i)), PcdEncoding::kBinary);
  }
}

inline std::string times_text(const std::vector<double>& times_s) {
  std::ostringstream out;
  out.precision(std::numeric_limits<double>::max_digits10);
  for (const double time : times_s) out << time << "\n";
  return out.str();
}

/// The graph with edges of seven numbers that SC-LIO-SAM and SC-A-LOAM save: vertices, steps, a closure from
/// the later to the earlier frame.
inline std::string posegraph_text(const std::vector<Eigen::Isometry3d>& vertices,
                                  const std::vector<Eigen::Isometry3d>& odometry) {
  std::string out;
  for (std::size_t i = 0; i < vertices.size(); ++i)
    out += "VERTEX_SE3:QUAT " + std::to_string(i) + decimals(vertices[i]) + "\n";
  const auto edge = [&](std::size_t from, std::size_t to) {
    out += "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) +
           decimals(odometry[from].inverse() * odometry[to]) + "\n";
  };
  for (std::size_t i = 1; i < odometry.size(); ++i) edge(i - 1, i);
  if (odometry.size() > 2) edge(odometry.size() - 1, 0);
  return out;
}

inline void write_sc_lio_sam(const fs::path& folder, const Drive& drive) {
  write_scans(folder / "Scans", drive.truth.size());
  fs::create_directories(folder / "SCDs");
  for (std::size_t i = 0; i < drive.truth.size(); ++i)
    write_text(folder / "SCDs" / (six_digits(i) + ".scd"), "0 1.5 0\n2.25 0 0\n");
  write_text(folder / "times.txt", times_text(drive.times_s));
  write_text(folder / "singlesession_posegraph.g2o", posegraph_text(drive.odometry, drive.odometry));
  write_text(folder / "optimized_poses.txt", kitti_rows(drive.truth));
  for (const char* name : {"trajectory.pcd", "transformations.pcd", "cloudGlobal.pcd"})
    write_pcd(folder / name, random_cloud(10, false, true), PcdEncoding::kAscii);
}

inline void write_fast_lio_slam(const fs::path& folder, const Drive& drive) {
  write_scans(folder / "Scans", drive.truth.size());
  write_text(folder / "times.txt", times_text(drive.times_s));
  write_text(folder / "optimized_poses.txt", kitti_rows(drive.truth));
  write_text(folder / "odom_poses.txt", kitti_rows(drive.odometry));
}

inline void write_sc_a_loam(const fs::path& folder, const Drive& drive) {
  write_fast_lio_slam(folder, drive);
  fs::create_directories(folder / "SCDs");
  write_text(folder / "singlesession_posegraph.g2o", posegraph_text(drive.odometry, drive.odometry));
}

/// As a g2o library writes it: a stream's six digits, and a blank after each number of a pose.
inline std::string streamed(const Eigen::Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  std::ostringstream out;
  out << T.translation().x() << " " << T.translation().y() << " " << T.translation().z() << " " << q.x()
      << " " << q.y() << " " << q.z() << " " << q.w() << " ";
  return out.str();
}

struct HdlDump {
  bool anchor = true;  ///< A fixed node tied to the first (fix_first_node).
  bool floor = true;   ///< A fixed plane and edges to it (floor detection).
  bool gps = false;    ///< Priors of the place in UTM.
};

/// hdl_graph_slam's dump of a drive. Ids are handed out as nodes come: 0, the anchor 1, the plane 3. Returns
/// the ids of the key frames.
inline std::vector<std::size_t> write_hdl_dump(const fs::path& folder, const Drive& drive,
                                               const HdlDump& with = {}) {
  const std::string information = "25 0 0 0 0 0 25 0 0 0 0 25 0 0 0 400 0 0 400 0 400 ";
  std::vector<std::size_t> ids;
  std::size_t next = 0;
  const std::size_t absent = std::numeric_limits<std::size_t>::max();
  std::size_t anchor = absent, plane = absent;
  for (std::size_t i = 0; i < drive.truth.size(); ++i) {
    ids.push_back(next++);
    if (i == 0 && with.anchor) anchor = next++;
    if (i == 1 && with.floor) plane = next++;
  }
  std::string vertices, edges;
  for (std::size_t id = 0, frame = 0; id < next; ++id) {
    if (id == anchor) {
      vertices +=
          "VERTEX_SE3:QUAT " + std::to_string(id) + " 0 0 0 0 0 0 1 \nFIX " + std::to_string(id) + "\n";
    } else if (id == plane) {
      vertices +=
          "VERTEX_PLANE " + std::to_string(id) + " 0 0 1 -0 0.2 0.2 0.2\nFIX " + std::to_string(id) + "\n";
    } else {
      vertices += "VERTEX_SE3:QUAT " + std::to_string(id) + " " + streamed(drive.odometry[frame++]) + "\n";
    }
  }
  const auto edge = [&](std::size_t from, std::size_t to, const Eigen::Isometry3d& T) {
    edges += "EDGE_SE3:QUAT " + std::to_string(from) + " " + std::to_string(to) + " " + streamed(T) +
             information + "\n";
  };
  if (with.anchor) edge(anchor, ids[0], drive.odometry[0]);
  for (std::size_t i = 1; i < ids.size(); ++i) {
    edge(ids[i], ids[i - 1], drive.odometry[i].inverse() * drive.odometry[i - 1]);
    const std::string id = std::to_string(ids[i]);
    if (with.floor)
      edges += "EDGE_SE3_PLANE " + id + " " + std::to_string(plane) + " 0 0 1 0.6  10 0 0 10 0 10\n";
    if (with.gps) edges += "EDGE_SE3_PRIORXYZ " + id + " 1 2 3  0.05 0 0 0.05 0 0.05\n";
  }
  edge(ids.back(), ids.front(), drive.odometry.back().inverse() * drive.odometry.front());

  fs::create_directories(folder);
  write_text(folder / "graph.g2o", vertices + edges);
  write_text(folder / "graph.g2o.kernels", "2 2 0 NONE 1\n");
  write_text(folder / "special_nodes.csv", "anchor_node " + std::string(with.anchor ? "1" : "-1") +
                                               "\nanchor_edge 0\nfloor_node " + (with.floor ? "3" : "-1") +
                                               "\n");
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const fs::path own = folder / six_digits(i);
    fs::create_directories(own);
    std::ostringstream data;
    data << "stamp " << 1567410201 + i << " " << 250000000 << "\nestimate\n"
         << drive.odometry[i].matrix() << "\nodom\n"
         << drive.odometry[i].matrix() << "\naccum_distance " << 2.5 * static_cast<double>(i) << "\n";
    if (with.floor) data << "floor_coeffs 0 0 1 0.6\n";
    if (with.gps) data << "utm_coord 1 2 3\n";
    data << "id " << ids[i] << "\n";
    write_text(own / "data", data.str());
    write_pcd(own / "cloud.pcd", random_cloud(20 + i, false, true, static_cast<unsigned>(i)),
              PcdEncoding::kBinary);
  }
  return ids;
}

}  // namespace loopwise::testing
